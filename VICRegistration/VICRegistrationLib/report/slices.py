"""Pictures of slices of an image, with contours of surfaces, points, and the outline of a region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..analysis.reference_meshes import ReferenceMesh
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .figure import axes_at, literal, scale_length
from .views import View, cut, orientations_of, slice_of, views_of

_OUTSIDE_COLOUR, _DARK, _REGION_COLOUR = "#1b1f27", "#101318", "#ffffff"
# A point this close to a slice is drawn as lying in it; about the width of its mark.
_NEAR_MM = 2.0
# Height of the strip of names below the slices, inches.
_LEGEND_HEIGHT = 0.32


@dataclass(frozen=True, eq=False)
class Contour:
    """A surface that is cut by the slices.

    Parameters
    ----------
    mesh : TriangleMesh or ReferenceMesh
        RAS mm.
    colour : str
        As "#rrggbb".
    label : str
        For the legend; empty for none.
    thin : bool
        Whether it is a reference: a thin dashed line on top of the others.
    """

    mesh: TriangleMesh | ReferenceMesh
    colour: str
    label: str
    thin: bool = False

    @property
    def width(self) -> float:
        """Width of the line, points: thin lines do not hide thick ones."""
        return 0.9 if self.thin else 2.8

    @property
    def style(self):
        """Line style of matplotlib: the gaps of a dashed line show the line below."""
        return (0, (5.0, 3.0)) if self.thin else "solid"


@dataclass(frozen=True, eq=False)
class Marks:
    """Points that the user gave.

    Parameters
    ----------
    points : (n, 3) array_like
        RAS mm.
    label : str
        For the legend.
    colour : str
        As "#rrggbb".
    marker : str
        Of matplotlib.
    """

    points: np.ndarray
    label: str
    colour: str
    marker: str


def draw_slices(
    figure,
    top: float,
    image: Image,
    contours: Sequence[Contour],
    *,
    marks: Sequence[Marks] = (),
    region: Image | None = None,
    views: Sequence[View] | None = None,
) -> None:
    """Draw three slices along the image's axes, or three others, side by side on one scale, with contours and points.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The slices take its whole width.
    top : float
        Upper edge of the slices, inches from below.
    image : Image
    contours : sequence of Contour
        One or more that are not thin; the slices pass through their middle.
    marks : sequence of Marks
        A point is drawn in all slices within 2 mm of it, or within half the distance of the image's slices; if there
        is none, hollow in the nearest one.
    region : Image, optional
        A mask whose outline is drawn too.
    views : sequence of three View, optional
        Other slices.
    """
    if views is None:
        views = views_of([contour.mesh for contour in contours if not contour.thin], orientations_of(image))
    slices = [slice_of(Sampler(image), view) for view in views]
    known = np.concatenate([grey.compressed() for grey in slices])
    window = np.percentile(known, (1.0, 99.5)) if len(known) else (0.0, 1.0)
    width = figure.get_size_inches()[0]
    side, gap = (width - 0.4) / 3.0 - 0.1, 0.15
    for number, (view, grey) in enumerate(zip(views, slices)):
        axes = axes_at(figure, 0.2 + number * (side + gap), top - side, side, side)
        axes.set_facecolor(_OUTSIDE_COLOUR)
        style = {"cmap": "gray", "vmin": window[0], "vmax": window[1], "interpolation": "bilinear"}
        axes.imshow(grey, origin="lower", extent=view.extent, **style)
        if region is not None:
            _draw_region(axes, Sampler(region), view)
        for contour in sorted(contours, key=lambda contour: contour.thin):
            for line in cut(contour.mesh, view):
                style = {"linestyle": contour.style, "linewidth": contour.width, "solid_joinstyle": "round"}
                axes.plot(*line.T, color=contour.colour, **style)
        _annotate(axes, view)
    _draw_marks(figure.axes[-3:], views, marks, max(_NEAR_MM, float(image.spacing.max()) / 2.0))
    _draw_legend(figure, top - side, contours, marks, with_region=region is not None)


def _draw_region(axes, sampler: Sampler, view: View) -> None:
    inside = slice_of(sampler, view, count=300).filled(0.0)
    if inside.max() > 0.5 > inside.min():
        style = {"colors": [_REGION_COLOUR], "linewidths": 0.8, "linestyles": "dotted"}
        axes.contour(inside, levels=[0.5], origin="lower", extent=view.extent, **style)


def _draw_marks(all_axes, views: Sequence[View], marks: Sequence[Marks], near: float) -> None:
    """Draw points in the slices within a distance of them, mm; others hollow in the nearest slice."""
    for kind in marks:
        points = np.reshape(np.asarray(kind.points, dtype=float), (-1, 3))
        away = np.array([np.abs((points - view.center) @ view.orientation.across) for view in views])
        nearest = (away == away.min(axis=0)) & (away > near)
        for axes, view, within, hollow in zip(all_axes, views, away <= near, nearest):
            for chosen, face in ((within, kind.colour), (hollow, "none")):
                style = {"marker": kind.marker, "s": 30, "facecolor": face, "zorder": 5}
                places = view.project(points[chosen])
                axes.scatter(*places.T, edgecolor=_DARK, linewidth=2.2, **style)
                axes.scatter(*places.T, edgecolor=kind.colour, linewidth=1.0, **style)


def _annotate(axes, view: View) -> None:
    """Write the patient's sides, the name of the view and a scale bar."""
    left, right, bottom, top = view.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)
    places = ((0.02, 0.5, "left", "center"), (0.98, 0.5, "right", "center"))
    places += ((0.5, 0.02, "center", "bottom"), (0.5, 0.98, "center", "top"))
    for letter, (x, y, horizontal, vertical) in zip(view.orientation.labels, places):
        _write(axes, x, y, letter, size=12, weight="bold", ha=horizontal, va=vertical)
    _write(axes, 0.02, 0.98, view.title, size=9.5, ha="left", va="top")
    length = scale_length(view.half_width)
    x, y = right - 0.04 * (right - left), bottom + 0.05 * (top - bottom)
    axes.plot([x - length, x], [y, y], color="white", linewidth=2.2, solid_capstyle="butt")
    _write(axes, 0.96 - length / (right - left) / 2.0, 0.065, f"{length} mm", size=9, ha="center", va="bottom")


def _write(axes, x: float, y: float, text: str, **style) -> None:
    """Write white text with a dark outline."""
    from matplotlib.patheffects import withStroke

    outline = [withStroke(linewidth=2.6, foreground=_DARK)]
    axes.text(x, y, text, transform=axes.transAxes, color="white", path_effects=outline, **style)


def _draw_legend(figure, top: float, contours: Sequence[Contour], marks: Sequence[Marks], *, with_region: bool) -> None:
    """Write the legend in a dark strip below the slices."""
    from matplotlib.lines import Line2D

    named = [contour for contour in contours if contour.label]
    handles = [Line2D([], [], color=contour.colour, lw=contour.width, ls=contour.style) for contour in named]
    labels = [contour.label for contour in named]
    if with_region:
        handles.append(Line2D([], [], color=_REGION_COLOUR, lw=1.0, ls=":"))
        labels.append("separated region")
    for kind in marks:
        if len(kind.points):
            handles.append(Line2D([], [], ls="", marker=kind.marker, color=kind.colour, ms=5.0))
            labels.append(f"{kind.label} (hollow: beside the slice)")
    width, _ = figure.get_size_inches()
    strip = axes_at(figure, 0.2, top - _LEGEND_HEIGHT, width - 0.4, _LEGEND_HEIGHT - 0.04)
    strip.set(facecolor=_OUTSIDE_COLOUR, xticks=[], yticks=[])
    style = {"fontsize": 9, "labelcolor": "white", "frameon": False, "borderpad": 0.0, "borderaxespad": 0.0}
    legend = strip.legend(handles, ["-"] * len(labels), loc="center", ncol=max(len(labels), 1), **style)
    # Set afterwards, because matplotlib omits labels that begin with an underscore.
    for text, label in zip(legend.get_texts(), labels):
        text.set_text(literal(label))
