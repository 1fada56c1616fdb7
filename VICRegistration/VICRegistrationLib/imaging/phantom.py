"""Painting of synthetic MR images from closed surfaces: partial volume, texture, coil bias and noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil


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
    matrix = _checked_matrix(ijk_to_ras)
    shape = _positive_integers(shape, "image shape (nk, nj, ni)")
    parts = np.array(_positive_integers(supersampling, "supersampling (sk, sj, si)")[::-1])

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


def paint(base: np.ndarray, layers: Sequence[tuple[np.ndarray, float | np.ndarray]]) -> np.ndarray:
    """Paint layers of tissue over a background, later ones over earlier ones, mixing in partial volumes.

    Parameters
    ----------
    base : (nk, nj, ni) array
        Grey levels of the background.
    layers : sequence of (fraction, level)
        `fraction` is an (nk, nj, ni) array of values from 0 to 1, as from `volume_fractions`; `level` is a
        grey level, or an (nk, nj, ni) array of them.

    Returns
    -------
    (nk, nj, ni) float32 array
        After each layer, ``image * (1 - fraction) + level * fraction``.

    Raises
    ------
    ValueError
        If a layer does not have the shape of the background.

    Notes
    -----
    A wall is an organ's outer surface painted first and its lumen painted over it.
    """
    image = np.array(base, dtype=np.float32)
    for number, (fraction, level) in enumerate(layers, start=1):
        if np.shape(fraction) != image.shape or np.shape(level) not in ((), image.shape):
            msg = (
                f"Layer {number} has fractions of shape {np.shape(fraction)} and grey levels of shape "
                f"{np.shape(level)}; fractions of the background's shape {image.shape} and one grey level "
                "or as many are needed; compute them on the same grid."
            )
            raise ValueError(msg)
        image += np.asarray(fraction, np.float32) * (np.asarray(level, np.float32) - image)
    return image


def add_coil_bias(
    image: np.ndarray,
    ijk_to_ras: np.ndarray,
    *,
    strength: float,
    center: Sequence[float],
    width: float,
) -> np.ndarray:
    """Multiply an image by the smooth sensitivity of a receive coil.

    The sensitivity at distance d from `center` is ``1 + strength * exp(-d**2 / (2 * width**2))``.

    Parameters
    ----------
    image : (nk, nj, ni) array
        Grey levels.
    ijk_to_ras : (4, 4) array
        Affine matrix that takes voxel centres (i, j, k, 1) to RAS mm.
    strength : float
        Relative gain at the centre, above -1: 0.3 is 30 % brighter than far away.
    center : (3,) sequence
        Brightest place, RAS mm; may lie outside the image.
    width : float
        Standard deviation of the Gaussian in mm.

    Returns
    -------
    (nk, nj, ni) float32 array

    Raises
    ------
    ValueError
        If the width is not positive, or the strength would turn grey levels negative.
    """
    if not width > 0 or not strength > -1:
        msg = (
            f"The coil bias has width {width} mm and strength {strength}; "
            "a width above 0 and a strength above -1 are needed; change them."
        )
        raise ValueError(msg)
    image = np.asarray(image, dtype=np.float32)
    matrix = _checked_matrix(ijk_to_ras)
    offset = matrix[:3, 3] - np.asarray(center, dtype=float)
    k, j, i = np.ogrid[tuple(slice(n) for n in image.shape)]
    squared_distance = np.zeros(image.shape, dtype=np.float32)
    for (step_i, step_j, step_k), start in zip(matrix[:3, :3], offset):
        along_slice = (step_j * j + step_i * i).astype(np.float32)
        squared_distance += (along_slice + (step_k * k + start).astype(np.float32)) ** 2
    return image * (1 + np.float32(strength) * np.exp(squared_distance / np.float32(-2 * width**2)))


def add_rician_noise(image: np.ndarray, *, sigma: float, seed: int) -> np.ndarray:
    """Add the noise of a magnitude MR image (Gudbjartsson and Patz, Magn. Reson. Med. 34:910-914, 1995).

    Parameters
    ----------
    image : array
        Noise-free grey levels.
    sigma : float
        Standard deviation of the real and of the imaginary channel, in grey levels. In bright tissue the
        noise has this deviation; where there is no signal its mean is ``sigma * sqrt(pi / 2)``.
    seed : int
        Seed of the random numbers: the same seed gives the same image.

    Returns
    -------
    float32 array of the same shape

    Raises
    ------
    ValueError
        If sigma is negative.
    """
    if not sigma >= 0:
        msg = f"The noise level is {sigma}; a value of 0 or more is needed; change sigma."
        raise ValueError(msg)
    random = np.random.default_rng(seed)
    image = np.asarray(image, dtype=np.float32)
    real = image + np.float32(sigma) * random.standard_normal(image.shape, dtype=np.float32)
    imaginary = np.float32(sigma) * random.standard_normal(image.shape, dtype=np.float32)
    return np.hypot(real, imaginary)


def smooth_random_field(
    shape: tuple[int, int, int],
    spacing: Sequence[float],
    *,
    correlation_mm: float,
    seed: int,
) -> np.ndarray:
    """Smooth random texture, for tissue that is not evenly bright.

    White noise on a coarse grid is spread by Gaussians, one axis after the other.

    Parameters
    ----------
    shape : (nk, nj, ni)
        Shape of the image array.
    spacing : (3,) sequence
        Voxel size along i, j and k in mm.
    correlation_mm : float
        Distance at which the correlation of two places has fallen to exp(-1/2) = 0.61.
    seed : int
        Seed of the random numbers: the same seed gives the same field.

    Returns
    -------
    (nk, nj, ni) float32 array
        Mean 0 and standard deviation 1 over the array.

    Raises
    ------
    ValueError
        If the grid has a single voxel, or the correlation length is shorter than the smallest voxel side.
    """
    shape = _positive_integers(shape, "image shape (nk, nj, ni)")
    spacing = np.asarray(spacing, dtype=float)
    if np.prod(shape) < 2:
        msg = f"The texture has shape {shape}; at least two voxels are needed; enlarge the image."
        raise ValueError(msg)
    if not spacing.min() > 0 or not correlation_mm >= spacing.min():
        msg = (
            f"The correlation length is {correlation_mm} mm on voxels of {spacing.tolist()} mm; "
            "a length of at least the smallest voxel side is needed; increase it."
        )
        raise ValueError(msg)
    # Noise spread by a Gaussian of deviation s is correlated as a Gaussian of deviation s * sqrt(2).
    deviation = correlation_mm / np.sqrt(2)
    weights = [_gaussian_weights(n, step / deviation) for n, step in zip(shape, spacing[::-1])]
    field = np.random.default_rng(seed).standard_normal([w.shape[1] for w in weights], dtype=np.float32)
    for weight in weights:
        # Contracts the leading axis and puts the fine one last: after three turns the order is k, j, i again.
        field = np.tensordot(field, weight, axes=(0, 1))
    # Double sums: a float32 mean of millions of voxels is off by more than rounding.
    field -= field.mean(dtype=float)
    return field / np.float32(field.std(dtype=float))


def _gaussian_weights(count: int, step: float) -> np.ndarray:
    """Gaussians of unit deviation about unit-spaced nodes, at `count` places `step` apart: (count, nodes)."""
    places = np.arange(count) * step
    # Beyond 4 deviations a node's weight is below 4e-4.
    nodes = np.arange(-4, np.ceil(places[-1]) + 5)
    return np.exp(-0.5 * (places[:, None] - nodes) ** 2).astype(np.float32)


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
    vertices = _vertices(points)
    for k in range(int(size[2])):
        first, last = k * depth, (k + 1) * depth - 1
        # The stencil looks at every triangle for every plane that it cuts.
        stencil.SetInputData(_polydata(vertices, triangles[(low <= last + 1) & (high >= first - 1)]))
        stencil.SetOutputWholeExtent(0, int(width) - 1, 0, int(height) - 1, first, last)
        to_image.Update()
        scalars = to_image.GetOutput().GetPointData().GetScalars()
        yield vtk_to_numpy(scalars).reshape(depth, height, width)


def _block_sums(samples: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Count the samples set in each voxel of one slice, (nj, ni)."""
    per_column = samples.sum(axis=0, dtype=np.uint32)
    per_row = sum(per_column[offset :: parts[1]] for offset in range(parts[1]))
    return sum(per_row[:, offset :: parts[0]] for offset in range(parts[0]))


def _vertices(points: np.ndarray) -> vtkPoints:
    """Make vtkPoints of an array."""
    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    return vertices


def _polydata(vertices: vtkPoints, triangles: np.ndarray) -> vtkPolyData:
    """Make a vtkPolyData of triangles."""
    cells = vtkCellArray()
    cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(triangles).ravel(), deep=True))
    mesh = vtkPolyData()
    mesh.SetPoints(vertices)
    mesh.SetPolys(cells)
    return mesh


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
            f"The mesh has {open_edges} open edges; a closed surface is needed to tell inside from outside; "
            "merge its duplicate points or fill its holes."
        )
        raise ValueError(msg)
    return points, triangles


def _checked_matrix(ijk_to_ras: np.ndarray) -> np.ndarray:
    """Return a float matrix, or raise ValueError if it is no invertible 4x4 matrix."""
    matrix = np.asarray(ijk_to_ras, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or np.linalg.det(matrix[:3, :3]) == 0:
        msg = (
            f"The image matrix is {matrix.tolist()}; an invertible 4x4 matrix from (i, j, k, 1) to RAS mm is "
            "needed; take it from the image."
        )
        raise ValueError(msg)
    return matrix


def _positive_integers(values: Sequence[int], what: str) -> tuple[int, int, int]:
    """Return three positive ints, or raise ValueError."""
    numbers = np.asarray(values)
    if numbers.shape != (3,) or not np.issubdtype(numbers.dtype, np.integer) or numbers.min() < 1:
        msg = f"The {what} is {values}; three whole numbers above 0 are needed; change it."
        raise ValueError(msg)
    return tuple(int(number) for number in numbers)
