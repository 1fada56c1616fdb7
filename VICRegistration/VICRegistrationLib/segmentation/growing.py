"""A region grown from seeds: threshold, erosion, the component of the seeds, dilation, holes."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy import ndimage

from ..imaging.boxes import ball_box, bounds, pieces
from ..imaging.image import Image
from ..imaging.morphology import ball_reach, dilate, erode
from ..imaging.region import Region, region_from_crop
from .checks import (
    LEAK_FACTOR,
    check_leak,
    check_pieces,
    checked_radius,
    checked_threshold,
    leak_diagnostics,
    refuse_erosion,
    refuse_leak,
    refuse_seed,
)
from .limits import Limits
from .ray_origins import edges_around, within_limits
from .seeds import voxels_of

# The first box holds the ends of the rays but for this share on each side; where it is too small it grows by
# a share of its length.
_OUTLIERS = 0.02
_GROWTH = 0.3
_MOST_GROWTHS = 3
# Radii tried by default: the first, the next ones if the region leaks, the small ones if it vanishes.
_EROSIONS_MM = (2.0, 4.0, 6.0)
_THIN_EROSIONS_MM = (1.0, 0.0)
# A region this many times what the rays span has leaked even if they do not see all of the organ.
_CERTAIN_LEAK = 2.0
# What is many times as large as that is no organ.
_MOST_TIMES_SEEN = 6.0
# A region of less than this share of what the rays from any seed span is a fragment of the organ.
FRAGMENT = 0.25


def grown_region(image: Image, seeds, *, threshold=None, erosion=None, dilation=None, fill: bool = True) -> Region:
    """Grow a region from seeds within limits of grey levels, see :func:`.separation.separate`.

    Voxels within the threshold are eroded, which cuts thin bridges to other tissue; the components that hold
    the seeds are kept and dilated back, within the threshold; cavities are filled.

    Parameters
    ----------
    image, seeds, threshold, erosion, dilation, fill
        As there.

    Returns
    -------
    Region

    Raises
    ------
    ValueError
        As there.

    Notes
    -----
    All steps run on a box around the seeds that grows on the sides where the eroded component meets it, so
    the result is that of the whole volume and the cost that of the organ.
    """
    given = None if threshold is None else Limits.constant(*checked_threshold(threshold))
    dilation = None if dilation is None else checked_radius("dilation", dilation, image)
    seeds, edges = edges_around(image, seeds, given)
    limits = given or Limits.along(edges, image)
    voxels = voxels_of(image, seeds)
    # A limit below the image's lowest level would hold the same voxels, and be a strange number in messages.
    threshold = (limits.low if given else max(limits.low, float(image.array.min()))), limits.high
    if erosion is None:
        start, mask, erosion = _separated_by_default(
            image, edges, seeds, limits, dilation, most=np.inf if given else _MOST_TIMES_SEEN
        )
    else:
        erosion = checked_radius("erosion", erosion, image)
        start, inside, core = _grown_core(image, edges, voxels, limits, erosion, dilation)
        if not core.any():
            refuse_erosion(image, seeds, voxels - start, inside, erosion)
        mask = _dilated_back(image, inside, core, erosion if dilation is None else dilation)
    region = region_from_crop(image, mask, start, fill=fill, threshold=threshold, erosion=erosion)
    check_leak(image, region)
    check_pieces(region)
    volume = np.count_nonzero(mask) * image.voxel_volume
    return replace(region, diagnostics=leak_diagnostics(region, edges, volume))


def _separated_by_default(image, edges, seeds, limits, dilation, *, most):
    """Erode as little as keeps the region within what the rays from the seeds span."""
    voxels = voxels_of(image, seeds)
    seen = edges.volume / image.voxel_volume
    fragment = FRAGMENT * edges.volumes.min() / image.voxel_volume
    attempts = [
        (erosion, fragment, factor * seen) for factor in (LEAK_FACTOR, _CERTAIN_LEAK) for erosion in _EROSIONS_MM
    ]
    # If none will do, the rays saw too little of a bent organ or too much, or the organ is thin.
    attempts += [(erosion, 0.0, most * seen) for erosion in (_EROSIONS_MM[0], *_THIN_EROSIONS_MM)]
    found, last, absurd = {}, None, False
    for erosion, least, limit in attempts:
        if erosion not in found:
            growths = _MOST_GROWTHS if limit < most * seen else None
            grown = _grown_core(
                image, edges, voxels, limits, erosion, dilation, most_voxels=limit, most_growths=growths
            )
            if grown is None:
                absurd |= growths is None
                continue
            start, inside, core = grown
            held = core.any()
            mask = _dilated_back(image, inside, core, erosion if dilation is None else dilation) if held else None
            found[erosion] = start, mask, erosion
        if found[erosion][1] is None:
            continue
        last = found[erosion]
        # What is left of an organ that was eroded too much fits into anything.
        if least <= np.count_nonzero(last[1]) <= limit and pieces(last[1]) == 1:
            break
    if last is None:
        if absurd:
            refuse_leak(image, seeds, edges, limits, most)
        # Not even without erosion: the limits of all that was seen leave a seed out, as between seeds in two tissues.
        lost = int(np.argmin(within_limits(image, limits, seeds)))
        refuse_seed(image, seeds[lost], voxels[lost], limits, suggested=True)
    return last


def _dilated_back(image, inside, core, dilation):
    """Dilate the core within the threshold, but not to the far side of a wall."""
    mask = dilate(core, image.ijk_to_ras[:3, :3], dilation) & inside
    first, last = bounds(mask)
    box = tuple(map(slice, first, last))
    labels, count = ndimage.label(mask[box])
    if count > 1:
        wanted = np.zeros(count + 1, dtype=bool)
        wanted[labels[core[box]]] = True
        mask[box] = wanted[labels] & mask[box]
    return mask


def _grown_core(image, edges, voxels, limits, erosion, dilation, *, most_voxels=np.inf, most_growths=None):
    """Find the eroded components of the seeds in a box with room for the dilation.

    Returns the first voxel of the box, the voxels of the box within the threshold, and the components: none
    if a seed does not survive the erosion. Returns None as soon as there are more than `most_voxels`, or after as many
    growths of the box as are allowed.
    """
    shape = np.array(image.array.shape)
    steps = image.ijk_to_ras[:3, :3]
    room = ball_reach(steps, max(erosion, dilation or 0.0))
    start, stop = _first_box(image, edges, voxels, erosion)
    # What leaves the rays' ends far behind will be too large: not all of the leak has to be seen.
    for _ in itertools.count() if most_growths is None else range(most_growths):
        outer_start = np.maximum(start - room, 0)
        outer_stop = np.minimum(stop + room, shape)
        grey = image.array[tuple(map(slice, outer_start, outer_stop))]
        inside = limits.holds(outer_start, grey)
        core = erode(inside, steps, erosion)
        # Erosion at the edge of the outer box does not see what lies beyond it: only the inner box is exact.
        inner = tuple(map(slice, start - outer_start, stop - outer_start))
        kept = _nearest_components(core[inner], voxels - start, steps, erosion)
        core[:] = False
        core[inner] = kept
        count = np.count_nonzero(kept)
        if count == 0:
            return outer_start, inside, core
        if count > most_voxels:
            return None
        first, last = bounds(kept)
        grow_low = (first == 0) & (start > 0)
        grow_high = (last == stop - start) & (stop < shape)
        if not (grow_low.any() or grow_high.any()):
            return outer_start, inside, core
        growth = np.maximum(((stop - start) * _GROWTH).astype(int), 1)
        start = np.where(grow_low, np.maximum(start - growth, 0), start)
        stop = np.where(grow_high, np.minimum(stop + growth, shape), stop)
    return None


def _first_box(image, edges, voxels, erosion):
    """Box of the ends of the rays, without those that have left the organ, and of the neighbourhood of the seeds."""
    shape = np.array(image.array.shape)
    sound = edges.points[~edges.escaped] if not edges.escaped.all() else edges.points.reshape(-1, 3)
    ends = image.to_ijk(sound)[:, ::-1]
    low, high = np.quantile(ends, [_OUTLIERS, 1 - _OUTLIERS], axis=0)
    reach = np.ceil(2 * erosion / image.spacing[::-1]) + 1
    start = np.floor(np.minimum(low, voxels.min(axis=0) - reach)).astype(int) - 1
    stop = np.ceil(np.maximum(high, voxels.max(axis=0) + reach)).astype(int) + 2
    return np.maximum(start, 0), np.minimum(stop, shape)


def _nearest_components(core, voxels, steps, radius):
    """Keep the components that hold the eroded voxels nearest to each seed, at most a radius away.

    Keeps nothing if there is a seed without one: dilation would not bring it back.
    """
    labels, count = ndimage.label(core)
    wanted = np.zeros(count + 1, dtype=bool)
    for voxel in voxels:
        near, distances = ball_box(core, voxel, steps, radius)
        distances = np.where(core[near], distances, np.inf)
        nearest = distances.min()
        if nearest == np.inf:
            return np.zeros_like(core)
        wanted[labels[near][distances <= nearest + 1e-6 * radius]] = True
    return wanted[labels]
