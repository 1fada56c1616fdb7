"""Grey levels that tell where they are: what is read from a file shows whether every voxel is at its place."""

from __future__ import annotations

import numpy as np

# Grey levels per mm along R, A and S: half a level, the rounding, is 0.01 to 0.03 mm.
_SLOPES = np.array([20.0, 30.0, 50.0])


def levels_at(ras) -> np.ndarray:
    """Grey levels of points, mm; whole numbers that fit into 16 bits."""
    return np.rint(np.asarray(ras) @ _SLOPES).astype(np.int16)


def levels_of(ijk_to_ras, size) -> np.ndarray:
    """Voxels (k, j, i) of a grid of `size` voxels along i, j and k."""
    return levels_at(_places(ijk_to_ras, size))


def farthest(image) -> float:
    """How far the voxels of an image are from where their grey levels say, at most, mm; rounding is taken off."""
    exact = _places(image.ijk_to_ras, image.size) @ _SLOPES
    off = np.abs(image.array - exact).max() - 0.5
    return max(0.0, float(off)) / _SLOPES.min()


def _places(ijk_to_ras, size) -> np.ndarray:
    """Voxel centres, RAS mm, shape (k, j, i, 3)."""
    i, j, k = np.meshgrid(*map(np.arange, size), indexing="ij")
    ijk = np.stack([i, j, k], axis=-1).astype(float)
    return (ijk @ np.asarray(ijk_to_ras)[:3, :3].T + np.asarray(ijk_to_ras)[:3, 3]).transpose(2, 1, 0, 3)
