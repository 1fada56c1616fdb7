"""Surfaces coloured by a number at each vertex: deviation, confidence, displacement. Needs matplotlib."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.triangulation import TriangleMesh
from .canvas import TEXT_COLOUR, bare
from .shading import MATT, Camera, shaded_triangles

_LETTER_COLOUR = "#7d8592"
# Views are tilted, so that the tops and the bottoms of organs are seen as well.
_TILT = 0.36
_LETTERS = (("L", "R"), ("P", "A"), ("I", "S"))


@dataclass(frozen=True)
class Side:
    """A side that a surface is looked at from.

    Parameters
    ----------
    caption : str
    towards : (r, a, s)
        From the organ to the viewer.
    """

    caption: str
    towards: tuple[float, float, float]


# Together they show all of a surface.
SIDES = (
    Side("from the front, above", (0.0, 1.0, _TILT)),
    Side("from the left, below", (-1.0, 0.0, -_TILT)),
    Side("from the back, above", (0.0, -1.0, _TILT)),
    Side("from the right, below", (1.0, 0.0, -_TILT)),
)


def draw_sides(
    figure,
    place: tuple[float, float, float, float],
    mesh: TriangleMesh,
    values: np.ndarray,
    *,
    limits: tuple[float, float],
    colour_map: str,
    sides: tuple[Side, ...] = SIDES,
) -> None:
    """Draw a coloured surface from several sides in a row, on one scale of mm.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    place : (left, bottom, width, height)
        Of the row, in fractions of the figure.
    mesh : TriangleMesh
        RAS mm. Small triangles look smooth.
    values : (n,) array_like
        At the vertices.
    limits : (low, high)
        Values at the ends of the colour map; those beyond have the colours of its ends.
    colour_map : str
        A name that matplotlib knows: diverging for signed values ("coolwarm"), sequential for others ("viridis").
    sides : tuple of Side
    """
    left, bottom, width, height = place
    center = (mesh.points.min(axis=0) + mesh.points.max(axis=0)) / 2.0
    half = 1.06 * np.linalg.norm(mesh.points - center, axis=1).max()
    for number, side in enumerate(sides):
        camera = Camera.from_direction(side.towards)
        axes = figure.add_axes((left + number * width / len(sides), bottom, width / len(sides), height))
        draw_coloured(axes, mesh, values, camera=camera, limits=limits, colour_map=colour_map)
        x, y = camera.project(center)
        axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
        axes.set_title(side.caption, size=10, color=TEXT_COLOUR, pad=3)
        for horizontal, direction in (("left", -camera.right), ("right", camera.right)):
            position = (0.08 if horizontal == "left" else 0.92, 0.06)
            style = {"ha": horizontal, "va": "bottom", "size": 10, "weight": "bold", "color": _LETTER_COLOUR}
            axes.text(*position, _letter(direction), transform=axes.transAxes, **style)


def draw_coloured(
    axes, mesh: TriangleMesh, values: np.ndarray, *, camera: Camera, limits: tuple[float, float], colour_map: str
) -> None:
    """Draw a lit surface in the colours of its values.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    mesh : TriangleMesh
        RAS mm.
    values : (n,) array_like
        At the vertices.
    camera : Camera
    limits : (low, high)
        Values at the ends of the colour map.
    colour_map : str
        A name that matplotlib knows.
    """
    from matplotlib import colormaps
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import Normalize

    each = np.asarray(values, dtype=float)[mesh.triangles].mean(axis=1)
    colours = colormaps[colour_map](Normalize(*limits)(each))[:, :3]
    corners, shades = shaded_triangles([mesh], [colours], camera, finish=MATT)
    triangles = PolyCollection(corners, facecolors=shades, edgecolors=shades, linewidths=0.35)
    axes.add_collection(triangles, autolim=False)
    axes.update_datalim([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_colour_bar(
    figure,
    place: tuple[float, float, float, float],
    *,
    limits: tuple[float, float],
    colour_map: str,
    label: str,
    extend: str = "neither",
) -> None:
    """Draw the scale of the colours.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    place : (left, bottom, width, height)
        In fractions of the figure.
    limits : (low, high)
        Values at the ends of the colour map.
    colour_map : str
        A name that matplotlib knows.
    label : str
        What the values are, with their unit.
    extend : {"neither", "min", "max", "both"}
        At which ends there are values beyond.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    axes = figure.add_axes(place)
    shown = ScalarMappable(Normalize(*limits), colour_map)
    bar = figure.colorbar(shown, cax=axes, orientation="horizontal", extend=extend)
    bar.set_label(label, color=TEXT_COLOUR, size=10)
    bar.outline.set_visible(False)


def draw_shares(axes, edges: np.ndarray, shares: np.ndarray, *, limits: tuple[float, float], colour_map: str) -> None:
    """Draw shares of the area as bars in the colours that the surface has.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    edges : (n + 1,) ndarray
        Between the bars.
    shares : (n,) ndarray
        In per cent.
    limits : (low, high)
        Values at the ends of the colour map.
    colour_map : str
        A name that matplotlib knows.
    """
    from matplotlib import colormaps
    from matplotlib.colors import Normalize

    middles = (edges[1:] + edges[:-1]) / 2.0
    axes.bar(middles, shares, np.diff(edges), color=colormaps[colour_map](Normalize(*limits)(middles)))
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylabel("area, %", color=TEXT_COLOUR)
    bare(axes)


def _letter(direction: np.ndarray) -> str:
    """Letter of the patient's side that a direction points to."""
    axis = int(np.abs(direction).argmax())
    return _LETTERS[axis][int(direction[axis] > 0.0)]
