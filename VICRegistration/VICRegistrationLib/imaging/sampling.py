"""Interpolation of grey levels and their gradients at RAS points."""

from __future__ import annotations

import numpy as np

from .image import Image

# Points are processed in blocks whose temporary arrays fit into the processor's cache.
_BLOCK = 16384


class Sampler:
    """Interpolates an image at RAS points, trilinearly.

    Parameters
    ----------
    image : Image

    Notes
    -----
    A point is valid up to the outer faces of the outer voxels. Between outer voxel centres and those faces
    the interpolant is constant along that axis. Points outside get the value 0 and the gradient 0, and they
    are marked as not valid. Gradients are exact derivatives of the interpolant.
    """

    def __init__(self, image: Image):
        self.image = image
        # In the voxels' own type, converted after the look-up, so that the volume is not copied.
        self._data = np.ascontiguousarray(image.array).ravel()
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
        for start in range(0, len(flat), _BLOCK):
            block = slice(start, start + _BLOCK)
            cell, fraction, slope, valid[block] = self._locate(flat[block])
            values[block], index_gradient = self._interpolated(cell, fraction, with_gradients)
            values[block] *= valid[block]
            if with_gradients:
                gradients[block] = (index_gradient * slope).T @ self._ras_to_ijk[:3, :3]
        shape = points.shape[:-1]
        gradients = gradients.reshape(points.shape) if with_gradients else None
        return values.reshape(shape), gradients, valid.reshape(shape)

    def _locate(self, points):
        """Split points into cells and fractions, both (3, n); slope is False where the index was clamped."""
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

    def _interpolated(self, cell, fraction, with_gradients):
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
