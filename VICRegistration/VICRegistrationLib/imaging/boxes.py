"""Bounding boxes of masks and balls."""

from __future__ import annotations

import numpy as np

from .morphology import ball_reach


def bounds(mask):
    """First voxel, and one past the last voxel, of a mask that is not empty, along k, j and i; two (3,) ndarray."""
    plane = mask.any(axis=2)
    used = [np.flatnonzero(line) for line in (plane.any(axis=1), plane.any(axis=0), mask.any(axis=(0, 1)))]
    return np.array([line[0] for line in used]), np.array([line[-1] + 1 for line in used])


def ball_box(grid, voxel, steps, radius):
    """Bounding box of a ball around a voxel (k, j, i) of a grid.

    Parameters
    ----------
    grid : ndarray
    voxel : (3,) array_like
    steps : (3, 3) ndarray
        Upper left block of ``ijk_to_ras``.
    radius : float
        mm.

    Returns
    -------
    box : tuple of 3 slice
    distances : ndarray
        Of the box's voxels from the voxel, mm; infinite outside of the ball.
    """
    reach = ball_reach(steps, radius)
    low = np.maximum(voxel - reach, 0)
    high = np.minimum(voxel + reach + 1, grid.shape)
    offsets = np.stack(np.meshgrid(*map(np.arange, low - voxel, high - voxel), indexing="ij"), axis=-1)
    distances = np.linalg.norm(offsets[..., ::-1] @ steps.T, axis=-1)
    distances[distances > radius * (1 + 1e-6)] = np.inf
    return tuple(map(slice, low, high)), distances
