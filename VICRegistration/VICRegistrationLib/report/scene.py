"""Surfaces in 3D, lit and drawn by matplotlib alone: plain, coloured by point scalars, or with edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.triangles import area_vectors
from ..geometry.triangulation import TriangleMesh
from .figure import TEXT_COLOUR, axes_at, finish_axes, scale_length

_SHININESS = 30.0
# Direction to the light in the camera's frame: from above, over the viewer's left shoulder.
_LIGHT = np.array([-0.35, 0.55, 0.76])
# Ambient, diffuse and specular light. Colours that stand for scalars have no highlight, which would look like another
# value, and less shade.
_GLOSSY, _MATT = (0.34, 0.68, 0.20), (0.56, 0.46, 0.0)
_EDGE_COLOUR = "#1d2026"
_BINS = 60
# Candidates for the end of the colour range, mm; the first with at most this share of the points beyond it is used.
_LIMITS = tuple(digit * 10.0**power for power in range(-3, 4) for digit in (1.0, 2.0, 3.0, 5.0))
_BEYOND = 0.02


# Viewpoints: caption, and direction (r, a, s) to the viewer. In the first, organs of the pelvis do not hide one
# another; the second is opposite.
USUAL = ("from the left, front and above", (-0.80, 0.52, 0.30))
OPPOSITE = ("from the right, back and above", (0.80, -0.52, 0.30))
FRONT = ("from the front and above", (0.30, 0.90, 0.30))
# Together they show all of a surface; tilted, so that top and bottom are visible.
SIDES = (
    ("from the front, above", (0.0, 1.0, 0.36)),
    ("from the left, below", (-1.0, 0.0, -0.36)),
    ("from the back, above", (0.0, -1.0, 0.36)),
    ("from the right, below", (1.0, 0.0, -0.36)),
)


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of a scene.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen from outside.
    colours : (3,), (n, 3) or (m, 3) array_like
        Red, green and blue from 0 to 1: one colour, or one for each point; without normals one for each triangle.
    normals : (n, 3) ndarray, optional
        Normals of the surface at the points, for smooth shading. Without them triangles are flat and have edges.
    opacity : float
        From 0 to 1; with normals only.
    two_sided : bool
        Whether triangles are drawn from both sides, as for an open surface.
    """

    points: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray
    normals: np.ndarray | None = None
    opacity: float = 1.0
    two_sided: bool = False


@dataclass(frozen=True)
class Scale:
    """How scalars are shown as colours.

    Parameters
    ----------
    colour_map : str
        A name that matplotlib knows.
    signed : bool
        Whether zero is in the middle of the colours, or at their beginning.
    label, short : str
        Quantity and unit, below the colours and below the histogram.
    """

    colour_map: str
    signed: bool
    label: str
    short: str

    def limits(self, values: np.ndarray) -> tuple[float, float]:
        """Choose a rounded range of colours that contains 98 % of the values (n,)."""
        wanted = float(np.quantile(np.abs(values), 1.0 - _BEYOND))
        high = next((limit for limit in _LIMITS if limit >= wanted), wanted)
        return (-high if self.signed else 0.0), high


DEVIATION = Scale(
    "coolwarm",
    True,
    "distance of the fitted surface from the reference, mm (positive: outside of it)",
    "signed distance, mm",
)
CONFIDENCE = Scale("viridis", False, "standard deviation of the surface along its normal, mm", "standard deviation, mm")


def camera(towards: Sequence[float]) -> np.ndarray:
    """Directions of a picture, superior up.

    Parameters
    ----------
    towards : (r, a, s)
        From the scene to the viewer.

    Returns
    -------
    (3, 3) ndarray
        Rows: to the right, up, and to the viewer; unit vectors, RAS.
    """
    towards = np.asarray(towards, dtype=float) / np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def draw_scene(axes, shapes: Sequence[Shape], viewpoint: tuple, *, matt: bool = False, size: float = 0.0) -> None:
    """Draw lit surfaces with the patient's directions and a scale.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    shapes : sequence of Shape
        All with normals, or all without.
    viewpoint : (caption, towards)
        Text, and the direction (r, a, s) to the viewer.
    matt : bool
        Whether there is no highlight, for colours that stand for scalars.
    size : float
        Least width and height of the scene, mm, so that several scenes have one scale.
    """
    caption, towards = viewpoint
    view = camera(towards)
    low, high = _draw_triangles(axes, shapes, view, _MATT if matt else _GLOSSY)
    middle, half = (low + high) / 2.0, np.maximum(high - low, size) / 2.0
    low, high = middle - half, middle + half
    space = 0.22 * (high - low).max()
    axes.set(xlim=(low[0] - 1.1 * space, high[0] + 0.5 * space), ylim=(low[1] - space, high[1] + 0.15 * space))
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(caption, size=10, color=TEXT_COLOUR, pad=2)
    _draw_directions(axes, view, low - 0.45 * space, 0.5 * space)
    length = scale_length(float((high - low).max()) / 2.0)
    right, bottom = high[0] + 0.2 * space, low[1] - 0.7 * space
    axes.plot([right - length, right], [bottom] * 2, color=TEXT_COLOUR, linewidth=2.4, solid_capstyle="butt")
    label = {"size": 9, "ha": "center", "color": TEXT_COLOUR}
    axes.text(right - length / 2.0, bottom + 0.06 * space, f"{length} mm", **label)


def _draw_triangles(axes, shapes: Sequence[Shape], view: np.ndarray, finish) -> tuple[np.ndarray, np.ndarray]:
    """Paint triangles from back to front; returns the lower left and the upper right corner of all of them."""
    from matplotlib.collections import PolyCollection, TriMesh
    from matplotlib.tri import Triangulation

    points = np.concatenate([shape.points for shape in shapes])
    starts = np.cumsum([0, *(len(shape.points) for shape in shapes)])
    triangles = np.concatenate([shape.triangles + start for shape, start in zip(shapes, starts)])
    places = points @ view[:2].T
    (a, b), (c, d) = (np.moveaxis(places[triangles[:, corner]] - places[triangles[:, 0]], -1, 0) for corner in (1, 2))
    # Seen from outside, their corners run counter-clockwise.
    both = np.concatenate([np.full(len(shape.triangles), shape.two_sided) for shape in shapes])
    front = np.flatnonzero((a * d > b * c) | both)
    order = front[np.argsort((points @ view[2])[triangles[front]].mean(axis=1), kind="stable")]
    shades = np.concatenate([_lit(shape, view, finish) for shape in shapes])
    if shapes[0].normals is None:
        style = {"facecolors": shades[order], "edgecolors": _EDGE_COLOUR, "linewidths": 0.2}
        collection = PolyCollection(places[triangles[order]], **style)
    elif all(shape.opacity == 1.0 for shape in shapes):
        collection = TriMesh(Triangulation(*places.T, triangles[order]))
        collection.set_facecolor(np.column_stack([shades, np.ones(len(shades))]))
    else:
        # TriMesh draws the edges of translucent triangles twice. In a PolyCollection, translucent triangles need
        # antialiased edges for the same reason, and opaque ones sharp edges, or what is behind shines through.
        opacity = np.concatenate([np.full(len(shape.triangles), shape.opacity) for shape in shapes])[order]
        colours = np.column_stack([shades[triangles[order]].mean(axis=1), opacity])
        style = {"facecolors": colours, "edgecolors": "none", "antialiaseds": (opacity < 1.0).tolist()}
        collection = PolyCollection(places[triangles[order]], **style)
    axes.add_collection(collection, autolim=False)
    return places.min(axis=0), places.max(axis=0)


def _lit(shape: Shape, view: np.ndarray, finish: tuple[float, float, float]) -> np.ndarray:
    """Colours (n, 3) by the lighting model of Blinn and Phong; diffuse light reaches a little beyond the terminator."""
    normals = shape.normals
    if normals is None:
        normals = area_vectors(shape.points, shape.triangles)
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    if shape.two_sided:
        normals = np.where((normals @ view[2] < 0.0)[:, None], -normals, normals)
    ambient, diffuse, specular = finish
    light = _LIGHT @ view / np.linalg.norm(_LIGHT)
    half = (light + view[2]) / np.linalg.norm(light + view[2])
    scattered = np.clip(0.25 + 0.75 * (normals @ light), 0.0, 1.0)[:, None]
    highlight = np.clip(normals @ half, 0.0, 1.0)[:, None] ** _SHININESS
    return np.clip(np.asarray(shape.colours) * (ambient + diffuse * scattered) + specular * highlight, 0.0, 1.0)


def _draw_directions(axes, view: np.ndarray, origin: np.ndarray, length: float) -> None:
    """Draw arrows to the patient's left, anterior and superior, except those nearly along the line of sight."""
    arrow = {"arrowstyle": "-|>", "color": TEXT_COLOUR, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
    for direction, letter in (((-1, 0, 0), "L"), ((0, 1, 0), "A"), ((0, 0, 1), "S")):
        tip = view[:2] @ direction
        if np.linalg.norm(tip) > 0.4:
            axes.annotate("", xy=origin + length * tip, xytext=origin, arrowprops=arrow)
            place = origin + length * (tip + 0.28 * tip / np.linalg.norm(tip))
            axes.text(*place, letter, size=10, ha="center", va="center", color=TEXT_COLOUR)


def draw_scalars(
    figure, mesh: TriangleMesh, values: np.ndarray, scale: Scale, *, other: np.ndarray | None = None
) -> None:
    """Draw a surface from four sides coloured by point scalars, with a colour bar and a histogram.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Of at least 11 x 5.4 inches; the lower part of it is used.
    mesh : TriangleMesh
        RAS mm.
    values : (n,) ndarray
        Scalars at the points.
    scale : Scale
    other : (k,) ndarray, optional
        Distances of points that are spread evenly over the reference; a line in the histogram.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    width, _ = figure.get_size_inches()
    limits = scale.limits(values)
    colours = ScalarMappable(Normalize(*limits), colormaps[scale.colour_map])
    shape = Shape(mesh.points, mesh.triangles, colours.to_rgba(values)[:, :3], mesh.normals)
    size = 2.0 * np.linalg.norm(mesh.points - mesh.points.mean(axis=0), axis=1).max()
    side = width / len(SIDES)
    for number, viewpoint in enumerate(SIDES):
        axes = axes_at(figure, (number + 0.04) * side, 2.45, 0.92 * side, min(side, 2.7))
        draw_scene(axes, [shape], viewpoint, matt=True, size=size)
    beyond = values.min() < limits[0], values.max() > limits[1]
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    bar = figure.colorbar(
        colours, cax=axes_at(figure, width / 4.0, 2.2, width / 2.0, 0.12), orientation="horizontal", extend=extend
    )
    bar.set_label(scale.label, color=TEXT_COLOUR, size=10)
    bar.outline.set_visible(False)
    axes = axes_at(figure, width / 6.0, 0.48, width / 1.5, 1.1)
    _draw_histogram(axes, mesh, values, scale, colours, other)


def _draw_histogram(axes, mesh: TriangleMesh, values: np.ndarray, scale: Scale, colours, other) -> None:
    """Draw shares of the area in the colours of the picture; the last bars contain all larger values."""
    from matplotlib.patches import Patch

    low, high = 1.25 * np.array(scale.limits(values))
    edges = np.linspace(low, high, _BINS + 1)
    areas = np.linalg.norm(area_vectors(mesh.points, mesh.triangles), axis=1)
    each = np.clip(values[mesh.triangles].mean(axis=1), low, high)
    shares, _ = np.histogram(each, edges, weights=100.0 * areas / areas.sum())
    middles = (edges[1:] + edges[:-1]) / 2.0
    axes.bar(middles, shares, np.diff(edges), color=colours.to_rgba(middles))
    if other is not None:
        counts, _ = np.histogram(np.clip(other, low, high), edges)
        line = axes.stairs(100.0 * counts / len(other), edges, color=TEXT_COLOUR, linewidth=1.1)
        handles = {Patch(color="#c3c9d3"): "from the fitted surface", line: "from the reference"}
        beside = {"fontsize": 8.5, "frameon": False, "loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
        axes.legend(list(handles), list(handles.values()), **beside)
    axes.set_xlim(low, high)
    finish_axes(axes, x=scale.short, y="area, %")
