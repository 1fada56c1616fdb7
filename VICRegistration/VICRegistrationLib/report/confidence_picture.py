"""Picture of how sure a surface is of its place: coloured by its standard deviation, and the histogram."""

from __future__ import annotations

import numpy as np

from ..geometry.triangles import area_vectors
from ..geometry.triangulation import TriangleMesh
from .canvas import TEXT_COLOUR, blank_figure
from .coloured_surface import draw_colour_bar, draw_shares, draw_sides
from .deviation_picture import colour_limit

COLOUR_MAP = "viridis"
_BINS = 50


def confidence_map(mesh: TriangleMesh, deviations: np.ndarray):
    """Draw the surface from four sides in the colours of its standard deviation, and the histogram.

    Parameters
    ----------
    mesh : TriangleMesh
        Of the fitted surface, RAS mm. Small triangles look smooth.
    deviations : (n,) ndarray
        Standard deviation of its vertices along the normal, mm.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    figure = blank_figure((11.0, 4.8))
    limit = colour_limit(deviations)
    shown = np.minimum(deviations, limit)
    draw_sides(figure, (0.01, 0.50, 0.98, 0.445), mesh, shown, limits=(0.0, limit), colour_map=COLOUR_MAP)
    label = "standard deviation of the surface along its normal, mm"
    extend = "max" if deviations.max() > limit else "neither"
    place = (0.25, 0.455, 0.50, 0.024)
    draw_colour_bar(figure, place, limits=(0.0, limit), colour_map=COLOUR_MAP, label=label, extend=extend)
    _draw_histogram(figure.add_axes((0.17, 0.10, 0.66, 0.22)), *values_and_areas(mesh, deviations), limit)
    return figure


def values_and_areas(mesh: TriangleMesh, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value and area of every triangle, since vertices are denser where triangles are small.

    Parameters
    ----------
    mesh : TriangleMesh
    values : (n,) ndarray
        At the vertices.

    Returns
    -------
    values : (m,) ndarray
        Means of the triangles' corners.
    areas : (m,) ndarray
        mm^2.
    """
    areas = np.linalg.norm(area_vectors(mesh.points, mesh.triangles), axis=1)
    return values[mesh.triangles].mean(axis=1), areas


def area_percentiles(mesh: TriangleMesh, values: np.ndarray, percents: tuple[float, ...]) -> list[float]:
    """Values that shares of the surface's area stay below.

    Parameters
    ----------
    mesh : TriangleMesh
    values : (n,) ndarray
        At the vertices.
    percents : tuple of float
        From 0 to 100.

    Returns
    -------
    list of float
    """
    each, areas = values_and_areas(mesh, values)
    order = np.argsort(each)
    below = np.cumsum(areas[order])
    places = np.searchsorted(below, np.array(percents) / 100.0 * below[-1])
    return each[order][np.minimum(places, len(order) - 1)].tolist()


def _draw_histogram(axes, values: np.ndarray, areas: np.ndarray, limit: float) -> None:
    """Shares of the area in the colours of the picture; the last bars hold all that lies beyond."""
    edges = 1.1 * limit * np.linspace(0.0, 1.0, _BINS + 1)
    shares, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges, weights=100.0 * areas / areas.sum())
    draw_shares(axes, edges, shares, limits=(0.0, limit), colour_map=COLOUR_MAP)
    axes.set_xlabel("standard deviation, mm", color=TEXT_COLOUR)
