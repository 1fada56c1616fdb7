"""A volume and its position in RAS millimetres."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass

import numpy as np

# The sum of the squares of larger grey levels over a volume would overflow.
_LARGEST_LEVEL = 1e100

_SIDES = (("left", "right"), ("posterior", "anterior"), ("inferior", "superior"))


@dataclass(frozen=True, eq=False)
class Image:
    """A grey-level volume (or a mask) with the matrix that places its voxels.

    Attributes
    ----------
    array : ndarray, shape (nk, nj, ni)
        Voxels, slowest axis first, like ``SimpleITK.GetArrayFromImage``. It is not copied, so writing to it
        changes the image.
    ijk_to_ras : ndarray, shape (4, 4)
        Takes ``(i, j, k, 1)`` to RAS millimetres; integer indices are voxel centres. Any invertible affine matrix
        is allowed: anisotropic, oblique, left-handed or sheared (a tilted gantry).

    Raises
    ------
    ValueError
        If the array is not three-dimensional with at least two voxels along every axis, holds numbers that are not
        finite or above 1e100, or if the matrix is not an invertible affine one.

    Examples
    --------
    Sagittal slices of 4 mm, pixels of 1 mm: i runs to the back, j to the feet, k to the right.

    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> matrix = [[0, 0, 4, -40], [-1, 0, 0, 60], [0, -1, 0, 80], [0, 0, 0, 1]]
    >>> image = vic.Image.from_array(np.zeros((20, 160, 120), dtype=np.int16), matrix)
    >>> image
    Image(120 x 160 x 20 voxels of 1 x 1 x 4 mm, int16)
    >>> image.to_ras([[0, 0, 19]])
    array([[36., 60., 80.]])
    """

    array: np.ndarray
    ijk_to_ras: np.ndarray

    @classmethod
    def from_array(cls, array, ijk_to_ras) -> Image:
        """Make an image from an array and the matrix that places its voxels.

        Parameters
        ----------
        array : array_like, shape (nk, nj, ni)
        ijk_to_ras : array_like, shape (4, 4)
            As for the class.

        Returns
        -------
        Image

        Raises
        ------
        ValueError
            As for the class.
        """
        return cls(np.asarray(array), ijk_to_ras)

    def __repr__(self):
        sizes = " x ".join(str(number) for number in self.array.shape[::-1])
        steps = " x ".join(f"{step:.3g}" for step in self.spacing)
        return f"Image({sizes} voxels of {steps} mm, {self.array.dtype})"

    def __post_init__(self):
        array = np.asarray(self.array)
        _check_grid(array)
        _check_finite(array)
        if not array.dtype.isnative:
            array = array.astype(array.dtype.newbyteorder("="))
        object.__setattr__(self, "array", array)
        object.__setattr__(self, "ijk_to_ras", _checked_matrix(self.ijk_to_ras))

    @property
    def spacing(self) -> np.ndarray:
        """Distance in mm between neighbouring voxel centres along i, j and k, shape (3,)."""
        return np.linalg.norm(self.ijk_to_ras[:3, :3], axis=0)

    @property
    def size(self) -> np.ndarray:
        """Number of voxels along i, j and k, shape (3,)."""
        return np.array(self.array.shape[::-1])

    @property
    def ras_to_ijk(self) -> np.ndarray:
        """Inverse of `ijk_to_ras`, shape (4, 4)."""
        return np.linalg.inv(self.ijk_to_ras)

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel in mm^3."""
        return float(abs(np.linalg.det(self.ijk_to_ras[:3, :3])))

    def to_ijk(self, points) -> np.ndarray:
        """Take RAS points (mm), shape (n, 3), to continuous voxel indices (i, j, k), shape (n, 3)."""
        return _transformed(self.ras_to_ijk, points)

    def to_ras(self, ijk) -> np.ndarray:
        """Take continuous voxel indices (i, j, k), shape (n, 3), to RAS points (mm), shape (n, 3)."""
        return _transformed(self.ijk_to_ras, ijk)

    def crop(self, start_kji, stop_kji) -> Image:
        """Crop to a box of voxels; these keep their RAS positions.

        Parameters
        ----------
        start_kji, stop_kji : sequence of 3 int
            First voxel and one past the last voxel along k, j and i.

        Returns
        -------
        Image
            Its array is a view of this image's array: nothing is copied.

        Raises
        ------
        ValueError
            If the box leaves the volume or is thinner than two voxels.
        """
        start = np.asarray(start_kji, dtype=int)
        stop = np.asarray(stop_kji, dtype=int)
        if np.any(start < 0) or np.any(stop > self.array.shape):
            msg = (
                f"The box from {start.tolist()} to {stop.tolist()} (k, j, i) leaves the volume of "
                f"{list(self.array.shape)} voxels; choose a box inside it."
            )
            raise ValueError(msg)
        matrix = beginning_at(self.ijk_to_ras, start[::-1])
        box = tuple(slice(low, high) for low, high in zip(start.tolist(), stop.tolist()))
        return _view(self.array[box], matrix)

    def crop_around(self, points: np.ndarray, margin: float) -> Image:
        """Crop to the smallest box of voxels around points, as far as it lies in the volume.

        Parameters
        ----------
        points : (n, 3) array_like
            RAS mm.
        margin : float
            Distance from the points to the faces of the box, mm.

        Returns
        -------
        Image
            At least two voxels thick; nothing is copied.
        """
        reach = margin / self.spacing
        ijk = self.to_ijk(points)
        start = np.clip(np.floor(ijk.min(axis=0) - reach), 0, self.size - 2).astype(int)
        stop = np.clip(np.ceil(ijk.max(axis=0) + reach) + 1, start + 2, self.size).astype(int)
        return self.crop(start[::-1], stop[::-1])

    def canonical(self) -> Image:
        """Permute and flip the axes so that i, j and k run closest to right, anterior and superior.

        Returns
        -------
        Image
            The same voxels at the same RAS positions (a view, not resampled). Copies of one volume that differ
            only by permuted and flipped axes give identical arrays.

        Notes
        -----
        Of all assignments of the axes, the one with the largest sum of cosines is taken, as ``DICOMOrient`` and
        nibabel's ``as_closest_canonical`` do. If two are equal (an axis at exactly 45 degrees), the one turned
        towards the next RAS axis is taken, so that the result does not depend on the order of the axes.
        """
        directions = self.ijk_to_ras[:3, :3] / self.spacing
        tie_break = 1e-6 * np.sign(directions) * np.roll(directions, -1, axis=0)
        scores = np.abs(directions) + tie_break
        order = max(
            itertools.permutations(range(3)),
            key=lambda axes: sum(scores[world, axis] for world, axis in enumerate(axes)),
        )
        flips = np.array([directions[world, axis] < 0 for world, axis in enumerate(order)])

        matrix = self.ijk_to_ras.copy()
        matrix[:3, :3] = self.ijk_to_ras[:3, order]
        last_voxel = self.size[list(order)] - 1
        matrix[:3, 3] += matrix[:3, :3] @ np.where(flips, last_voxel, 0)
        matrix[:3, :3] *= np.where(flips, -1.0, 1.0)
        kji_order = [2 - axis for axis in order[::-1]]
        steps = tuple(slice(None, None, -1 if flip else 1) for flip in flips[::-1])
        return _view(self.array.transpose(kji_order)[steps], matrix)


def _view(array, ijk_to_ras):
    """Make an image of voxels of a checked image, without a search for NaN, which would read all of them again."""
    _check_grid(array)
    image = object.__new__(Image)
    object.__setattr__(image, "array", array)
    object.__setattr__(image, "ijk_to_ras", _checked_matrix(ijk_to_ras))
    return image


def beginning_at(ijk_to_ras: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Matrix (4, 4) of a grid whose first voxel is the voxel (i, j, k) of another grid, inside or outside of it."""
    matrix = ijk_to_ras.copy()
    matrix[:3, 3] += matrix[:3, :3] @ first
    return matrix


def as_image(image) -> Image:
    """Return an image, or read it from a path.

    Parameters
    ----------
    image : Image or path-like

    Returns
    -------
    Image

    Raises
    ------
    TypeError
        If the argument is neither.
    ValueError
        As :func:`.reading.read_image`.
    """
    if isinstance(image, (str, os.PathLike)):
        from .reading import read_image

        return read_image(image)
    if not isinstance(image, Image):
        msg = (
            f"An image is needed, and {type(image).__name__} was given; make one with Image.from_array(array, "
            "ijk_to_ras), or give the path of a file."
        )
        raise TypeError(msg)
    return image


def patient_side(direction: np.ndarray) -> str:
    """Name the side of the patient to which a direction points.

    Parameters
    ----------
    direction : (3,) array_like
        Along R, A and S; of any length.

    Returns
    -------
    str
        "left", "right", "posterior", "anterior", "inferior" or "superior": the nearest of these.
    """
    axis = int(np.argmax(np.abs(direction)))
    return _SIDES[axis][int(direction[axis] > 0.0)]


def _transformed(matrix, points):
    points = np.asarray(points, dtype=float)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _check_grid(array):
    if array.ndim != 3:
        msg = (
            f"The image has {array.ndim} dimensions (shape {array.shape}); a volume needs three (k, j, i). "
            "Choose one frame or channel of it."
        )
        raise ValueError(msg)
    if not (np.issubdtype(array.dtype, np.bool_) or array.dtype.kind in "iuf"):
        msg = f"The voxels are of type {array.dtype}; grey levels must be real numbers. Convert them first."
        raise ValueError(msg)
    if min(array.shape) < 2:
        ni, nj, nk = array.shape[::-1]
        msg = (
            f"The image has {ni} x {nj} x {nk} voxels; a surface needs several slices, so every axis must "
            "have two voxels or more. Choose the whole volume instead of a single slice."
        )
        raise ValueError(msg)


def _check_finite(array):
    if array.dtype.kind != "f":
        return
    # Minimum and maximum are not finite if any voxel is not; a mask of the volume's size is not needed.
    largest = float(np.abs([array.min(), array.max()]).max())
    if largest > _LARGEST_LEVEL and np.isfinite(largest):
        msg = (
            f"The grey levels reach {largest:.3g}, too much to be worked with; no scanner gives them. Check the file's "
            "voxel type and byte order, or scale them down."
        )
        raise ValueError(msg)
    if largest <= _LARGEST_LEVEL:
        return
    check_finite_count(array.size - int(np.count_nonzero(np.isfinite(array))), array.size)


def check_finite_count(bad: int, size: int) -> None:
    """Refuse an image of `size` voxels of which `bad` are not finite.

    Raises
    ------
    ValueError
        If there are any.
    """
    if not bad:
        return
    msg = (
        f"{bad} of the image's {size} voxels are not finite (NaN or infinity); every voxel needs a "
        "grey level. Replace them, for example by 0, and try again."
    )
    raise ValueError(msg)


def _checked_matrix(ijk_to_ras):
    try:
        matrix = np.array(ijk_to_ras, dtype=float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4):
        msg = f"The matrix ijk_to_ras has shape {np.shape(ijk_to_ras)}; it must be 4 x 4 numbers (mm)."
        raise ValueError(msg)
    if not np.isfinite(matrix).all():
        msg = (
            "The matrix from voxels to mm (ijk_to_ras) holds values that are not finite; check the image's spacing, "
            "directions and origin."
        )
        raise ValueError(msg)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        msg = f"The last row of ijk_to_ras is {matrix[3].tolist()}; it must be 0, 0, 0, 1 (affine)."
        raise ValueError(msg)
    steps = np.linalg.norm(matrix[:3, :3], axis=0)
    # The determinant is compared with the product of the voxel's edges, so that small voxels are allowed.
    if steps.min() <= 0 or abs(np.linalg.det(matrix[:3, :3] / steps)) < 1e-6:
        msg = (
            "The matrix from voxels to mm (ijk_to_ras) cannot be inverted (a spacing of zero, or two axes along one "
            "direction); check the image's spacing and directions."
        )
        raise ValueError(msg)
    matrix.setflags(write=False)
    return matrix
