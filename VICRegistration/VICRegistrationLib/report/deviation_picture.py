"""Picture of a comparison: the surface coloured by its deviation (figure 18 of the paper), histogram and table."""

from __future__ import annotations

import os

import numpy as np

from ..analysis.comparison import Comparison
from ..geometry.triangulation import TriangleMesh
from .canvas import TEXT_COLOUR, blank_figure, literal, save_figure
from .coloured_surface import draw_colour_bar, draw_shares, draw_sides

COLOUR_MAP = "coolwarm"
_BINS = 60
# Ends of the colours, mm: the first that leaves no more than this share of the surface beyond.
_LIMITS = tuple(digit * 10.0**power for power in range(-3, 4) for digit in (1.0, 2.0, 3.0, 5.0))
_BEYOND = 0.02


def deviation_picture(
    path: str | os.PathLike, mesh: TriangleMesh, distances: np.ndarray, comparison: Comparison, name: str, against: str
) -> None:
    """Write the picture of a comparison.

    Parameters
    ----------
    path : path
        PNG file to write.
    mesh, distances, comparison, name, against
        As for `deviation_figure`.

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.
    """
    save_figure(deviation_figure(mesh, distances, comparison, name, against), path)


def deviation_figure(mesh: TriangleMesh, distances: np.ndarray, comparison: Comparison, name: str, against: str):
    """Draw the coloured surface from four sides, the histogram of the distances and a table.

    Parameters
    ----------
    mesh : TriangleMesh
        Of the fitted surface, RAS mm. Small triangles look smooth.
    distances : (n,) ndarray
        Of its vertices from the reference, mm, positive outside; from `distances_from`.
    comparison : Comparison
    name : str
        Name of the organ.
    against : str
        What it was compared with.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    figure = blank_figure((13.0, 8.4))
    figure.text(0.03, 0.968, literal(name), size=19, weight="bold", color=TEXT_COLOUR, va="top")
    figure.text(0.03, 0.922, literal(f"compared with {against}"), size=10.5, color=TEXT_COLOUR, va="top")
    limit = _draw_map(figure, mesh, distances, sides=(0.50, 0.35), bar=(0.47, 0.018))
    _draw_histogram(figure.add_axes((0.06, 0.075, 0.43, 0.29)), comparison, limit)
    _draw_table(figure, comparison)
    return figure


def deviation_map(mesh: TriangleMesh, distances: np.ndarray, comparison: Comparison):
    """Draw the coloured surface from four sides and the histogram, without words: for a page that has its own.

    Parameters
    ----------
    mesh, distances, comparison
        As for `deviation_figure`.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    RuntimeError
        If matplotlib is not installed.
    """
    figure = blank_figure((11.0, 4.8))
    limit = _draw_map(figure, mesh, distances, sides=(0.50, 0.445), bar=(0.455, 0.024))
    _draw_histogram(figure.add_axes((0.17, 0.10, 0.66, 0.22)), comparison, limit)
    return figure


def _draw_map(
    figure, mesh: TriangleMesh, distances: np.ndarray, *, sides: tuple[float, float], bar: tuple[float, float]
) -> float:
    """Draw the coloured surface and its scale, each at (bottom, height); returns the end of the colours, mm."""
    limit = colour_limit(distances)
    limits = (-limit, limit)
    draw_sides(figure, (0.01, sides[0], 0.98, sides[1]), mesh, distances, limits=limits, colour_map=COLOUR_MAP)
    label = "distance of the fitted surface from the reference, mm (positive: outside of it)"
    beyond = distances.min() < -limit, distances.max() > limit
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    place = (0.25, bar[0], 0.50, bar[1])
    draw_colour_bar(figure, place, limits=limits, colour_map=COLOUR_MAP, label=label, extend=extend)
    return limit


def colour_limit(distances: np.ndarray) -> float:
    """Round number that nearly all distances are below, for both ends of the colours, mm.

    Parameters
    ----------
    distances : (n,) ndarray

    Returns
    -------
    float
    """
    wanted = np.quantile(np.abs(distances), 1.0 - _BEYOND)
    return next((limit for limit in _LIMITS if limit >= wanted), float(wanted))


def _draw_histogram(axes, comparison: Comparison, limit: float) -> None:
    """Distances of the fitted surface's points in the colours of the picture, those of the reference's as a line."""
    from matplotlib.patches import Patch

    # A quarter more on both sides shows what lies beyond the colours; the last bars hold all the rest.
    edges = 1.25 * limit * np.linspace(-1.0, 1.0, _BINS + 1)
    shares = []
    for signed in (comparison.signed_to_reference, comparison.signed_to_surface):
        counts, _ = np.histogram(np.clip(signed, edges[0], edges[-1]), edges)
        shares.append(100.0 * counts / len(signed))
    draw_shares(axes, edges, shares[0], limits=(-limit, limit), colour_map=COLOUR_MAP)
    line = axes.stairs(shares[1], edges, color=TEXT_COLOUR, linewidth=1.1)
    axes.axvline(0.0, color="#9aa1ac", linewidth=0.8)
    axes.set_xlabel("signed distance, mm", color=TEXT_COLOUR)
    axes.margins(y=0.25)
    handles = {Patch(color="#c3c9d3"): "from the fitted surface", line: "from the reference"}
    axes.legend(list(handles), list(handles.values()), fontsize=8.5, frameon=False, loc="upper left")


def _draw_table(figure, comparison: Comparison) -> None:
    """Numbers in columns: both ways, then what holds for both."""
    ways = (comparison.to_surface, comparison.to_reference)
    rows = [
        ("mm", "reference\nto surface", "surface\nto reference"),
        ("mean", *(f"{way.mean:.2f}" for way in ways)),
        ("standard deviation", *(f"{way.std:.2f}" for way in ways)),
        ("root mean square", *(f"{way.rms:.2f}" for way in ways)),
        ("median", *(f"{way.median:.2f}" for way in ways)),
        ("95th percentile", *(f"{way.p95:.2f}" for way in ways)),
        ("largest", *(f"{way.maximum:.2f}" for way in ways)),
        ("mean with sign", *(f"{way.mean_signed:+.2f}" for way in ways)),
    ]
    for number, row in enumerate(rows):
        for x, text, side in zip((0.54, 0.735, 0.825), row, ("left", "right", "right")):
            figure.text(x, 0.365 - 0.036 * number, text, size=10, color=TEXT_COLOUR, ha=side, va="baseline")
    others = [
        ("surface Dice", *(f"{share:.3f} at {tolerance:g} mm" for tolerance, share in comparison.surface_dice)),
        ("volume Dice", f"{comparison.volume_dice:.3f}"),
        ("volume", f"{comparison.volume_ml:.1f} ml", f"reference {comparison.reference_ml:.1f} ml"),
    ]
    top = 0.365
    for title, *lines in others:
        figure.text(0.86, top, title, size=10, weight="bold", color=TEXT_COLOUR, va="baseline")
        for number, line in enumerate(lines, start=1):
            figure.text(0.86, top - 0.032 * number, line, size=10, color=TEXT_COLOUR, va="baseline")
        top -= 0.032 * len(lines) + 0.045
