"""Grey levels and their gradients at any points of the world."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .image import Image

# Points are treated in blocks whose temporaries stay in the processor's cache.
_BLOCK = 16384


class Sampler:
    """Interpolates an image at RAS points.

    Parameters
    ----------
    image : Image
        The volume. Crop it first if only a part is needed: cubic order computes coefficients for all voxels.
    order : {"linear", "cubic"}
        Trilinear interpolation (continuous), or the interpolating tricubic B-spline (continuous second
        derivatives), with the grid mirrored at its outer voxel centres [1]_.

    Raises
    ------
    ValueError
        If `order` is neither of the two.

    Notes
    -----
    A point is valid up to the outer faces of the outer voxels. Between outer voxel centres and those faces
    the interpolant is constant along that axis. Points outside get the value 0 and the gradient 0, and they
    are marked as not valid. Gradients are exact derivatives of the interpolant.

    References
    ----------
    .. [1] P. Thevenaz, T. Blu, M. Unser, "Interpolation revisited", IEEE Trans. Med. Imaging 19(7), 2000.
    """

    def __init__(self, image: Image, *, order: str = "linear"):
        if order not in ("linear", "cubic"):
            msg = f"The interpolation order is {order!r}; it must be 'linear' or 'cubic'."
            raise ValueError(msg)
        self.image = image
        self.order = order
        if order == "cubic":
            data = ndimage.spline_filter(np.asarray(image.array, dtype=float), order=3, mode="mirror")
        else:
            # The voxels' own type, turned into numbers after the look-up: exact, and no copy of the volume.
            data = np.ascontiguousarray(image.array)
        self._data = data.ravel()
        self._ras_to_ijk = image.ras_to_ijk
        self._size = image.size
        self._strides = (1, int(self._size[0]), int(self._size[0] * self._size[1]))

    def values(self, points) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate the grey level.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            RAS mm.

        Returns
        -------
        values : ndarray, shape (...)
        valid : ndarray of bool, shape (...)
        """
        values, _, valid = self._sample(points, with_gradients=False)
        return values, valid

    def values_and_gradients(self, points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Interpolate the grey level and its gradient.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            RAS mm.

        Returns
        -------
        values : ndarray, shape (...)
        gradients : ndarray, shape (..., 3)
            Grey level per mm along R, A and S.
        valid : ndarray of bool, shape (...)
        """
        return self._sample(points, with_gradients=True)

    def _sample(self, points, *, with_gradients):
        points = np.asarray(points, dtype=float)
        if points.ndim == 0 or points.shape[-1] != 3:
            msg = f"The points have shape {points.shape}; the last axis must hold R, A and S."
            raise ValueError(msg)
        flat = points.reshape(-1, 3)
        values = np.empty(len(flat))
        gradients = np.empty((len(flat), 3)) if with_gradients else None
        valid = np.empty(len(flat), dtype=bool)
        interpolate = self._linear if self.order == "linear" else self._cubic
        for start in range(0, len(flat), _BLOCK):
            block = slice(start, start + _BLOCK)
            cell, fraction, slope, valid[block] = self._locate(flat[block])
            values[block], index_gradient = interpolate(cell, fraction, with_gradients)
            values[block] *= valid[block]
            if with_gradients:
                gradients[block] = (index_gradient * slope).T @ self._ras_to_ijk[:3, :3]
        shape = points.shape[:-1]
        gradients = gradients.reshape(points.shape) if with_gradients else None
        return values.reshape(shape), gradients, valid.reshape(shape)

    def _locate(self, points):
        """Split points into cells and fractions, both (3, n); slope is False where the index is clamped."""
        matrix = self._ras_to_ijk
        with np.errstate(invalid="ignore", over="ignore"):
            index = matrix[:3, :3] @ points.T + matrix[:3, 3:]
        last = (self._size - 1.0)[:, None]
        valid = ((index >= -0.5) & (index <= last + 0.5)).all(axis=0)
        index[:, ~valid] = 0.0
        clamped = np.minimum(np.maximum(index, 0.0), last)
        slope = (clamped == index) & valid
        cell = np.minimum(clamped.astype(np.intp), self._size[:, None] - 2)
        return cell, clamped - cell, slope, valid

    def _linear(self, cell, fraction, with_gradients):
        fi, fj, fk = fraction
        _, row, plane = self._strides
        base = cell[0] + cell[1] * row + cell[2] * plane
        corners = [
            self._data.take(base + offset).astype(float)
            for offset in (0, 1, row, row + 1, plane, plane + 1, plane + row, plane + row + 1)
        ]
        di = [corners[n + 1] - corners[n] for n in (0, 2, 4, 6)]
        edges = [corners[2 * n] + fi * di[n] for n in range(4)]
        dj = [edges[1] - edges[0], edges[3] - edges[2]]
        faces = [edges[0] + fj * dj[0], edges[2] + fj * dj[1]]
        dk = faces[1] - faces[0]
        values = faces[0] + fk * dk
        if not with_gradients:
            return values, None
        near = di[0] + fj * (di[1] - di[0])
        far = di[2] + fj * (di[3] - di[2])
        return values, np.stack([near + fk * (far - near), dj[0] + fk * (dj[1] - dj[0]), dk])

    def _cubic(self, cell, fraction, with_gradients):
        weights = _cubic_weights(fraction)
        slopes = _cubic_slopes(fraction) if with_gradients else None
        columns = [self._mirrored(cell, axis) for axis in range(3)]
        values = np.zeros(cell.shape[1])
        gradients = np.zeros(cell.shape) if with_gradients else None
        for k in range(4):
            for j in range(4):
                base = columns[2][k] + columns[1][j]
                coefficients = [self._data.take(base + columns[0][i]) for i in range(4)]
                line = sum(weights[i][0] * coefficients[i] for i in range(4))
                values += weights[k][2] * weights[j][1] * line
                if with_gradients:
                    line_slope = sum(slopes[i][0] * coefficients[i] for i in range(4))
                    gradients[0] += weights[k][2] * weights[j][1] * line_slope
                    gradients[1] += weights[k][2] * slopes[j][1] * line
                    gradients[2] += slopes[k][2] * weights[j][1] * line
        return values, gradients

    def _mirrored(self, cell, axis):
        """Flat offsets of the four coefficients around each cell along one axis."""
        last = self._size[axis] - 1
        offsets = []
        for step in (-1, 0, 1, 2):
            index = np.abs(cell[axis] + step)
            offsets.append(np.where(index > last, 2 * last - index, index) * self._strides[axis])
        return offsets


def _cubic_weights(t):
    """Return the four uniform cubic B-splines on a cell, each shaped like t in [0, 1]."""
    s = 1.0 - t
    return s * s * s / 6, (4 - 3 * t * t * (2 - t)) / 6, (4 - 3 * s * s * (2 - s)) / 6, t * t * t / 6


def _cubic_slopes(t):
    """Return the derivatives of `_cubic_weights` with respect to t."""
    s = 1.0 - t
    return -s * s / 2, t * (1.5 * t - 2), -s * (1.5 * s - 2), t * t / 2


def smooth(image: Image, sigma_mm: float) -> Image:
    """Blur an image with a Gaussian that is as wide in millimetres along every axis.

    Parameters
    ----------
    image : Image
    sigma_mm : float
        Standard deviation in mm; 0 only converts to float32. Along thick slices it spans fewer voxels. On a
        sheared grid the blur follows the grid's axes.

    Returns
    -------
    Image
        On the same grid, float32. The volume is continued by its border voxels.

    Raises
    ------
    ValueError
        If `sigma_mm` is negative or not finite.
    """
    if not (np.isfinite(sigma_mm) and sigma_mm >= 0):
        msg = f"The smoothing width is {sigma_mm} mm; it must be zero or a positive length."
        raise ValueError(msg)
    blurred = ndimage.gaussian_filter(image.array.astype(np.float32), sigma_mm / image.spacing[::-1], mode="nearest")
    return Image(blurred, image.ijk_to_ras)
