"""Share of each voxel that lies inside a closed mesh, and the samples of a box that do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

    Each voxel is cut into equal parts and the centres of the parts are tested, so a voxel is a box of full
    slice thickness: the slice profile is rectangular. Only the grid around the surface is worked on.

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

    Raises
    ------
    ValueError
        If the surface is empty, not finite or not closed, the matrix is singular, or a size is not positive.
    """
    points, triangles = _checked_mesh(points, triangles)
    matrix = checked_matrix(ijk_to_ras)
    shape = positive_integers(shape, "image shape (nk, nj, ni)")
    parts = np.array(positive_integers(supersampling, "supersampling (sk, sj, si)")[::-1])

    ijk = np.linalg.solve(matrix[:3, :3], (points - matrix[:3, 3]).T).T
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
    """Box in any direction.

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

    The points are in sub-voxel indices. Slice by slice, because all the sub-voxels of a large image would not fit
    into memory. The arrays are views that the next step overwrites.
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
        # The stencil looks at every triangle for every plane that it cuts.
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


def _checked_mesh(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return float points and int64 triangles, or raise ValueError if they are no closed surface."""
    points, triangles = np.asarray(points, dtype=float), np.asarray(triangles)
    shaped = points.ndim == triangles.ndim == 2 and points.shape[1] == triangles.shape[1] == 3
    if not shaped or not len(triangles) or not np.issubdtype(triangles.dtype, np.integer):
        msg = (
            f"The mesh has points of shape {points.shape} and triangles of shape {triangles.shape} and type "
            f"{triangles.dtype}; (n, 3) points and at least one (m, 3) integer triangle are needed; "
            "pass the vertices and triangles of a closed surface."
        )
        raise ValueError(msg)
    if not np.isfinite(points).all() or triangles.min() < 0 or triangles.max() >= len(points):
        msg = (
            f"The mesh of {len(points)} points has a coordinate that is not finite or a triangle that "
            "names a missing point; finite points and vertex numbers within them are needed; repair the mesh."
        )
        raise ValueError(msg)
    triangles = triangles.astype(np.int64)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges[:, 0] * len(points) + edges[:, 1], return_counts=True)
    open_edges = int(np.count_nonzero(uses % 2))
    if open_edges:
        msg = (
            f"The mesh has {open_edges} open edges; a closed surface is needed, which has an inside; "
            "merge its duplicate points or fill its holes."
        )
        raise ValueError(msg)
    return points, triangles


def checked_matrix(ijk_to_ras: np.ndarray) -> np.ndarray:
    """Return a float matrix, or raise ValueError if it is no invertible 4x4 matrix."""
    matrix = np.asarray(ijk_to_ras, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or np.linalg.det(matrix[:3, :3]) == 0:
        msg = (
            f"The image matrix is {matrix.tolist()}; an invertible 4x4 matrix from (i, j, k, 1) to RAS mm is "
            "needed; take it from the image."
        )
        raise ValueError(msg)
    return matrix


def positive_integers(values: Sequence[int], what: str) -> tuple[int, int, int]:
    """Return three positive ints, or raise ValueError."""
    numbers = np.asarray(values)
    if numbers.shape != (3,) or not np.issubdtype(numbers.dtype, np.integer) or numbers.min() < 1:
        msg = f"The {what} is {values}; three whole numbers above 0 are needed; change it."
        raise ValueError(msg)
    return tuple(int(number) for number in numbers)
