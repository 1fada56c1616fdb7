"""Picture of a simulation: the deformed organ with its displacement, and a cut with the stress. Needs matplotlib."""

from __future__ import annotations

import os

import numpy as np

from ..meshing.groups import faces_of, flat_triangles
from ..report.canvas import TEXT_COLOUR, blank_figure, literal, save_figure
from ..report.coloured_surface import draw_colour_bar, draw_coloured
from ..report.shading import Camera, lit_mesh
from .problems import SelfWeight
from .solution import Solution

# As the other pictures: from the patient's left, front and above. The cut leaves the patient's right half.
_VIEWER = (-0.80, 0.52, 0.30)
# The largest displacement is drawn as this part of the organ's size.
_SHOWN = 0.04


def simulation_picture(path: str | os.PathLike, solution: Solution, name: str) -> None:
    """Draw the displacement on the deformed organ, and the equivalent stress in a cut.

    Parameters
    ----------
    path : path
        PNG file to write.
    solution : Solution
    name : str
        Name of the mesh, for the title.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    figure = blank_figure((12.0, 7.0))
    scale = _exaggeration(solution)
    figure.text(0.03, 0.965, literal(name), size=18, weight="bold", color=TEXT_COLOUR, va="top")
    drawn = "deformation in its true size" if scale == 1.0 else f"deformation drawn {scale:.3g} times as large"
    lines = "\n".join([*described(solution), drawn])
    figure.text(0.03, 0.915, lines, size=10.5, color=TEXT_COLOUR, va="top", linespacing=1.45)
    points = solution.mesh.points + scale * np.nan_to_num(solution.displacement)
    length = np.linalg.norm(np.nan_to_num(solution.displacement), axis=1)
    faces, _, second = faces_of(solution.mesh.tetrahedra)
    whole = flat_triangles(faces[second < 0])
    _draw(figure, 0.03, points, whole, length[whole].mean(axis=1), "displacement, mm", "viridis", smooth=True)
    faces, owner = _cut(solution)
    shown = flat_triangles(faces)
    stress = np.repeat(solution.equivalent_stress[owner], len(shown) // max(len(faces), 1))
    _draw(figure, 0.52, points, shown, stress, "equivalent stress in a cut, kPa", "inferno", smooth=False)
    save_figure(figure, path)


def described(solution: Solution) -> tuple[str, str]:
    """Tell problem and result, a line for each."""
    problem, material = solution.problem, solution.material
    if isinstance(problem, SelfWeight):
        case = f"self weight on a foundation of {problem.foundation:g} kPa/mm"
    else:
        case = f"inner pressure of {problem.pressure:g} kPa" + (
            f", foundation of {problem.foundation:g} kPa/mm" if problem.foundation else ""
        )
    given = [case, f"E {material.young:g} kPa, ν {material.poisson:g}"]
    found = [
        f"{len(solution.mesh.tetrahedra)} {('linear', 'second-order')[solution.mesh.order - 1]} tetrahedra",
        f"largest displacement {np.nanmax(np.linalg.norm(solution.displacement, axis=1)):.3g} mm",
        f"elastic energy {solution.energy:.4g} µJ",
    ]
    return "   ·   ".join(given), "   ·   ".join(found)


def _exaggeration(solution: Solution) -> float:
    """Round factor that makes the deformation visible."""
    size = np.linalg.norm(np.ptp(solution.mesh.points, axis=0))
    largest = np.nanmax(np.linalg.norm(solution.displacement, axis=1))
    if not largest > 0.0:
        return 1.0
    wanted = _SHOWN * size / largest
    digit = 10.0 ** np.floor(np.log10(wanted))
    return float(digit * max(step for step in (1.0, 2.0, 5.0) if step * digit <= wanted * (1.0 + 1e-9)))


def _cut(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the elements in the right half of the body, counter-clockwise from outside, and their elements."""
    mesh = solution.mesh
    middles = mesh.points[mesh.tetrahedra[:, :4]].mean(axis=1)
    half = np.flatnonzero(middles[:, 0] >= np.median(middles[:, 0]))
    faces, first, second = faces_of(mesh.tetrahedra[half])
    return faces[second < 0], half[first[second < 0]]


def _draw(figure, left, points, triangles, values, label, colour_map, *, smooth) -> None:
    mesh = lit_mesh(points, triangles, smooth=smooth)
    limits = 0.0, max(float(np.percentile(values, 99.5)), 1e-300)
    axes = figure.add_axes((left, 0.13, 0.45, 0.70))
    # Each triangle has three points of its own.
    camera = Camera.from_direction(_VIEWER)
    draw_coloured(axes, mesh, np.repeat(values, 3), camera=camera, limits=limits, colour_map=colour_map)
    place = (left + 0.05, 0.085, 0.35, 0.022)
    extend = "max" if values.max() > limits[1] else "neither"
    draw_colour_bar(figure, place, limits=limits, colour_map=colour_map, label=label, extend=extend)
