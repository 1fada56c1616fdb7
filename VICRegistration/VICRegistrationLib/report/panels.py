"""Parts of pictures: slices with contours, lit surfaces, the convergence. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..analysis.distances import Reference, ReferenceMesh
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh, triangulate
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from ..registration.organ import OrganFit
from .canvas import TEXT_COLOUR, bare, literal
from .shading import Camera, shaded_triangles
from .slicing import ORIENTATIONS, View, cut, slice_of, surrounding_crop

_REGION_COLOUR = "#ffffff"
_OUTSIDE_COLOUR = "#1b1f27"
# As many as there are stages at most: of three nets, the coarser one kept, boundary points.
_STAGE_COLOURS = (
    *("#8a93a3", "#4d7fb8", "#2a9d8f", "#d1495b", "#7d5ba6"),
    *("#e09f3e", "#7f5539", "#1d3557", "#7a8b2e", "#c77dba", "#3a3f47", "#e56b6f"),
)
_FEW_STAGES = 7
_MARGIN_MM = 18.0


@dataclass(frozen=True, eq=False)
class Shown:
    """One surface of a picture.

    Parameters
    ----------
    mesh : TriangleMesh or ReferenceMesh
        RAS mm. Only a TriangleMesh can be lit; slices take both.
    colour : str
        As "#rrggbb".
    label : str
        For the legend; empty for none.
    dashed : bool
        Whether its contour in slices is dashed.
    """

    mesh: TriangleMesh | ReferenceMesh
    colour: str
    label: str
    dashed: bool = False


def fine_mesh(shape: Reference) -> TriangleMesh | ReferenceMesh:
    """Triangles small enough to look smooth.

    Parameters
    ----------
    shape : BSplineSurface, TriangleMesh or ReferenceMesh
        RAS mm.

    Returns
    -------
    TriangleMesh or ReferenceMesh
        Triangles are left as they are.
    """
    return triangulate(shape, resolution=(128, 80)) if isinstance(shape, BSplineSurface) else shape


def _framing(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and half width (mm) of a cube around boxes (n, 3), with a margin."""
    low, high = low.min(axis=0), high.max(axis=0)
    return (low + high) / 2.0, float((high - low).max()) / 2.0 + _MARGIN_MM


def _views(low: np.ndarray, high: np.ndarray) -> list[View]:
    """Squares around boxes (n, 3), in the planes nearest to the middle that cut the most of them."""
    center, half_width = _framing(low, high)
    views = []
    for orientation in ORIENTATIONS:
        normal = np.abs(np.cross(orientation.right, orientation.up)).argmax()
        place = center.copy()
        place[normal] = _cutting_most(low[:, normal], high[:, normal], center[normal])
        views.append(View(orientation, place, half_width))
    return views


def _cutting_most(low: np.ndarray, high: np.ndarray, middle: float) -> float:
    """Place in the most of several intervals (n,), the one nearest to the middle of all of them."""
    ends = np.sort(np.concatenate([low, high]))
    places = np.array([middle, *((ends[1:] + ends[:-1]) / 2.0)])
    counts = ((low < places[:, None]) & (places[:, None] < high)).sum(axis=1)
    return float(min(places[counts == counts.max()], key=lambda place: abs(place - middle)))


def draw_slices(
    figure,
    row: tuple[float, float],
    image: Image,
    framed: Sequence[Shown],
    contours: Sequence[Shown],
    *,
    region: Image | None = None,
) -> None:
    """Draw axial, coronal and sagittal slices of some surfaces side by side, on one scale of mm and of grey.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    row : (bottom, height)
        Of the slices, in fractions of the figure.
    image : Image
    framed : sequence of Shown
        What the slices go through the middle of.
    contours : sequence of Shown
        What is drawn.
    region : Image, optional
        A mask whose outline is drawn too.
    """
    low = np.array([shown.mesh.points.min(axis=0) for shown in framed])
    high = np.array([shown.mesh.points.max(axis=0) for shown in framed])
    views = _views(low, high)
    sampler = Sampler(surrounding_crop(image, *_framing(low, high)))
    region_sampler = None if region is None else Sampler(region)
    slices = [slice_of(sampler, view) for view in views]
    known = np.concatenate([grey.compressed() for grey in slices])
    window = np.percentile(known, (1.0, 99.5)) if len(known) else (0.0, 1.0)
    for number, (view, grey) in enumerate(zip(views, slices)):
        axes = figure.add_axes((0.02 + 0.325 * number, row[0], 0.31, row[1]))
        axes.set_facecolor(_OUTSIDE_COLOUR)
        axes.imshow(
            grey,
            origin="lower",
            extent=view.extent,
            cmap="gray",
            vmin=window[0],
            vmax=window[1],
            interpolation="bilinear",
        )
        if region_sampler is not None:
            _draw_region(axes, region_sampler, view)
        for shown in contours:
            _draw_contour(axes, shown, view)
        _annotate_slice(axes, view)
    _draw_legend(figure.axes[-3], contours, with_region=region is not None)


def _draw_region(axes, sampler: Sampler, view: View) -> None:
    inside = slice_of(sampler, view, count=300).filled(0.0)
    if inside.max() > 0.5 > inside.min():
        axes.contour(
            inside,
            levels=[0.5],
            origin="lower",
            extent=view.extent,
            colors=[_REGION_COLOUR],
            linewidths=0.8,
            linestyles="dotted",
        )


def _draw_contour(axes, shown: Shown, view: View) -> None:
    for line in cut(shown.mesh, view):
        style = {"linestyle": (0, (3, 2)), "linewidth": 1.1} if shown.dashed else {"linewidth": 1.7}
        axes.plot(*line.T, color=shown.colour, solid_joinstyle="round", **style)


def _annotate_slice(axes, view: View) -> None:
    """Letters of the patient's sides, the name of the view and a scale."""
    left, right, bottom, top = view.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)
    places = ((0.02, 0.5, "left", "center"), (0.98, 0.5, "right", "center"))
    places += ((0.5, 0.02, "center", "bottom"), (0.5, 0.98, "center", "top"))
    for letter, (x, y, horizontal, vertical) in zip(view.orientation.labels, places):
        _text(axes, x, y, letter, size=12, weight="bold", ha=horizontal, va=vertical)
    _text(axes, 0.02, 0.98, f"{view.orientation.name}  {view.position}", size=9.5, ha="left", va="top")
    length = _scale_length(view.half_width)
    x, y = right - 0.04 * (right - left), bottom + 0.05 * (top - bottom)
    axes.plot([x - length, x], [y, y], color="white", linewidth=2.2, solid_capstyle="butt")
    _text(axes, 0.96 - length / (right - left) / 2.0, 0.065, f"{length} mm", size=9, ha="center", va="bottom")


def _text(axes, x: float, y: float, text: str, **style) -> None:
    """White text that can be read on any grey."""
    from matplotlib.patheffects import withStroke

    outline = [withStroke(linewidth=2.6, foreground="#101318")]
    axes.text(x, y, text, transform=axes.transAxes, color="white", path_effects=outline, **style)


def _scale_length(half_width: float) -> int:
    """Length of a scale bar that takes up to a third of the width, mm."""
    return max((length for length in (5, 10, 20, 50, 100) if length <= 0.66 * half_width), default=5)


def _draw_legend(axes, contours: Sequence[Shown], *, with_region: bool) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=shown.colour, lw=1.8, ls="--" if shown.dashed else "-")
        for shown in contours
        if shown.label
    ]
    labels = [shown.label for shown in contours if shown.label]
    if with_region:
        handles.append(Line2D([], [], color=_REGION_COLOUR, lw=1.0, ls=":"))
        labels.append("separated region")
    legend = axes.legend(
        handles=handles,
        labels=["-"] * len(labels),
        loc="lower left",
        fontsize=8.5,
        labelcolor="white",
        facecolor="#00000080",
        edgecolor="none",
        borderpad=0.5,
    )
    # Set only now: matplotlib leaves labels out that begin with an underscore.
    for text, label in zip(legend.get_texts(), labels):
        text.set_text(literal(label))


def draw_scene(axes, surfaces: Sequence[Shown], viewer: Sequence[float]) -> None:
    """Draw lit surfaces with a scale and the patient's directions.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    surfaces : sequence of Shown
    viewer : (r, a, s)
        From the surfaces to the viewer.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    camera = Camera.from_direction(viewer)
    corners, shades = shaded_triangles(
        [shown.mesh for shown in surfaces], [to_rgb(shown.colour) for shown in surfaces], camera
    )
    # Edges in the colour of the faces close the hairlines that antialiasing leaves between neighbours.
    triangles = PolyCollection(corners, facecolors=shades, edgecolors=shades, linewidths=0.35)
    axes.add_collection(triangles, autolim=False)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    space = 0.22 * (high - low).max()
    axes.set(xlim=(low[0] - 1.1 * space, high[0] + 0.5 * space), ylim=(low[1] - space, high[1] + 0.15 * space))
    axes.set_aspect("equal")
    axes.set_axis_off()
    origin = np.array([low[0] - 0.45 * space, low[1] - 0.45 * space])
    for direction, letter in (((-1, 0, 0), "L"), ((0, 1, 0), "A"), ((0, 0, 1), "S")):
        tip = 0.5 * space * camera.project(np.array(direction, dtype=float))
        arrow = {"arrowstyle": "-|>", "color": TEXT_COLOUR, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", xy=origin + tip, xytext=origin, arrowprops=arrow)
        axes.text(*(origin + 1.28 * tip), letter, size=10, ha="center", va="center", color=TEXT_COLOUR)
    length = _scale_length(float((high - low).max()) / 2.0)
    end = np.array([high[0] + 0.2 * space, low[1] - 0.7 * space])
    axes.plot([end[0] - length, end[0]], [end[1]] * 2, color=TEXT_COLOUR, linewidth=2.4, solid_capstyle="butt")
    axes.text(end[0] - length / 2.0, end[1] + 0.06 * space, f"{length} mm", size=9, ha="center", color=TEXT_COLOUR)


def draw_convergence(axes, fit: OrganFit) -> None:
    """Draw the cost against the iteration, stage by stage.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    fit : OrganFit
    """
    stages = list(dict.fromkeys(step.stage for step in fit.history))
    first = 1
    for number, stage in enumerate(stages):
        costs = np.array([step.cost for step in fit.history if step.stage == stage])
        colour = _STAGE_COLOURS[number % len(_STAGE_COLOURS)]
        iterations = np.arange(first, first + len(costs))
        first += len(costs)
        label = f"{stage} ({len(costs)})"
        axes.semilogy(iterations, costs, color=colour, linewidth=1.8, marker="o", markersize=3.2, label=label)
        if number:
            axes.axvline(iterations[0] - 0.5, color="#c9ced6", linewidth=0.9, zorder=0)
    axes.set_xlabel("iteration", color=TEXT_COLOUR)
    axes.set_ylabel("cost (mean squared residual / contrast²)", color=TEXT_COLOUR)
    axes.set_title(
        "Convergence: each stage has an image and a cost of its own", size=10.5, loc="left", color=TEXT_COLOUR
    )
    axes.margins(x=0.02)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.grid(axis="y", which="both", color="#e7eaee", linewidth=0.7)
    axes.set_axisbelow(True)
    bare(axes)
    size, columns, place = 9.0, 1, "best"
    if len(stages) > _FEW_STAGES:
        # Room above the curves for their names, in two columns.
        size, columns, place = 7.0, 2, "upper right"
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** (0.07 * len(stages)))
    legend = axes.legend(
        fontsize=size,
        title="stage (iterations)",
        title_fontsize=size,
        ncol=columns,
        loc=place,
        framealpha=0.85,
    )
    legend.get_frame().set_edgecolor("none")
