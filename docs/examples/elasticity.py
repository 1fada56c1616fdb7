"""Elasticity of an organ on a mesh of ``vic-registration mesh``, by scikit-fem: its own weight, or a pressure inside.

    vic-registration mesh bladder.json --size 4 --order 2 --output bladder.vtu
    python elasticity.py bladder.vtu weight --young 10
    vic-registration mesh bladder.json --size 4 --order 2 --wall 4 --output wall.vtu
    python elasticity.py wall.vtu pressure --pressure 1

The organ rests on an elastic foundation (springs k all over its outside) in place of its surroundings: nothing has to
be clamped. A clamped patch of the surface would be no well-posed problem, and its stress would grow with every finer
mesh. Units are mm and kPa, so that forces are in mN and energies in uJ; the frame is the files', LPS.
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from skfem import Basis, BilinearForm, ElementTetP2, ElementVector, FacetBasis, LinearForm, MeshTet2, solve
from skfem.helpers import ddot, dot, sym_grad, trace
from skfem.models.elasticity import lame_parameters, linear_elasticity, linear_stress
from skfem.utils import solver_iter_pcg
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

# Numbers of VTK for tetrahedra with 10 nodes and triangles with 6.
TETRAHEDRON, TRIANGLE = 24, 22
# Standard gravity, m/s^2; a patient on the back: LPS, y points to the back.
GRAVITY, DOWN = 9.80665, np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Result:
    """What is printed: mm, kPa, uJ."""

    largest_displacement: float
    largest_stress: float
    energy: float
    foundation_energy: float


def read_mesh(path: str) -> MeshTet2:
    """Read a second-order mesh; the groups of triangles are its boundaries.

    Raises
    ------
    ValueError
        If there is no such file, or it holds no second-order tetrahedra.
    """
    if Path(path).suffix != ".vtu" or not Path(path).is_file():
        msg = f"There is no file {path} that ends in .vtu; give one of vic-registration mesh --order 2."
        raise ValueError(msg)
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    grid = reader.GetOutput()
    kinds = np.array([grid.GetCellType(cell) for cell in range(grid.GetNumberOfCells())])
    if not (kinds == TETRAHEDRON).any():
        msg = (
            f"{path} holds no second-order tetrahedra: linear ones are far too stiff for nearly incompressible tissue. "
            "Give a .vtu file of vic-registration mesh --order 2."
        )
        raise ValueError(msg)
    offsets, nodes = (
        vtk_to_numpy(array()) for array in (grid.GetCells().GetOffsetsArray, grid.GetCells().GetConnectivityArray)
    )
    cells = nodes[offsets[:-1][kinds == TETRAHEDRON, None] + np.arange(10)]
    mesh = MeshTet2(vtk_to_numpy(grid.GetPoints().GetData()).T, cells.T)
    # scikit-fem counts the corners anew, and finds a facet by its three corners.
    corners = np.unique(cells[:, :4])
    triangles = np.searchsorted(corners, np.sort(nodes[offsets[:-1][kinds == TRIANGLE, None] + np.arange(3)]))
    sizes = len(corners) ** np.arange(3, dtype=np.int64)
    keys = sizes @ np.sort(mesh.facets, axis=0)
    order = np.argsort(keys)
    facets = order[np.searchsorted(keys, triangles @ sizes, sorter=order)]
    group = vtk_to_numpy(grid.GetCellData().GetArray("group"))[kinds == TRIANGLE]
    names = grid.GetFieldData().GetAbstractArray("group_names")
    return mesh.with_boundaries({names.GetValue(number): facets[group == number] for number in np.unique(group)})


def deform(
    mesh: MeshTet2,
    *,
    young: float = 300.0,
    poisson: float = 0.45,
    density: float = 0.0,
    pressure: float = 0.0,
    foundation: float = 0.3,
) -> Result:
    """Solve -div sigma(u) = rho g with sigma(u) n = -p n on the inside of a wall and sigma(u) n = -k u on the outside.

    Parameters
    ----------
    mesh : MeshTet2
        LPS mm.
    young, poisson : float
        E, kPa, and nu. 300 is meant for a bladder's wall at small strains (stretched far, it has 1000 to 4100: Martins
        et al., International Urogynecology Journal 22, 2011); nu of 0.45 is as near to 0.5 as these elements go.
    density : float
        rho, kg/m^3; muscle has 1050 (ICRU Report 44, 1989).
    pressure : float
        p, kPa, on all groups NAME_inside; 1 (10 cmH2O) is that of a filling bladder.
    foundation : float
        k, kPa/mm. 0.3 is that of 10 mm of fat of 3.25 kPa (Samani et al., Physics in Medicine and Biology 52, 2007).
    """
    inside = {name for name in mesh.boundaries if re.search(r"_inside(_\d+_\d+)?$", name)}
    if pressure and not inside:
        msg = "The mesh has no group NAME_inside for a pressure; make it with vic-registration mesh --wall."
        raise ValueError(msg)
    cavity = np.unique(np.concatenate([mesh.boundaries[name] for name in inside] or [np.zeros(0, dtype=int)]))
    lame = lame_parameters(young, poisson)
    element = ElementVector(ElementTetP2())
    basis = Basis(mesh, element)
    outside = FacetBasis(mesh, element, facets=np.setdiff1d(mesh.boundary_facets(), cavity))
    stiffness = linear_elasticity(*lame).assemble(basis)
    springs = BilinearForm(lambda u, v, w: foundation * dot(u, v)).assemble(outside)
    # 1 N/m^3 = 1e-6 kPa/mm.
    weight = 1e-6 * density * GRAVITY * DOWN
    load = LinearForm(lambda v, w: sum(weight[k] * v[k] for k in range(3))).assemble(basis)
    if pressure:
        load += LinearForm(lambda v, w: -pressure * dot(w.n, v)).assemble(FacetBasis(mesh, element, facets=cavity))
    values = np.zeros_like(load)
    # Conjugate gradients leave 1e-5 of what they are given, twice 1e-10.
    for _ in range(2):
        values += solve(stiffness + springs, load - (stiffness + springs) @ values, solver=solver_iter_pcg(atol=0.0))
    if np.linalg.norm(load - (stiffness + springs) @ values) > 1e-8 * np.linalg.norm(load):
        msg = "The displacements did not converge; take a smaller Poisson's ratio or a stiffer foundation."
        raise RuntimeError(msg)
    stress = linear_stress(*lame)(sym_grad(basis.interpolate(values)))
    # Of von Mises, mean of every element.
    equivalent = np.sqrt(1.5 * ddot(stress, stress) - 0.5 * trace(stress) ** 2)
    equivalent = (equivalent * basis.dx).sum(axis=1) / basis.dx.sum(axis=1)
    return Result(
        float(np.linalg.norm(values[basis.nodal_dofs], axis=0).max()),
        float(equivalent.max()),
        float(values @ (stiffness @ values)) / 2.0,
        float(values @ (springs @ values)) / 2.0,
    )


def main(arguments: list[str] | None = None) -> int:
    """Read the mesh, solve the case, print the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", help="second-order mesh: FILE.vtu")
    parser.add_argument("case", choices=("weight", "pressure"))
    for name, default, what in (
        ("young", 300.0, "Young's modulus, kPa"),
        ("poisson", 0.45, "Poisson's ratio"),
        ("foundation", 0.3, "stiffness of the springs, kPa/mm"),
        ("pressure", 1.0, "pressure inside, kPa"),
    ):
        parser.add_argument(f"--{name}", type=float, default=default, help=f"{what} (default: {default})")
    options = parser.parse_args(arguments)
    material = {"young": options.young, "poisson": options.poisson, "foundation": options.foundation}
    load = {"density": 1050.0} if options.case == "weight" else {"pressure": options.pressure}
    try:
        found = deform(read_mesh(options.mesh), **material, **load)
    except (ValueError, RuntimeError) as error:
        print(f"elasticity: error: {error}", file=sys.stderr)
        return 2
    print(f"largest displacement       {found.largest_displacement:.3f} mm")
    print(f"largest equivalent stress  {found.largest_stress:.3f} kPa")
    print(f"energy, organ              {found.energy:.3f} uJ")
    print(f"energy, foundation         {found.foundation_energy:.3f} uJ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
