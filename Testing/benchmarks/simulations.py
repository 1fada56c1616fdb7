"""Elastic energies of the demo's bladder on finer and finer meshes, beside NGSolve's on a mesh of its own."""

from __future__ import annotations

import importlib.util
import tempfile
import time
from pathlib import Path

import numpy as np
from measuring import table

from VICRegistrationLib.export.step import Solid, write_step
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.meshing.options import MeshOptions
from VICRegistrationLib.meshing.tetrahedra import mesh_organs
from VICRegistrationLib.meshing.wall import offset_surface
from VICRegistrationLib.phantoms.organs import pelvic_organs
from VICRegistrationLib.simulation.problems import InnerPressure, Material, SelfWeight
from VICRegistrationLib.simulation.solution import solve

WALL_MM = 4.0
# Name, thickness of the wall, problem and material.
CASES = (
    ("self-weight, E = 10 kPa", None, SelfWeight(), Material(young=10.0)),
    ("pressure of 1 kPa", WALL_MM, InnerPressure(pressure=1.0), Material(young=300.0)),
)
_SIZES_MM, _REFERENCE_SIZE_MM = (6.0, 4.0, 3.0), 5.0


def report(*, quick: bool) -> str:
    """Solve both problems with second-order elements at several sizes, and by NGSolve where it is installed."""
    missing = [package for package in ("gmsh", "skfem") if importlib.util.find_spec(package) is None]
    if missing:
        return f"  Skipped: {' and '.join(missing)} not installed (vicregistration[mesh,fe])."
    surface = pelvic_organs()["bladder"]
    with_reference = importlib.util.find_spec("ngsolve") is not None
    rows = [["problem", "mm", "unknowns", "energy uJ", "time / 6 mm"]]
    for name, wall, problem, material in CASES:
        unit = None
        for size in _SIZES_MM[:1] if quick else _SIZES_MM:
            mesh = mesh_organs([Solid("bladder", surface)], MeshOptions(size=size, order=2, wall=wall))
            start = time.perf_counter()
            solution = solve(mesh, problem, material)
            seconds = time.perf_counter() - start
            unit = unit or seconds
            energy = solution.energy + solution.foundation_energy
            rows.append([name, f"{size:g}", str(mesh.points.size), f"{energy:.3f}", f"{seconds / unit:.1f}"])
        if with_reference:
            energy, unknowns = ngsolve_energy(surface, wall, problem, material, _REFERENCE_SIZE_MM)
            rows.append([f"{name}, NGSolve", f"{_REFERENCE_SIZE_MM:g}", str(unknowns), f"{energy:.3f}", ""])
    note = "" if with_reference else "\n\n  NGSolve is not installed (pip install ngsolve): no rows of its own."
    return (
        f"  The demo's bladder, solid or with a wall of {WALL_MM:g} mm around it; second order. Energy: elastic, of\n"
        "  the organ and of its foundation. NGSolve works on Netgen's mesh of the STEP file.\n\n" + table(rows) + note
    )


def ngsolve_energy(
    surface: BSplineSurface, wall: float | None, problem: SelfWeight | InnerPressure, material: Material, size: float
) -> tuple[float, int]:
    """Elastic energy of organ and foundation (uJ) and number of unknowns, by another mesher and another solver."""
    import ngsolve
    from netgen.occ import OCCGeometry

    shape = _shape(OCCGeometry, surface, "inside" if wall else "outside")
    if wall:
        shape = _shape(OCCGeometry, offset_surface(surface, wall), "outside") - shape
    mesh = ngsolve.Mesh(OCCGeometry(shape).GenerateMesh(maxh=size))
    mesh.Curve(3)
    space = ngsolve.VectorH1(mesh, order=2)
    u, v = space.TnT()
    lame_lambda, mu = material.lame
    strain_u, strain_v = ngsolve.Sym(ngsolve.Grad(u)), ngsolve.Sym(ngsolve.Grad(v))
    stiffness = 2.0 * mu * ngsolve.InnerProduct(strain_u, strain_v) + lame_lambda * ngsolve.div(u) * ngsolve.div(v)
    matrix, load = ngsolve.BilinearForm(space, symmetric=True), ngsolve.LinearForm(space)
    matrix += stiffness * ngsolve.dx
    if problem.foundation:
        matrix += problem.foundation * ngsolve.InnerProduct(u, v) * ngsolve.ds("outside")
    else:
        # Nothing holds the organ. The load is in equilibrium, and so weak a bed changes no digit that is printed.
        matrix += 1e-6 * ngsolve.InnerProduct(u, v) * ngsolve.dx
    if wall:
        load += -problem.pressure * ngsolve.InnerProduct(ngsolve.specialcf.normal(3), v) * ngsolve.ds("inside")
    else:
        # STEP is LPS: right and anterior change their signs.
        force = np.array([-1.0, -1.0, 1.0]) * problem.body_force(material)
        load += ngsolve.InnerProduct(ngsolve.CF(tuple(force.tolist())), v) * ngsolve.dx
    matrix.Assemble()
    load.Assemble()
    solution = ngsolve.GridFunction(space)
    solution.vec.data = matrix.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky") * load.vec
    # At the solution the energy is half of the load's work.
    return 0.5 * ngsolve.InnerProduct(load.vec, solution.vec), space.ndof


def _shape(geometry, surface: BSplineSurface, name: str):
    """Solid of a surface as Open CASCADE reads it from our STEP file, its faces named."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "organ.step")
        write_step([Solid("bladder", surface)], path)
        shape = geometry(str(path)).shape
    shape.faces.name = name
    return shape
