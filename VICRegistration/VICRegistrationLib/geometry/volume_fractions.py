"""Share of each voxel that lies inside a closed mesh, by VTK's stencil; and boxes of cells to measure volumes with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

from .polydata import cell_array, polydata


def volume_fractions(
    points: np.ndarray,
    triangles: np.ndarray,
    shape: tuple[int, int, int],
    ijk_to_ras: np.ndarray,
    *,
    supersampling: tuple[int, int, int] = (8, 3, 3),
) -> np.ndarray:
    """Fraction of every voxel that lies inside a closed surface.

    Each voxel is divided into equal parts whose centres are tested. So the slice profile is rectangular, with the full
    slice thickness.

    Parameters
    ----------
    points : (n, 3) array
        Vertices in RAS mm.
    triangles : (m, 3) integer array
        Vertex numbers of a closed surface; its orientation does not matter.
    shape : (nk, nj, ni)
        Shape of the image array.
    ijk_to_ras : (4, 4) array
        Affine matrix that takes voxel centres (i, j, k, 1) to RAS mm; may be oblique or left-handed.
    supersampling : (sk, sj, si), optional
        Number of parts a voxel is cut into along k, j and i.

    Returns
    -------
    (nk, nj, ni) float32 array
        Values from 0 (outside) to 1 (inside).
    """
    parts = np.array(supersampling[::-1])
    ijk = np.linalg.solve(ijk_to_ras[:3, :3], (points - ijk_to_ras[:3, 3]).T).T
    fractions = np.zeros(shape, dtype=np.float32)
    first = np.maximum(np.floor(ijk.min(axis=0) + 0.5), 0).astype(int)
    last = np.minimum(np.floor(ijk.max(axis=0) + 0.5), np.array(shape[::-1]) - 1).astype(int)
    if np.any(last < first):
        return fractions
    size = last - first + 1
    # In a voxel of `parts` sub-voxels the voxel's centre is at their mean index, (parts - 1) / 2.
    fine = (ijk - first) * parts + (parts - 1) / 2
    inside = fractions[first[2] : last[2] + 1, first[1] : last[1] + 1, first[0] : last[0] + 1]
    for k, samples in enumerate(_stencil_slabs(fine, triangles, size, parts)):
        inside[k] = _block_sums(samples, parts) / float(parts.prod())
    return fractions


@dataclass(frozen=True, eq=False)
class Box:
    """Box with any orientation.

    Parameters
    ----------
    corner : (3,) ndarray
        RAS mm.
    edges : (3, 3) ndarray
        Rows: the three edges from the corner, at right angles to each other, mm.
    """

    corner: np.ndarray
    edges: np.ndarray

    @classmethod
    def around(cls, points: np.ndarray, axes: np.ndarray, *, margin: float | np.ndarray = 0.0) -> Box:
        """Box along unit axes (rows) around points (n, 3), wider by a margin in mm on every side."""
        along = points @ axes.T
        low, high = along.min(axis=0) - margin, along.max(axis=0) + margin
        return cls(low @ axes, (high - low)[:, None] * axes)

    @property
    def lengths(self) -> np.ndarray:
        """Lengths of the edges, (3,) mm."""
        return np.linalg.norm(self.edges, axis=1)

    @property
    def axes(self) -> np.ndarray:
        """Directions of the edges, unit vectors as rows."""
        return self.edges / self.lengths[:, None]

    @property
    def volume(self) -> float:
        """Volume, mm^3."""
        return float(self.lengths.prod())

    def cells(self, count: int) -> np.ndarray:
        """Affine matrix (4, 4) from the indices of count^3 equal cells to their centres."""
        matrix = np.eye(4)
        matrix[:3, :3] = (self.edges / count).T
        matrix[:3, 3] = self.corner + self.edges.sum(axis=0) / (2.0 * count)
        return matrix

    def inside(self, points: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
        """Which of count^3 cells have their centre inside closed triangles, (count, count, count) of bool."""
        shares = volume_fractions(points, triangles, (count,) * 3, self.cells(count), supersampling=(1, 1, 1))
        return shares > 0.5


def _stencil_slabs(
    points: np.ndarray, triangles: np.ndarray, size: np.ndarray, parts: np.ndarray
) -> Iterator[np.ndarray]:
    """Yield, slice by slice, the sub-voxels inside a mesh: (sk, nj * sj, ni * si) arrays of 0 and 1.

    The points are in sub-voxel indices. All sub-voxels of a large image together would not fit into memory. The arrays
    are views that the next step overwrites.
    """
    width, height, _ = size * parts
    stencil = vtkPolyDataToImageStencil()
    to_image = vtkImageStencilToImage()
    to_image.SetInputConnection(stencil.GetOutputPort())
    to_image.SetInsideValue(1)
    to_image.SetOutsideValue(0)
    to_image.SetOutputScalarTypeToUnsignedChar()
    depth = int(parts[2])
    heights = points[triangles, 2]
    low, high = heights.min(axis=1), heights.max(axis=1)
    mesh = polydata(points, triangles)
    stencil.SetInputData(mesh)
    for k in range(int(size[2])):
        first, last = k * depth, (k + 1) * depth - 1
        # Only the triangles at this slice, because the stencil tests all of them for every plane.
        mesh.SetPolys(cell_array(triangles[(low <= last + 1) & (high >= first - 1)]))
        stencil.SetOutputWholeExtent(0, int(width) - 1, 0, int(height) - 1, first, last)
        to_image.Update()
        scalars = to_image.GetOutput().GetPointData().GetScalars()
        yield vtk_to_numpy(scalars).reshape(depth, height, width)


def _block_sums(samples: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Count the samples set in each voxel of one slice, (nj, ni)."""
    per_column = samples.sum(axis=0, dtype=np.uint32)
    per_row = sum(per_column[offset :: parts[1]] for offset in range(parts[1]))
    return sum(per_row[:, offset :: parts[0]] for offset in range(parts[0]))
