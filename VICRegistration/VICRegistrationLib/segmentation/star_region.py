"""The voxels of an organ whose star-shaped surface is known: grey levels decide only near that surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from ..imaging.boxes import bounds
from ..imaging.image import Image
from ..imaging.morphology import dilate, erode, largest_piece
from ..imaging.region import Region, region_from_crop
from .checks import fills_volume
from .limits import Limits
from .ray_edges import Edges
from .ray_origins import CLICK_MM
from .sphere import between
from .star_surface import Star, find_star

# Voxels as near to the surface as this, mm, belong to the organ by their grey level; deeper ones do, and those farther
# out do not. From 0.5 to 2 mm the mean Dice coefficient of 107 bladders, most of them changed, varies by 0.0016; with
# 3 mm it is 0.004 less.
_SHELL_MM = 0.75
# Thin lobes in the shell are cut by an opening with a ball of this radius.
OPENING_MM = 2.0
# The radius is computed on a lattice and interpolated.
_LATTICE_MM = 3.0


def shaped_region(
    image: Image, seeds: np.ndarray, wall: np.ndarray | None = None, *, fill: bool = True
) -> tuple[Region, Star] | None:
    """Separate an organ by its shape: a star-shaped surface, and the voxels within it.

    Parameters
    ----------
    image : Image
    seeds : (3,) or (n, 3) ndarray
        Places in the organ, RAS mm, in the volume.
    wall : (n, 3) ndarray, optional
        Places that the surface has to pass, RAS mm.
    fill : bool
        Fill cavities.

    Returns
    -------
    tuple of Region and Star, or None
        None where the region does not hold the seeds, or fills the volume.
    """
    star = find_star(image, seeds, wall)
    region = star_region(image, star, fill=fill)
    if region is None or not _holds(region, np.atleast_2d(seeds)) or fills_volume(image, region):
        return None
    return region, star


def star_region(image: Image, star: Star, *, fill: bool = True) -> Region | None:
    """Take the voxels of an organ.

    Parameters
    ----------
    image : Image
    star : Star
        The organ's shape.
    fill : bool
        Fill cavities.

    Returns
    -------
    Region or None
        None where the star shows hardly any edge, or nothing is left.
    """
    try:
        limits = _one_sided(Limits.along(edges_of(image, star), image), star)
    except ValueError:
        # There are too few edges for limits.
        return None
    start, stop = _box(image, star)
    inward = _inward(image.crop(start, stop), star)
    held = limits.holds(start, image.crop(start, stop).array)
    mask = (held & (inward > -1.0)) | (inward > 1.0)
    steps = image.ijk_to_ras[:3, :3]
    core = largest_piece(erode(mask, steps, OPENING_MM))
    mask = largest_piece(dilate(core, steps, OPENING_MM) & mask)
    if not mask.any():
        return None
    first, last = bounds(mask)
    grey = image.array[tuple(map(slice, start + first, start + last))][mask[tuple(map(slice, first, last))]]
    threshold = (limits.low, float(grey.max())) if star.falls else (float(grey.min()), limits.high)
    return region_from_crop(image, mask, start, fill=fill, threshold=threshold, erosion=OPENING_MM)


def edges_of(image: Image, star: Star) -> Edges:
    """Take the star's rays as edges seen from one place."""
    inner = star.inner[~star.cut] if not star.cut.all() else star.inner
    middle = float(np.median(inner))
    return Edges(
        distances=star.lengths[None],
        found=star.found[None],
        points=star.points[None],
        inner=star.inner[None],
        outer=star.outer[None],
        levels=np.array([middle]),
        middle=middle,
        spread=1.4826 * float(np.median(np.abs(inner - middle))),
        directions=star.directions,
        axes=image.ijk_to_ras[:3, :3] / image.spacing,
    )


def _holds(region: Region, seeds: np.ndarray) -> bool:
    """Whether all seeds lie in a region, or as near to it as a click may be off."""
    mask = np.pad(region.mask, 1)
    places = np.rint(region.image.to_ijk(seeds)[:, ::-1]).astype(int) + 1
    if not np.all((places >= 0) & (places < mask.shape)):
        return False
    if mask[tuple(places.T)].all():
        return True
    outside = ndimage.distance_transform_edt(~mask, sampling=region.spacing[::-1])
    return bool((outside[tuple(places.T)] <= CLICK_MM).all())


def _one_sided(limits: Limits, star: Star) -> Limits:
    """Keep only the limit towards what lies outside: an organ brighter than its wall has no upper limit."""
    return replace(limits, high=np.inf) if star.falls else replace(limits, low=-np.inf)


def _box(image: Image, star: Star) -> tuple[np.ndarray, np.ndarray]:
    """First and last voxel of a box around the shell and one voxel more."""
    ends = image.to_ijk(star.points)[:, ::-1]
    room = _SHELL_MM / image.spacing[::-1] + 2.0
    start = np.floor(ends.min(axis=0) - room).astype(int)
    stop = np.ceil(ends.max(axis=0) + room).astype(int) + 1
    return np.maximum(start, 0), np.minimum(stop, image.array.shape)


def _inward(crop: Image, star: Star) -> np.ndarray:
    """How far inside of the surface the voxels lie, in widths of the shell."""
    counts = np.maximum(np.ceil(crop.size * crop.spacing / _LATTICE_MM).astype(int), 2)
    k, j, i = np.indices(counts[::-1])
    nodes = np.stack([i, j, k], axis=-1) * (crop.size - 1.0) / (counts - 1.0)
    away = crop.to_ras(nodes.reshape(-1, 3)) - star.center
    distances = np.linalg.norm(away, axis=1)
    radii = between(star.directions, star.lengths, away / np.maximum(distances, 1e-9)[:, None])
    inward = ((radii - distances) / _SHELL_MM).reshape(counts[::-1])
    return ndimage.zoom(inward.astype(np.float32), crop.size[::-1] / counts[::-1], order=1, grid_mode=False)
