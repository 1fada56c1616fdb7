"""Lobes of other tissue that hang on a region by a bridge, cut off where the organ's shape is known."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..imaging.boxes import ball_radius
from ..imaging.image import Image
from ..imaging.morphology import dilate, erode
from ..imaging.region import Region, region_from_crop

# A bridge is thinner than twice this radius, or than this share of the organ's radius. Seen on bladders: the same from
# 4 to 8 mm.
_BRIDGE_MM, _BRIDGE_SHARE = 5.0, 0.2


def without_lobes(image: Image, grown: Region, shaped: Region) -> Region:
    """Cut off what hangs on a region by a bridge and lies outside of the organ's shape.

    Parameters
    ----------
    image : Image
    grown : Region
        Holds the organ, and lobes perhaps.
    shaped : Region
        The organ's shape: what lies in it stays, however thin.

    Returns
    -------
    Region
        Its largest piece.
    """
    steps = image.ijk_to_ras[:3, :3]
    radius = min(_BRIDGE_MM, _BRIDGE_SHARE * ball_radius(1000.0 * shaped.volume_ml))
    inside = np.zeros(image.array.shape, dtype=bool)
    inside[_box(shaped)] = shaped.mask
    inside = inside[_box(grown)] & grown.mask
    # The crop has a margin of background but where the volume ends: there the organ goes on.
    labels, count = ndimage.label(erode(grown.mask, steps, radius))
    wanted = np.zeros(count + 1, dtype=bool)
    wanted[np.unique(labels[inside])] = True
    wanted[0] = False
    mask = (dilate(wanted[labels], steps, radius) & grown.mask) | inside
    labels, count = ndimage.label(mask)
    if count > 1:
        mask = labels == np.bincount(labels.ravel())[1:].argmax() + 1
    return region_from_crop(
        image, mask, np.array(grown.offset), fill=False, threshold=grown.threshold, erosion=grown.erosion
    )


def _box(region: Region) -> tuple[slice, ...]:
    """Where a region's crop lies in its volume."""
    return tuple(slice(first, first + size) for first, size in zip(region.offset, region.mask.shape))
