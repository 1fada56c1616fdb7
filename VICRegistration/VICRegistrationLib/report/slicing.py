"""Slices of an image along the world's planes, and the exact cuts of surfaces with them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkFiltersCore import vtkCutter, vtkStripper

from ..export.surface_data import polydata
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image
from ..imaging.sampling import Sampler


@dataclass(frozen=True)
class Orientation:
    """How a plane of the world is looked at.

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


# Radiological convention, as in Slicer's views: right is on the left of the picture, and so is anterior if sagittal.
AXIAL = Orientation("axial", (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "L", "P", "A"))
CORONAL = Orientation("coronal", (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), ("R", "L", "I", "S"))
SAGITTAL = Orientation("sagittal", (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), ("A", "P", "I", "S"))
ORIENTATIONS = (AXIAL, CORONAL, SAGITTAL)


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
    def position(self) -> str:
        """Place of the plane in words, such as "S 12.3 mm"."""
        axis = int(np.argmax(np.abs(np.cross(self.orientation.right, self.orientation.up))))
        return f"{'RAS'[axis]} {self.center[axis]:.1f} mm"

    def project(self, points: np.ndarray) -> np.ndarray:
        """Take RAS points (n, 3) to the picture's coordinates (n, 2), mm to the right and up."""
        return np.asarray(points) @ np.array([self.orientation.right, self.orientation.up]).T

    def pixels(self, count: int) -> np.ndarray:
        """RAS points (count, count, 3) at the centres of pixels, rows from bottom to top."""
        steps = ((np.arange(count) + 0.5) / count * 2.0 - 1.0) * self.half_width
        right, up = np.array(self.orientation.right), np.array(self.orientation.up)
        return self.center + steps[None, :, None] * right + steps[:, None, None] * up


def surrounding_crop(image: Image, center: np.ndarray, half_width: float) -> Image:
    """Cut out the part of an image that holds a cube of the world.

    Parameters
    ----------
    image : Image
    center : (3,) array_like
        Centre of the cube, RAS mm.
    half_width : float
        Half of the cube's edge, mm.

    Returns
    -------
    Image
        A view: two voxels or more along every axis, even where the cube leaves the volume.
    """
    corners = np.asarray(center) + half_width * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    ijk = image.to_ijk(corners)
    start = np.clip(np.floor(ijk.min(axis=0)).astype(int), 0, image.size - 2)
    stop = np.clip(np.ceil(ijk.max(axis=0)).astype(int) + 1, start + 2, image.size)
    return image.crop(start[::-1], stop[::-1])


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


def cut(mesh: TriangleMesh, view: View) -> list[np.ndarray]:
    """Cut triangles with the plane of a view.

    Parameters
    ----------
    mesh : TriangleMesh
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
