"""Edges of an organ along rays from its seeds, and from further places in parts that are far from these."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..imaging.boxes import ball_box
from ..imaging.moments import ball_radius
from .checks import refuse_seed
from .limits import Limits
from .ray_edges import find_edges, joined
from .seeds import voxels_of

# A seed that is less deep than the second length inside of the limits is moved by at most the first one.
CLICK_MM, _DEEP_MM = 4.0, 2.0
# Rays also start from places that are at least this share of the organ's radius away from all seeds,
_OFF_SEEDS = 0.5
# whose nearest wall is at least this share as far as that of the seeds,
_NARROW = 0.6
# and whose grey level differs from that of the organ by at most this share of the contrast.
_ALIKE = 0.25
# Such places are searched so many times, each time from the edges found before.
_ROUNDS = 3


def edges_around(image, seeds, given):
    """Find an organ's edges along rays from its seeds, and from places in parts of it that are far from the seeds.

    Parameters
    ----------
    image : Image
    seeds : ndarray, shape (n, 3)
        Points in the organ, RAS mm.
    given : Limits or None
        Limits of grey levels that the user has given; by default they are measured at the edges.

    Returns
    -------
    seeds : ndarray, shape (n, 3)
        Those in or near a wall are moved to a deeper voxel within the limits, RAS mm.
    edges : Edges
        Its seeds include the further places.

    Raises
    ------
    ValueError
        If a seed is not a point of the volume, if there are too few edges for limits, or if no voxel within the limits
        is near a seed.
    """
    edges = find_edges(image, seeds)
    limits = given or Limits.along(edges, image)
    moved = np.array([_moved_deeper(image, seed, limits, suggested=given is None) for seed in seeds])
    if np.any(moved != seeds):
        edges = find_edges(image, moved)
    for _ in range(_ROUNDS):
        radius = ball_radius(edges.volume)
        places = edges.half_centroids
        away = np.linalg.norm(places[:, None] - edges.seeds, axis=2).min(axis=1)
        others = places[(away > _OFF_SEEDS * radius) & within_limits(image, limits, places)]
        if not len(others):
            break
        further = find_edges(image, others)
        # A narrow place may be a bridge to another organ, and another level may be that of other tissue.
        alike = np.abs(further.levels - edges.median_level) < _ALIKE * edges.contrast
        chosen = alike & (further.wall_distances > _NARROW * edges.wall_distances.max())
        if not chosen.any():
            break
        edges = joined(edges, further, chosen)
    return moved, edges


def within_limits(image, limits, points):
    """Whether the voxels at points (n, 3), RAS mm, are within limits of grey levels; False outside of the volume."""
    voxels = np.rint(image.to_ijk(points)[:, ::-1]).astype(int)
    inside = np.all((voxels >= 0) & (voxels < image.array.shape), axis=1)
    return np.array(
        [
            bool(within) and bool(limits.holds(voxel, image.array[tuple(voxel)].reshape(1, 1, 1)))
            for within, voxel in zip(inside, voxels.tolist())
        ]
    )


def _moved_deeper(image, seed, limits, *, suggested):
    """Move a seed in or near a wall to the deepest voxel within the limits, by at most `CLICK_MM`."""
    voxel = voxels_of(image, seed[None])[0]
    box, _ = ball_box(image.array, voxel, image.ijk_to_ras[:3, :3], CLICK_MM + _DEEP_MM)
    start = np.array([part.start for part in box])
    held = limits.holds(start, image.array[box])
    # The border of the volume counts as no wall, as the organ may continue beyond it.
    depths = ndimage.distance_transform_edt(held, sampling=image.spacing[::-1])
    near, distances = ball_box(held, voxel - start, image.ijk_to_ras[:3, :3], CLICK_MM)
    if depths[tuple(voxel - start)] >= _DEEP_MM or held.all():
        return seed
    if not (held[near] & (distances < np.inf)).any():
        refuse_seed(image, seed, voxel, limits, suggested=suggested)
    # Of equally deep voxels the nearest one is taken.
    merit = np.where(distances < np.inf, np.minimum(depths[near], _DEEP_MM) - 1e-3 * distances, -np.inf)
    k, j, i = np.unravel_index(merit.argmax(), merit.shape)
    moved = np.array([[i, j, k]]) + start[::-1] + [part.start for part in near[::-1]]
    return image.to_ras(moved)[0]
