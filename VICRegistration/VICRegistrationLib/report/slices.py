"""Slices of an image along its own axes, with cuts of surfaces, points, and the outline of a region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import polar
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkFiltersCore import vtkCutter, vtkStripper

from ..analysis.distances import ReferenceMesh
from ..geometry.polydata import polydata
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .figure import axes_at, literal, scale_length

_OUTSIDE_COLOUR, _DARK, _REGION_COLOUR = "#1b1f27", "#101318", "#ffffff"
_MARGIN_MM = 18.0
# A point is drawn as lying in a slice if it is no farther from it: about as wide as its mark.
_NEAR_MM = 2.0
# Below it, degrees, nobody would call a stack oblique.
STRAIGHT = 0.5
# Height of the strip of names below the slices, inches.
LEGEND_HEIGHT = 0.32


@dataclass(frozen=True)
class Orientation:
    """How a plane is looked at.

    Parameters
    ----------
    name : str
    right, up : (3,) tuple
        Directions of the picture, RAS.
    labels : (left, right, bottom, top)
        Letters of the patient's sides at the edges of the picture.
    """

    name: str
    right: tuple[float, float, float]
    up: tuple[float, float, float]
    labels: tuple[str, str, str, str]

    @property
    def across(self) -> np.ndarray:
        """Unit vector (3,) from one plane to the next, RAS, towards right, anterior or superior."""
        normal = np.cross(self.right, self.up)
        return normal * np.sign(normal[np.argmax(np.abs(normal))])

    @property
    def axis(self) -> int:
        """Which of R, A and S `across` is, or is nearest to, 0 to 2."""
        return int(np.argmax(self.across))


# Radiological convention, as in Slicer's views: right is on the left of the picture, and so is anterior if sagittal.
AXIAL = Orientation("axial", (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "L", "P", "A"))
CORONAL = Orientation("coronal", (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), ("R", "L", "I", "S"))
SAGITTAL = Orientation("sagittal", (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), ("A", "P", "I", "S"))
ORIENTATIONS = (AXIAL, CORONAL, SAGITTAL)


def orientations_of(image: Image) -> tuple[Orientation, Orientation, Orientation]:
    """Choose how an image is shown: along its own axes, so that each picture is as sharp and as full as the image.

    Parameters
    ----------
    image : Image

    Returns
    -------
    tuple of Orientation
        Nearest to axial, coronal and sagittal, with "oblique" in their names where the image is turned.
    """
    grid = image.canonical()
    # What is nearest to the directions of a sheared grid and at right angles.
    turn, _ = polar(grid.ijk_to_ras[:3, :3] / grid.spacing)
    oblique = np.degrees(np.arccos(np.clip(np.diag(turn).min(), -1.0, 1.0))) > STRAIGHT
    return tuple(
        replace(
            plane,
            name=f"{plane.name} oblique" if oblique else plane.name,
            right=tuple(turn @ plane.right),
            up=tuple(turn @ plane.up),
        )
        for plane in ORIENTATIONS
    )


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
        Whether it is something to compare with: a thin dashed line on top of the others.
    """

    mesh: TriangleMesh | ReferenceMesh
    colour: str
    label: str
    thin: bool = False

    @property
    def width(self) -> float:
        """Width of the line, points: one on top of the other, both are seen."""
        return 0.9 if self.thin else 2.8

    @property
    def style(self):
        """Style of the line, of matplotlib: through the gaps the colour of the line below is seen."""
        return (0, (5.0, 3.0)) if self.thin else "solid"


@dataclass(frozen=True, eq=False)
class Marks:
    """Points that a user gave.

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


@dataclass(frozen=True, eq=False)
class View:
    """A square of a plane through a point.

    Parameters
    ----------
    orientation : Orientation
    center : (3,) ndarray
        RAS mm.
    half_width : float
        Half of the edge of the square, mm.
    """

    orientation: Orientation
    center: np.ndarray
    half_width: float

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the square in the picture's coordinates, mm."""
        x, y = self.project(self.center[None])[0]
        return x - self.half_width, x + self.half_width, y - self.half_width, y + self.half_width

    @property
    def title(self) -> str:
        """Name of the plane and place of its middle, such as "axial" above "S 12.3 mm"."""
        axis = self.orientation.axis
        return f"{self.orientation.name}\n{'RAS'[axis]} {self.center[axis]:.1f} mm"

    def project(self, points: np.ndarray) -> np.ndarray:
        """Take RAS points (n, 3) to the picture's coordinates (n, 2), mm to the right and up."""
        return np.asarray(points) @ np.array([self.orientation.right, self.orientation.up]).T

    def pixels(self, count: int) -> np.ndarray:
        """RAS points (count, count, 3) at the centres of pixels, rows from bottom to top."""
        steps = ((np.arange(count) + 0.5) / count * 2.0 - 1.0) * self.half_width
        right, up = np.array(self.orientation.right), np.array(self.orientation.up)
        return self.center + steps[None, :, None] * right + steps[:, None, None] * up


def slice_of(sampler: Sampler, view: View, *, count: int = 400) -> np.ma.MaskedArray:
    """Reformat an image to a view.

    Parameters
    ----------
    sampler : Sampler
    view : View
    count : int
        Number of pixels along each edge.

    Returns
    -------
    (count, count) masked array
        Grey levels, rows from bottom to top, masked outside of the volume.
    """
    values, valid = sampler.values(view.pixels(count))
    return np.ma.array(values, mask=~valid)


def cut(mesh: TriangleMesh | ReferenceMesh, view: View) -> list[np.ndarray]:
    """Cut triangles with the plane of a view.

    Parameters
    ----------
    mesh : TriangleMesh or ReferenceMesh
        RAS mm.
    view : View

    Returns
    -------
    list of (n, 2) ndarray
        Lines in the picture's coordinates, mm; closed lines end where they start.
    """
    plane = vtkPlane()
    plane.SetOrigin(*view.center)
    plane.SetNormal(*np.cross(view.orientation.right, view.orientation.up))
    cutter = vtkCutter()
    cutter.SetInputData(polydata(mesh.points, mesh.triangles))
    cutter.SetCutFunction(plane)
    stripper = vtkStripper()
    stripper.SetInputConnection(cutter.GetOutputPort())
    stripper.SetMaximumLength(1_000_000)
    stripper.Update()
    lines = stripper.GetOutput()
    if not lines.GetNumberOfLines():
        return []
    points = view.project(vtk_to_numpy(lines.GetPoints().GetData()))
    offsets = vtk_to_numpy(lines.GetLines().GetOffsetsArray())
    numbers = np.split(vtk_to_numpy(lines.GetLines().GetConnectivityArray()), offsets[1:-1])
    return [points[line] for line in numbers]


def views_of(contours: Sequence[Contour], orientations: Sequence[Orientation] = ORIENTATIONS) -> list[View]:
    """Choose a square of each orientation around surfaces.

    Parameters
    ----------
    contours : sequence of Contour
        One or more.
    orientations : sequence of three Orientation
        Axial, coronal and sagittal, or nearest to them.

    Returns
    -------
    list of View
        Of one size, in the planes nearest to the middle that cut the most of the surfaces.
    """
    low, high = _extents([contour.mesh for contour in contours], orientations)
    middle = (low.min(axis=0) + high.max(axis=0)) / 2.0
    half_width = float((high.max(axis=0) - low.min(axis=0)).max()) / 2.0 + _MARGIN_MM
    views = []
    for number, orientation in enumerate(orientations):
        place = middle.copy()
        place[number] = _cutting_most(low[:, number], high[:, number], middle[number])
        views.append(_view(orientations, orientation, place, half_width))
    return views


def views_in_own_plane(image: Image, mesh: TriangleMesh) -> list[View]:
    """Choose three squares around a surface in the plane of an image's slices.

    Parameters
    ----------
    image : Image
    mesh : TriangleMesh
        RAS mm.

    Returns
    -------
    list of View
        At a quarter, a half and three quarters of the surface's extent across the slices.
    """
    orientations = orientations_of(image)
    grid = image.canonical()
    thickest = int(np.argmax(grid.spacing))
    number = next(number for number, each in enumerate(ORIENTATIONS) if each.axis == thickest)
    low, high = (ends[0] for ends in _extents([mesh], orientations))
    half_width = float((high - low).max()) / 2.0 + _MARGIN_MM
    views = []
    for share in (0.25, 0.5, 0.75):
        place = (low + high) / 2.0
        place[number] = low[number] + share * (high[number] - low[number])
        views.append(_view(orientations, orientations[number], place, half_width))
    return views


def _extents(meshes: Sequence[TriangleMesh], orientations: Sequence[Orientation]) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest place of each mesh across each orientation's planes (n, 3), mm."""
    across = np.array([orientation.across for orientation in orientations]).T
    places = [mesh.points @ across for mesh in meshes]
    return np.array([each.min(axis=0) for each in places]), np.array([each.max(axis=0) for each in places])


def _view(orientations: Sequence[Orientation], orientation: Orientation, place: np.ndarray, half_width: float) -> View:
    """View whose middle is given by its places across the orientations' planes (3,), mm."""
    return View(orientation, place @ np.array([each.across for each in orientations]), half_width)


def _cutting_most(low: np.ndarray, high: np.ndarray, middle: float) -> float:
    """Place in the most of several intervals (n,), the one nearest to the middle of all of them."""
    ends = np.sort(np.concatenate([low, high]))
    places = np.array([middle, *((ends[1:] + ends[:-1]) / 2.0)])
    counts = ((low < places[:, None]) & (places[:, None] < high)).sum(axis=1)
    return float(min(places[counts == counts.max()], key=lambda place: abs(place - middle)))


def draw_slices(
    figure,
    top: float,
    image: Image,
    contours: Sequence[Contour],
    *,
    marks: Sequence[Marks] = (),
    region: Image | None = None,
    views: Sequence[View] | None = None,
) -> float:
    """Draw three slices along the image's axes, or three others, side by side, on one scale, and what is in them.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The slices take its whole width.
    top : float
        Upper edge of the slices, inches from below.
    image : Image
    contours : sequence of Contour
        The slices go through the middle of those that are not thin: one or more.
    marks : sequence of Marks
        A point is drawn in all slices within 2 mm of it, or half the distance of the image's slices; if there is none,
        hollow in the nearest one.
    region : Image, optional
        A mask whose outline is drawn too.
    views : sequence of three View, optional
        Other slices.

    Returns
    -------
    float
        Lower edge of the legend below the slices, inches from below.
    """
    if views is None:
        views = views_of([contour for contour in contours if not contour.thin], orientations_of(image))
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
    return top - side - LEGEND_HEIGHT


def _draw_region(axes, sampler: Sampler, view: View) -> None:
    inside = slice_of(sampler, view, count=300).filled(0.0)
    if inside.max() > 0.5 > inside.min():
        style = {"colors": [_REGION_COLOUR], "linewidths": 0.8, "linestyles": "dotted"}
        axes.contour(inside, levels=[0.5], origin="lower", extent=view.extent, **style)


def _draw_marks(all_axes, views: Sequence[View], marks: Sequence[Marks], near: float) -> None:
    """Points in the slices within a distance of them, mm; others hollow in the nearest slice."""
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
    """Letters of the patient's sides, the name of the view and a scale."""
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
    """White text that can be read on any grey."""
    from matplotlib.patheffects import withStroke

    outline = [withStroke(linewidth=2.6, foreground=_DARK)]
    axes.text(x, y, text, transform=axes.transAxes, color="white", path_effects=outline, **style)


def _draw_legend(figure, top: float, contours: Sequence[Contour], marks: Sequence[Marks], *, with_region: bool) -> None:
    """Names in a dark strip below the slices, where they cover nothing."""
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
    strip = axes_at(figure, 0.2, top - LEGEND_HEIGHT, width - 0.4, LEGEND_HEIGHT - 0.04)
    strip.set(facecolor=_OUTSIDE_COLOUR, xticks=[], yticks=[])
    style = {"fontsize": 9, "labelcolor": "white", "frameon": False, "borderpad": 0.0, "borderaxespad": 0.0}
    legend = strip.legend(handles, ["-"] * len(labels), loc="center", ncol=max(len(labels), 1), **style)
    # Set only now: matplotlib leaves labels out that begin with an underscore.
    for text, label in zip(legend.get_texts(), labels):
        text.set_text(literal(label))
