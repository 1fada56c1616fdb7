"""Planes through an image along its own axes, with the grey levels and the contours of surfaces in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import polar
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkFiltersCore import vtkCutter, vtkStripper

from ..analysis.reference_meshes import ReferenceMesh
from ..geometry.polydata import polydata
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image
from ..imaging.sampling import Sampler

# Margin around the surfaces on each side, mm.
_MARGIN_MM = 18.0
# A stack that is turned by no more than this, degrees, is not called oblique.
STRAIGHT = 0.5


@dataclass(frozen=True)
class Orientation:
    """Orientation of a plane and of its picture.

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
        """Index of R, A or S, 0 to 2, that `across` is nearest to."""
        return int(np.argmax(self.across))


# Radiological convention, as in Slicer's views: right is on the left of the picture, or anterior in sagittal planes.
AXIAL = Orientation("axial", (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "L", "P", "A"))
CORONAL = Orientation("coronal", (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), ("R", "L", "I", "S"))
SAGITTAL = Orientation("sagittal", (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), ("A", "P", "I", "S"))
ORIENTATIONS = (AXIAL, CORONAL, SAGITTAL)


def orientations_of(image: Image) -> tuple[Orientation, Orientation, Orientation]:
    """Choose planes along the image's own axes, in which it is sharpest and fills the picture.

    Parameters
    ----------
    image : Image

    Returns
    -------
    tuple of Orientation
        Nearest to axial, coronal and sagittal, with "oblique" in their names where the image is turned.
    """
    grid = image.canonical()
    # The rotation nearest to the directions of a grid that may be sheared.
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


def views_of(
    meshes: Sequence[TriangleMesh | ReferenceMesh], orientations: Sequence[Orientation] = ORIENTATIONS
) -> list[View]:
    """Choose a square of each orientation around surfaces.

    Parameters
    ----------
    meshes : sequence of TriangleMesh or ReferenceMesh
        One or more, RAS mm.
    orientations : sequence of three Orientation
        Axial, coronal and sagittal, or nearest to them.

    Returns
    -------
    list of View
        Of one size, in the planes nearest to the middle that cut the most of the surfaces.
    """
    low, high = _extents(meshes, orientations)
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
        At a quarter, a half and three quarters of the part of the surface that the image shows.
    """
    orientations = orientations_of(image)
    grid = image.canonical()
    thickest = int(np.argmax(grid.spacing))
    number = next(number for number, each in enumerate(ORIENTATIONS) if each.axis == thickest)
    low, high = (ends[0] for ends in _extents([mesh], orientations))
    half_width = float((high - low).max()) / 2.0 + _MARGIN_MM
    ends = np.tile((grid.size - 1) / 2.0, (2, 1))
    ends[:, thickest] = 0.0, grid.size[thickest] - 1.0
    slices = grid.to_ras(ends) @ orientations[number].across
    first, last = max(low[number], slices.min()), min(high[number], slices.max())
    views = []
    for share in (0.25, 0.5, 0.75):
        place = (low + high) / 2.0
        place[number] = first + share * (last - first)
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
