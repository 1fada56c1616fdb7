"""Completion of a region that one stack cuts off, from further stacks whose motions are known roughly."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, Delaunay

from ..imaging.image import Image, beginning_at
from ..imaging.morphology import boundary_voxels
from ..imaging.region import Region
from ..imaging.resampling import resampled
from ..segmentation.separation import separate

# Smallest Dice coefficient of the regions in two stacks, where these overlap, for the same organ. The demo's vagina,
# 13 mm thick, has 0.79 to 0.9 in slices of 4 mm.
_SAME_ORGAN = 0.7
# A region that would grow by less than this share is left as it is.
_LEAST_GAIN = 0.01


@dataclass(frozen=True, eq=False)
class _Part:
    """The organ's region in a further stack, and that stack, both moved to the first stack."""

    mask: Image
    stack: Image


def completed_region(image: Image, region: Region, stacks: Sequence[tuple[Image, np.ndarray]]) -> Region:
    """Add to a region the part of the organ that further stacks show beyond the border of the first one.

    Parameters
    ----------
    image : Image
        The first stack.
    region : Region
        Of the organ in it.
    stacks : sequence of (Image, (4, 4) ndarray)
        Further stacks, each with the motion that takes points of the first one to it, RAS mm.

    Returns
    -------
    Region
        On the image's grid extended beyond its border: `offset` may be negative. Inside of the image it is the given
        region. The given region itself if no stack adds to it.
    """
    parts = [part for stack, motion in stacks if (part := _part(region, stack, motion)) is not None]
    if not parts:
        return region
    start, size = _grid(region, [part.mask for part in parts])
    matrix = beginning_at(region.ijk_to_ras, start[::-1])
    own = np.zeros(size, dtype=bool)
    own[tuple(slice(-low, -low + count) for low, count in zip(start, region.mask.shape))] = region.mask
    first = np.asarray(region.offset) + start
    inside = np.zeros(size, dtype=bool)
    inside[tuple(slice(max(-low, 0), max(top - low, 0)) for low, top in zip(first, image.array.shape))] = True
    added, unseen = np.zeros(size, dtype=bool), ~inside
    for part in parts:
        found = resampled(part.mask, matrix, size[::-1]).array >= 0.5
        seen = _lies_in(part.stack, matrix, size)
        common = inside & seen
        both = np.count_nonzero(own & common) + np.count_nonzero(found & common)
        if both and 2.0 * np.count_nonzero(own & found & common) >= _SAME_ORGAN * both:
            added |= found & ~inside
            unseen &= ~seen
    whole, count = ndimage.label(own | added)
    if count:
        whole = whole == whole[own][0]
    if np.count_nonzero(whole) < (1.0 + _LEAST_GAIN) * np.count_nonzero(own):
        return region
    whole = whole | _bridged(whole, unseen)
    faces = _still_cut(region, whole & ~inside, first, image)
    return replace(region, mask=whole, offset=tuple(first.tolist()), ijk_to_ras=matrix, touches_border=faces)


def _part(region: Region, stack: Image, motion: np.ndarray) -> _Part | None:
    """Separate the organ in a further stack; None if that fails.

    The seed is the place farthest from the boundary of the first region among those that lie in the stack.
    """
    depth = ndimage.distance_transform_edt(np.pad(region.mask, 1), sampling=region.spacing[::-1])[1:-1, 1:-1, 1:-1]
    places = np.argwhere(region.mask)
    points = region.image.to_ras(places[:, ::-1]) @ motion[:3, :3].T + motion[:3, 3]
    ijk = stack.to_ijk(points)
    in_stack = np.all((ijk >= 0.0) & (ijk <= stack.size - 1.0), axis=1)
    if not in_stack.any():
        return None
    deepest = np.where(in_stack, depth[tuple(places.T)], -1.0).argmax()
    try:
        found = separate(stack, points[deepest][None])
    except ValueError:
        return None
    back = np.linalg.inv(motion)
    moved = Image(np.pad(found.mask, 1), back @ beginning_at(found.ijk_to_ras, -np.ones(3)))
    return _Part(moved, Image(stack.array, back @ stack.ijk_to_ras))


def _grid(region: Region, masks: Sequence[Image]) -> tuple[np.ndarray, np.ndarray]:
    """Find the box on a region's grid that covers the region and masks: first voxel (k, j, i), relative, and size."""
    lows, highs = [np.zeros(3, dtype=int)], [np.array(region.mask.shape)]
    for mask in masks:
        corners = np.array(list(itertools.product(*((0.0, count - 1.0) for count in mask.size))))
        ijk = region.image.to_ijk(mask.to_ras(corners))[:, ::-1]
        lows.append(np.floor(ijk.min(axis=0)).astype(int))
        highs.append(np.ceil(ijk.max(axis=0)).astype(int) + 1)
    start = np.min(lows, axis=0)
    return start, np.max(highs, axis=0) - start


def _bridged(whole: np.ndarray, unseen: np.ndarray) -> np.ndarray:
    """Voxels that lie in no stack, but in the convex hull of an organ, (k, j, i) of bool.

    They fill the steps that the region has where stacks end at different places. Without them the errors of the demo's
    organs in two stacks that cut them are 0.24 to 0.44 in place of 0.10 to 0.27 mm.
    """
    rim = boundary_voxels(whole)
    places = np.argwhere(unseen & ~whole)
    bridged = np.zeros_like(whole)
    if len(places):
        hull = Delaunay(rim[ConvexHull(rim).vertices])
        bridged[tuple(places[hull.find_simplex(places) >= 0].T)] = True
    return bridged


def _lies_in(image: Image, matrix: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Find out which voxels of a grid lie in an image, (k, j, i) of bool."""
    between = image.ras_to_ijk @ matrix
    k, j, i = np.ogrid[tuple(slice(count) for count in size)]
    inside = np.ones(size, dtype=bool)
    for row, count in zip(between[:3], image.size):
        along = row[0] * i + row[1] * j + row[2] * k + row[3]
        inside &= (along >= -0.5) & (along <= count - 0.5)
    return inside


def _still_cut(region: Region, added: np.ndarray, first: np.ndarray, image: Image) -> tuple[str, ...]:
    """Faces of the image that a region touches and beyond which nothing was added."""
    faces = []
    for face in region.touches_border:
        axis = 2 - "ijk".index(face[0])
        end = -first[axis] if face[1] == "-" else image.array.shape[axis] - first[axis]
        beyond = [slice(None)] * 3
        beyond[axis] = slice(0, max(end, 0)) if face[1] == "-" else slice(end, None)
        if not added[tuple(beyond)].any():
            faces.append(face)
    return tuple(faces)
