"""A region grown from seeds: threshold, erosion, connected components of the seeds, dilation, filling of holes."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy import ndimage

from ..imaging.boxes import ball_box, bounds
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

# The region is computed in a box that contains the ends of the rays, without this share of them on each side. Where the
# region meets a side of the box, the box grows there by this share of its length; at most so many times if the size of
# the region is limited.
_OUTLIERS = 0.02
_GROWTH = 0.3
_MOST_GROWTHS = 3
# Radii of the erosion that are tried by default: the larger ones if the region leaks, the small ones if it vanishes.
_EROSIONS_MM = (2.0, 4.0, 6.0)
_THIN_EROSIONS_MM = (1.0, 0.0)
# If every radius leaks by `LEAK_FACTOR`, the rays may not have reached all of the organ: the radii are tried again with
# this factor.
_CERTAIN_LEAK = 2.0
# A region this many times as large as the volume that the rays span is no organ.
_MOST_TIMES_SPANNED = 6.0
# A region of less than this share of the volume that the rays of any seed span is a fragment of the organ.
FRAGMENT = 0.25


def grown_region(image: Image, seeds, *, threshold=None, erosion=None, dilation=None, fill: bool = True) -> Region:
    """Grow a region from seeds within limits of grey levels, see :func:`.separation.separate`.

    Voxels within the threshold are eroded, which cuts thin bridges to other tissue. The connected components of the
    seeds are kept and dilated, within the threshold. Cavities are filled.

    Parameters
    ----------
    image : Image
    seeds : ndarray, shape (n, 3)
        Points in the organ, RAS mm.
    threshold, erosion, dilation, fill
        As in :func:`.separation.separate`.

    Returns
    -------
    Region

    Raises
    ------
    ValueError
        As in :func:`.separation.separate`, but without a value that works.

    Notes
    -----
    All steps run on a box around the seeds that grows where the eroded component meets its sides. So the result is the
    same as on the whole volume, and the computing time depends on the size of the organ.
    """
    given = None if threshold is None else Limits.constant(*checked_threshold(threshold))
    dilation = None if dilation is None else checked_radius("dilation", dilation, image)
    seeds, edges = edges_around(image, seeds, given)
    limits = given or Limits.along(edges, image)
    voxels = voxels_of(image, seeds)
    # A limit below the image's lowest level is raised to it: a negative number would be strange in messages.
    threshold = (limits.low if given else max(limits.low, float(image.array.min()))), limits.high
    if erosion is None:
        start, mask, erosion = _separated_by_default(
            image, edges, seeds, limits, dilation, most=np.inf if given else _MOST_TIMES_SPANNED
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
    """Grow a region with the smallest erosion that gives one piece about as large as what the rays span.

    Returns the first voxel of a box, the mask of the region in it, and the radius of the erosion. Regions of more than
    `most` times what the rays span are refused.
    """
    voxels = voxels_of(image, seeds)
    spanned = edges.volume / image.voxel_volume
    fragment = FRAGMENT * edges.volumes.min() / image.voxel_volume
    attempts = [
        (erosion, fragment, factor * spanned) for factor in (LEAK_FACTOR, _CERTAIN_LEAK) for erosion in _EROSIONS_MM
    ]
    # If none of these is accepted, the organ is thin, or the rays span too little of a bent organ, or too much.
    attempts += [(erosion, 0.0, most * spanned) for erosion in (_EROSIONS_MM[0], *_THIN_EROSIONS_MM)]
    found, last, too_large = {}, None, False
    for erosion, least, limit in attempts:
        if erosion not in found:
            growths = _MOST_GROWTHS if limit < most * spanned else None
            grown = _grown_core(
                image, edges, voxels, limits, erosion, dilation, most_voxels=limit, most_growths=growths
            )
            if grown is None:
                too_large |= growths is None
                continue
            start, inside, core = grown
            mask = None
            if core.any():
                mask = _dilated_back(image, inside, core, erosion if dilation is None else dilation)
            found[erosion] = start, mask, erosion
        if found[erosion][1] is None:
            continue
        last = found[erosion]
        # Too strong an erosion leaves a fragment, which is always small enough; so there is a least size too.
        if least <= np.count_nonzero(last[1]) <= limit and ndimage.label(last[1])[1] == 1:
            break
    if last is None:
        if too_large:
            refuse_leak(image, seeds, edges, limits, most)
        # No region even without erosion: a seed is outside of the limits, for example if the seeds lie in two tissues.
        lost = int(np.argmin(within_limits(image, limits, seeds)))
        refuse_seed(image, seeds[lost], voxels[lost], limits, suggested=True)
    return last


def _dilated_back(image, inside, core, dilation):
    """Dilate the core within the threshold, and remove pieces that are not connected with it, as behind a wall."""
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
    """Find the connected components of the seeds after erosion, in a box with a margin for the dilation.

    Returns the first voxel of the box, the mask of its voxels within the threshold, and that of the components, which
    is empty if the erosion leaves nothing around a seed. Returns None as soon as the components have more than
    `most_voxels`, and if the box is still too small after `most_growths`.
    """
    shape = np.array(image.array.shape)
    steps = image.ijk_to_ras[:3, :3]
    room = ball_reach(steps, max(erosion, dilation or 0.0))
    start, stop = _first_box(image, edges, voxels, erosion)
    # A component far beyond the ends of the rays is a leak. It need not be followed to its end, so growths are limited.
    for _ in itertools.count() if most_growths is None else range(most_growths):
        outer_start = np.maximum(start - room, 0)
        outer_stop = np.minimum(stop + room, shape)
        grey = image.array[tuple(map(slice, outer_start, outer_stop))]
        inside = limits.holds(outer_start, grey)
        core = erode(inside, steps, erosion)
        # The erosion is exact in the inner box only: at the sides of the outer one it lacks the voxels beyond.
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
    """Box (k, j, i) around the seeds and the ends of the rays that have not escaped from the organ."""
    shape = np.array(image.array.shape)
    kept = edges.points[~edges.escaped] if not edges.escaped.all() else edges.points.reshape(-1, 3)
    ends = image.to_ijk(kept)[:, ::-1]
    low, high = np.quantile(ends, [_OUTLIERS, 1 - _OUTLIERS], axis=0)
    reach = np.ceil(2 * erosion / image.spacing[::-1]) + 1
    start = np.floor(np.minimum(low, voxels.min(axis=0) - reach)).astype(int) - 1
    stop = np.ceil(np.maximum(high, voxels.max(axis=0) + reach)).astype(int) + 2
    return np.maximum(start, 0), np.minimum(stop, shape)


def _nearest_components(core, voxels, steps, radius):
    """Keep the connected components that contain the core's voxels nearest to each seed, at most a radius away.

    Keeps nothing if there is a seed without such a voxel: the dilation would not reach the seed.
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
