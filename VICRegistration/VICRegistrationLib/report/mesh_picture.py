"""Picture of a mesh: its surfaces, and a cut that shows the tetrahedra inside. Needs matplotlib."""

from __future__ import annotations

import os

import numpy as np

from ..meshing.elements import TetrahedralMesh, faces_of, flat_triangles
from ..meshing.quality import quality
from ..organ_colours import organ_colours
from .canvas import TEXT_COLOUR, blank_figure, literal, save_figure
from .shading import Camera, lit_mesh, shaded_triangles

# As the other pictures: from the patient's left, front and above. The cut leaves the patient's right half.
_VIEWER = (-0.80, 0.52, 0.30)
_EDGE_COLOUR = "#1d2026"


def mesh_picture(path: str | os.PathLike, mesh: TetrahedralMesh, name: str) -> None:
    """Draw the surfaces of a mesh, and the half of it behind a cut through its middle.

    Parameters
    ----------
    path : path
        PNG file to write.
    mesh : TetrahedralMesh
    name : str
        Title.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    figure = blank_figure((12.0, 7.0))
    figure.text(0.03, 0.965, literal(name), size=18, weight="bold", color=TEXT_COLOUR, va="top")
    found = quality(mesh)
    lines = (
        f"{len(mesh.tetrahedra)} {('linear', 'second-order')[mesh.order - 1]} tetrahedra   \u00b7   "
        f"{len(mesh.points)} nodes   \u00b7   {found.inverted} inverted   \u00b7   "
        f"scaled Jacobian: min {found.scaled_jacobian_min:.2f}, mean {found.scaled_jacobian_mean:.2f}   \u00b7   "
        f"volume {100.0 * (found.volume_ratio - 1.0):+.2f} % of the exact solids"
    )
    figure.text(0.03, 0.915, lines, size=10.5, color=TEXT_COLOUR, va="top")
    colours = _colours(mesh)
    middles = mesh.points[mesh.tetrahedra[:, :4]].mean(axis=1)
    halves = middles[:, 0] >= np.median(middles[:, 0])
    for left, chosen in ((0.02, np.arange(len(mesh.tetrahedra))), (0.51, np.flatnonzero(halves))):
        _draw(figure, left, mesh, chosen, colours)
    save_figure(figure, path)


def _colours(mesh: TetrahedralMesh) -> np.ndarray:
    """Colour of every tetrahedron: that of its organ, (m, 3)."""
    from matplotlib.colors import to_rgb

    organs = {group: group[: -len("_wall")] if group.endswith("_wall") else group for group in mesh.tetrahedron_groups}
    of_organ = organ_colours(list(organs.values()))
    colours = np.zeros((len(mesh.tetrahedra), 3))
    for group, rows in mesh.tetrahedron_groups.items():
        colours[rows] = to_rgb(of_organ[organs[group]])
    return colours


def _draw(figure, left: float, mesh: TetrahedralMesh, chosen: np.ndarray, colours: np.ndarray) -> None:
    """Draw the outside of the chosen tetrahedra, with the edges of their faces."""
    from matplotlib.collections import PolyCollection

    faces, first, second = faces_of(mesh.tetrahedra[chosen])
    outside = second < 0
    triangles = flat_triangles(faces[outside])
    each = np.repeat(colours[chosen[first[outside]]], len(triangles) // max(int(outside.sum()), 1), axis=0)
    lit = lit_mesh(mesh.points, triangles, smooth=False)
    corners, shades = shaded_triangles([lit], [each], Camera.from_direction(_VIEWER))
    axes = figure.add_axes((left, 0.03, 0.47, 0.84))
    axes.add_collection(PolyCollection(corners, facecolors=shades, edgecolors=_EDGE_COLOUR, linewidths=0.2))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()
