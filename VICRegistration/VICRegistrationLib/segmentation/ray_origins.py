"""Looking for an organ's edges from places in it: its seeds, and others that see what those do not."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..imaging.boxes import ball_box, ball_radius
from .checks import refuse_seed
from .limits import Limits
from .ray_edges import find_edges, joined
from .seeds import voxels_of

# A seed is taken to be meant for a place within the limits that is this near, and this deep if there is one.
CLICK_MM = 4.0
_DEEP_MM = 2.0
# From places as far from all seeds as this share of the organ's radius, other parts of the organ are seen.
_OFF_SEEDS = 0.5
# Such a place is as wide as this share of the widest one around a seed.
_NARROW = 0.6
# And its level is that of the organ within this share of the contrast.
_ALIKE = 0.25
# From there one may see farther, and so on.
_ROUNDS = 3


def edges_around(image, seeds, given):
    """Look for the organ's edges from the seeds, and from the middle of parts of the organ that are far from them.

    Returns the seeds, moved to the nearest voxel within the limits, and the edges.
    """
    edges = find_edges(image, seeds)
    limits = given or Limits.along(edges, image)
    settled = np.array([_settled(image, seed, limits, suggested=given is None) for seed in seeds])
    if np.any(settled != seeds):
        edges = find_edges(image, settled)
    for _ in range(_ROUNDS):
        radius = ball_radius(edges.volume)
        away = np.linalg.norm(edges.halves[:, None] - edges.seeds, axis=2).min(axis=1)
        others = edges.halves[(away > _OFF_SEEDS * radius) & within_limits(image, limits, edges.halves)]
        if not len(others):
            break
        seen = find_edges(image, others)
        # Not from a bridge, which is narrower than the organ, and not from other tissue.
        alike = np.abs(seen.levels - edges.middle) < _ALIKE * edges.contrast
        wide = alike & (seen.depths > _NARROW * edges.depths.max())
        if not wide.any():
            break
        edges = joined(edges, seen, wide)
    return settled, edges


def within_limits(image, limits, points):
    """Whether the voxels around points lie within the limits; False outside of the volume."""
    voxels = np.rint(image.to_ijk(points)[:, ::-1]).astype(int)
    inside = np.all((voxels >= 0) & (voxels < image.array.shape), axis=1)
    return np.array(
        [
            bool(found) and bool(limits.holds(voxel, image.array[tuple(voxel)].reshape(1, 1, 1)))
            for found, voxel in zip(inside, voxels.tolist())
        ]
    )


def _settled(image, seed, limits, *, suggested):
    """Move a seed in or near a wall to the deepest place within the limits, not farther than a click may be off."""
    voxel = voxels_of(image, seed[None])[0]
    box, _ = ball_box(image.array, voxel, image.ijk_to_ras[:3, :3], CLICK_MM + _DEEP_MM)
    start = np.array([part.start for part in box])
    held = limits.holds(start, image.array[box])
    # Beyond the volume the organ may go on.
    depths = ndimage.distance_transform_edt(held, sampling=image.spacing[::-1])
    near, distances = ball_box(held, voxel - start, image.ijk_to_ras[:3, :3], CLICK_MM)
    if depths[tuple(voxel - start)] >= _DEEP_MM or held.all():
        return seed
    if not (held[near] & (distances < np.inf)).any():
        refuse_seed(image, seed, voxel, limits, suggested=suggested)
    # Of places as deep, the nearest.
    merit = np.where(distances < np.inf, np.minimum(depths[near], _DEEP_MM) - 1e-3 * distances, -np.inf)
    k, j, i = np.unravel_index(merit.argmax(), merit.shape)
    moved = np.array([[i, j, k]]) + start[::-1] + [part.start for part in near[::-1]]
    return image.to_ras(moved)[0]
