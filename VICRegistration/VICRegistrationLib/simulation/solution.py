"""Solving a problem on a mesh: displacement, strain, stress, energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Union

import numpy as np

from ..meshing.tetrahedra import TetrahedralMesh
from .elasticity import body_load, mass_matrix, mean_strains, spring_matrix, stiffness_matrix, traction_load
from .elements import FiniteElements
from .problems import InnerPressure, Material, SelfWeight
from .solver import rigid_motions, solve_elastic

Problem = Union[SelfWeight, InnerPressure]
# Strains beyond this are not small: linear elasticity only tells the direction.
SMALL_STRAIN = 0.05
# Resultant of a pressure, relative to the forces that make it up, up to which its surface counts as closed.
_CLOSED = 1e-6
# Beyond this numbers lose their meaning, mN at a node.
_LARGEST_LOAD = 1e15


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of a problem of linear elasticity.

    Parameters
    ----------
    mesh : TetrahedralMesh
    problem : SelfWeight or InnerPressure
    material : Material
    displacement : (n, 3) ndarray
        Of every point of the mesh, RAS mm; NaN at points of no element.
    strain, stress : (m, 6) ndarray
        Mean tensors of every element, RAS, stress in kPa: XX, YY, ZZ, XY, YZ, XZ.
    energy : float
        Elastic energy in the organ, uJ.
    foundation_energy : float
        Elastic energy in the foundation, uJ. The loads' work is the double of both energies, taken at their full size.
    force : (r, a, s)
        Resultant of the loads, mN.
    iterations : int
        Of the conjugate gradients.
    residual : float
        Relative residual of the linear system.
    notes : tuple of str
        What the user should know.
    """

    mesh: TetrahedralMesh
    problem: Problem
    material: Material
    displacement: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    energy: float
    foundation_energy: float
    force: tuple[float, float, float]
    iterations: int
    residual: float
    notes: tuple[str, ...] = ()

    @property
    def equivalent_stress(self) -> np.ndarray:
        """Equivalent stress of von Mises of every element, (m,) kPa."""
        return equivalent_stress(self.stress)


def equivalent_stress(stress: np.ndarray) -> np.ndarray:
    """Equivalent stress of von Mises of tensors (..., 6) with the components XX, YY, ZZ, XY, YZ, XZ."""
    normal, shear = stress[..., :3], stress[..., 3:]
    differences = normal - np.roll(normal, 1, axis=-1)
    return np.sqrt(0.5 * np.square(differences).sum(axis=-1) + 3.0 * np.square(shear).sum(axis=-1))


def solve(
    mesh: TetrahedralMesh,
    problem: Problem,
    material: Material | None = None,
    *,
    on_progress: Callable[[str], None] | None = None,
) -> Solution:
    """Solve a problem of linear elasticity.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm; all organs in it are of one material.
    problem : SelfWeight or InnerPressure
    material : Material, optional
    on_progress : callable, optional
        Told in one line what is being done.

    Returns
    -------
    Solution

    Raises
    ------
    ValueError
        If the mesh has no cavity for an inner pressure, no such group, or the pressure's surface is not closed.
    RuntimeError
        If scikit-fem is not installed, or the iteration does not converge.
    """
    material = material or Material()
    say = on_progress or (lambda line: None)
    say("assembling")
    elements = FiniteElements(mesh)
    load = _load(elements, problem, material)
    if not np.abs(load).max(initial=0.0) < _LARGEST_LOAD:
        msg = f"The load reaches {np.abs(load).max():.3g} mN at a node; no tissue bears that. Give a smaller load."
        raise ValueError(msg)
    elastic = stiffness_matrix(elements, material)
    springs = spring_matrix(elements, elements.outside, problem.foundation) if problem.foundation else None
    mass = None if problem.foundation else mass_matrix(elements)
    say(f"solving for {len(load)} unknowns")
    solved = solve_elastic(elastic if springs is None else elastic + springs, load, elements.places, mass=mass)
    values = solved.values
    displacement = np.full(mesh.points.shape, np.nan)
    displacement[elements.nodes] = values.reshape(3, -1).T
    strain = mean_strains(elements, values.reshape(3, -1))
    return Solution(
        mesh=mesh,
        problem=problem,
        material=material,
        displacement=displacement,
        strain=strain,
        stress=material.stress(strain),
        energy=float(values @ (elastic @ values)) / 2.0,
        foundation_energy=0.0 if springs is None else float(values @ (springs @ values)) / 2.0,
        force=tuple(load.reshape(3, -1).sum(axis=1).tolist()),
        iterations=solved.iterations,
        residual=solved.residual,
        notes=_notes(strain),
    )


def _load(elements: FiniteElements, problem: Problem, material: Material) -> np.ndarray:
    if isinstance(problem, SelfWeight):
        return body_load(elements, problem.body_force(material))
    if problem.surface is None:
        triangles = elements.cavities
        if not len(triangles):
            msg = (
                "The mesh has no cavity for an inner pressure; make it of a hollow organ (vic-registration mesh "
                "--wall), or name a group of triangles."
            )
            raise ValueError(msg)
    else:
        triangles = elements.group(problem.surface)
    load = traction_load(elements, triangles, -problem.pressure * np.eye(3))
    if not problem.foundation:
        motions = rigid_motions(elements.places).reshape(-1, 6)
        if np.abs(motions.T @ load).max() > _CLOSED * np.abs(load).sum():
            msg = (
                f"The pressure on {problem.surface or 'the cavities'} pushes the organ away, as the surface is not "
                "closed; choose a closed group, or give a foundation that holds the organ."
            )
            raise ValueError(msg)
    return load


def _notes(strain: np.ndarray) -> tuple[str, ...]:
    tensors = strain[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    largest = float(np.abs(np.linalg.eigvalsh(tensors)).max())
    if largest <= SMALL_STRAIN:
        return ()
    return (
        f"The largest strain is {100.0 * largest:.1f} %, beyond the {100.0 * SMALL_STRAIN:g} % or so that linear "
        "elasticity holds for; take a smaller load or a stiffer material.",
    )
