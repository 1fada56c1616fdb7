"""The voxels of a region on the whole grid of its image."""

from __future__ import annotations

import numpy as np


def mask_in_place(region, shape):
    """Voxels of a region on its image's whole grid, (nk, nj, ni)."""
    mask = np.zeros(shape, dtype=bool)
    mask[tuple(slice(low, low + size) for low, size in zip(region.offset, region.mask.shape))] = region.mask
    return mask
