"""How much of a region's boundary the image shows as an edge."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..imaging.image import Image
from ..imaging.morphology import boundary_voxels
from ..imaging.region import Region
from ..imaging.sampling import Sampler
from .star_surface import STEP_SHARE, Star, blurred

# As many voxels of the boundary are looked at.
MOST_PLACES = 3000
# Before and behind an edge, levels are taken at so many places, one apart from the next and from the edge, mm.
_SIDE, _STEP_MM = 3, 0.75
# The edge is looked for so many places to either side of the boundary: a boundary that runs a millimetre beside it is
# at the same edge.
_BESIDE = 2
_DEPTHS_MM = _STEP_MM * np.arange(-_SIDE - _BESIDE, _SIDE + _BESIDE + 1)
# Normals come from the voxels within this distance.
_AROUND_MM = 3.0


class EdgeStrengths:
    """How much of an edge an image shows along the boundaries of masks.

    Parameters
    ----------
    image : Image
    star : Star
        Give contrast and sign of the edge.
    start, stop : (3,) array_like of int
        Box of voxels (k, j, i) in which the boundaries lie.
    """

    def __init__(self, image: Image, star: Star, start, stop):
        margin = margin_of(image)
        low, high = np.maximum(start - margin, 0), np.minimum(stop + margin, image.array.shape)
        crop = image.crop(low, high)
        levels = blurred(Image(crop.array.astype(np.float32), crop.ijk_to_ras))
        self._sampler, self._image, self._star = Sampler(Image(levels, crop.ijk_to_ras)), image, star

    def at(self, mask: np.ndarray, voxels: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Look across a mask's boundary.

        Parameters
        ----------
        mask : ndarray of bool, shape (nk, nj, ni)
        voxels : ndarray of int, shape (n, 3)
            Voxels (k, j, i) of the mask at its boundary.
        start : ndarray of int, shape (3,)
            First voxel (k, j, i) of the mask in the image.

        Returns
        -------
        places : ndarray, shape (n, 3)
            RAS mm.
        strengths : ndarray, shape (n,)
            From 0 to 1; NaN at the border of the volume.
        """
        normals = _normals(mask, voxels, self._image)
        places = self._image.to_ras((voxels + start)[:, ::-1].astype(float))
        levels, valid = self._sampler.values(places[:, None] + _DEPTHS_MM[:, None] * normals[:, None])
        sides = sliding_window_view(levels if self._star.bright else -levels, _SIDE, axis=1)
        falls = (sides[:, : -_SIDE - 1].mean(axis=2) - sides[:, _SIDE + 1 :].min(axis=2)).max(axis=1)
        strengths = np.maximum(np.tanh(falls / (STEP_SHARE * self._star.contrast)), 0.0)
        return places, np.where(valid.all(axis=1), strengths, np.nan)


def margin_of(image: Image) -> np.ndarray:
    """Voxels (k, j, i) beside a boundary that its edge is looked for in."""
    return np.ceil((_DEPTHS_MM[-1] + 1.0) / image.spacing[::-1]).astype(int)


def edge_support(image: Image, region: Region, star: Star) -> float:
    """Mean strength of the edge along a region's boundary, from 0 to 1.

    Parameters
    ----------
    image, region, star
        As for :func:`edge_strengths`.

    Returns
    -------
    float
        Without what the border of the volume cuts; 0 where it cuts everything.
    """
    strengths = edge_strengths(image, region, star)[1]
    return float(strengths.mean()) if len(strengths) else 0.0


def edge_strengths(image: Image, region: Region, star: Star) -> tuple[np.ndarray, np.ndarray]:
    """How much of an edge there is at places of a region's boundary.

    Parameters
    ----------
    image : Image
    region : Region
    star : Star
        Give contrast and sign of the edge.

    Returns
    -------
    places : ndarray, shape (n, 3)
        RAS mm, without those at the border of the volume.
    strengths : ndarray, shape (n,)
        From 0 to 1.
    """
    voxels = boundary_voxels(region.mask)
    voxels = voxels[:: -(-len(voxels) // MOST_PLACES)]
    start = np.asarray(region.offset)
    edges = EdgeStrengths(image, star, start, start + region.mask.shape)
    places, strengths = edges.at(region.mask, voxels, start)
    seen = np.isfinite(strengths)
    return places[seen], strengths[seen]


def area_without_edge(image: Image, region: Region, star: Star) -> float:
    """Area of a region's boundary along which the image shows no edge, where the region's volume is 1.

    Parameters
    ----------
    image : Image
    region : Region
    star : Star
        Give contrast and sign of the edge.

    Returns
    -------
    float
        A region of any size has the same: a ball with no edge at all has 7.3, since faces of voxels are counted.
    """
    mask, spacing = np.pad(region.mask, 1).astype(np.int8), region.spacing[::-1]
    faces = [np.count_nonzero(np.diff(mask, axis=axis)) / spacing[axis] for axis in range(3)]
    area = sum(faces) * np.prod(spacing)
    return (1.0 - edge_support(image, region, star)) * area / (1000.0 * region.volume_ml) ** (2.0 / 3.0)


def agreement(first: Region, second: Region) -> float:
    """Dice coefficient of two regions on one grid."""
    start = np.maximum(first.offset, second.offset)
    stop = np.minimum(*(np.asarray(part.offset) + part.mask.shape for part in (first, second)))
    if np.any(start >= stop):
        return 0.0
    masks = [
        part.mask[tuple(slice(*ends) for ends in zip(start - part.offset, stop - part.offset))]
        for part in (first, second)
    ]
    common = np.count_nonzero(masks[0] & masks[1])
    return 2.0 * common / (np.count_nonzero(first.mask) + np.count_nonzero(second.mask))


def _normals(mask: np.ndarray, voxels: np.ndarray, image: Image) -> np.ndarray:
    """Outward normals at voxels of a mask's boundary: away from the middle of its voxels around, (n, 3) RAS."""
    reach = np.maximum(np.floor(_AROUND_MM / image.spacing), 1).astype(int)
    offsets = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij"), axis=-1).reshape(-1, 3)
    steps = offsets @ image.ijk_to_ras[:3, :3].T
    near = np.linalg.norm(steps, axis=1) <= max(_AROUND_MM, image.spacing.max())
    offsets, steps = offsets[near], steps[near]
    padded = np.pad(mask, [(n, n) for n in reach[::-1]])
    k, j, i = np.moveaxis(voxels[:, None] + reach[::-1] + offsets[:, ::-1], -1, 0)
    normals = -(padded[k, j, i] @ steps)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
