"""Edges of an organ, found along rays from seeds in it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .seeds import checked_seeds, voxels_of

# Level around a seed: the voxels within this distance.
_BALL_MM = 3.0
# Inside level along a ray: the mean over a window that ends before the sample, clear of a blurred edge.
_WINDOW_MM, _LAG_MM = 6.0, 1.5
# Behind the edge, the outside level is the one farthest from the inside within this depth, as in a thin wall.
_DEPTH_MM = 4.0
_LONGEST_RAY_MM = 150.0
# Most rays end within this: the others are followed a second time, farther.
_SHORT_RAY_MM = 50.0
# The level at the end of a ray is still that of the organ within this share of the contrast.
_SAME_LEVEL_SHARE = 0.45
# What several seeds see together is measured on a lattice of so many points along each axis.
_LATTICE = 20
_RAYS_BETWEEN = 4
# This share of the rays ends at the nearest wall.
_NEAREST = 0.1
# Rays within 15 degrees of each other are neighbours.
_COS_AROUND = np.cos(np.deg2rad(15.0))
# An edge is a step by this share of the contrast around the seeds, or by this many standard deviations of the noise.
_STEP_SHARE, _STEP_NOISE = 0.35, 4.0
# The contrast is that within this distance, without the darkest and the brightest share; sampled in such steps. Within
# less than 60 mm a full bladder may leave no room for what surrounds it; with 60 to 240 mm all seven are found.
_SURROUNDINGS_MM, _EXTREME, _RAY_STEP_MM = 90.0, 0.1, 1.5


@dataclass(frozen=True, eq=False)
class Edges:
    """Where rays from the seeds leave the organ, one entry per ray.

    Attributes
    ----------
    distances : ndarray, shape (n_seeds, n_rays)
        From the seed to the edge in mm; to the end of the ray where no edge was found.
    found : ndarray of bool, shape (n_seeds, n_rays)
    points : ndarray, shape (n_seeds, n_rays, 3)
        Where the rays end, RAS mm.
    inner, outer : ndarray, shape (n_seeds, n_rays)
        Grey levels before and behind the edge. Where none was found, that before the end of the ray, and nothing of
        meaning.
    levels : ndarray, shape (n_seeds,)
        Grey levels around the seeds.
    middle, spread : float
        Median and scaled median absolute deviation of the grey levels inside.
    directions : ndarray, shape (n_rays, 3)
        Unit vectors, RAS.
    axes : ndarray, shape (3, 3)
        Columns are unit vectors along the axes of the grid, RAS.
    """

    distances: np.ndarray
    found: np.ndarray
    points: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    levels: np.ndarray
    middle: float
    spread: float
    directions: np.ndarray
    axes: np.ndarray

    @cached_property
    def seeds(self) -> np.ndarray:
        """Where the rays begin, (n_seeds, 3), RAS mm."""
        return self.points[:, 0] - self.distances[:, :1] * self.directions[0]

    @cached_property
    def contrast(self) -> float:
        """Difference between the levels inside and behind the edges."""
        return float(np.abs(self.middle - np.median(self.outer[self.found]))) if self.found.any() else np.inf

    @cached_property
    def escaped(self) -> np.ndarray:
        """Rays that have left the organ through a gap or along a wall, (n_seeds, n_rays) of bool.

        The level before their end is no longer that of the organ, or they find no end at all.
        """
        other = np.abs(self.inner - self.middle) > _SAME_LEVEL_SHARE * self.contrast
        return other | (~self.found & (self.distances > _LONGEST_RAY_MM - 1.0))

    @cached_property
    def lengths(self) -> np.ndarray:
        """Distances without those of escaped rays, each the median of those around it, (n_seeds, n_rays)."""
        around = self.directions @ self.directions.T > _COS_AROUND
        neighbours = np.argsort(~around, axis=1, kind="stable")[:, : around.sum(axis=1).max()]
        counted = np.take_along_axis(around, neighbours, axis=1) & ~self.escaped[:, neighbours]
        # Masked rays come last in order, and the median of none is nothing.
        ordered = np.sort(np.where(counted, self.distances[:, neighbours], np.inf), axis=2)
        count = counted.sum(axis=2)[..., None]
        low, high = (
            np.take_along_axis(ordered, np.maximum(place, 0), axis=2)[..., 0]
            for place in ((count - 1) // 2, count // 2 * (count > 0))
        )
        return np.where(count[..., 0] > 0, (low + high) / 2.0, 0.0)

    @cached_property
    def depths(self) -> np.ndarray:
        """About how far the nearest wall is from each seed, (n_seeds,) mm."""
        return np.quantile(self.lengths, _NEAREST, axis=1)

    @cached_property
    def halves(self) -> np.ndarray:
        """Centres of mass of both halves of what the rays of each seed span, (2 n_seeds, 3), RAS mm.

        It is halved through the seed, across its longest principal axis. In a bent organ they need not lie inside.
        """
        spread = np.einsum("sr,ra,rb->sab", self.lengths**5, self.directions, self.directions)
        along = np.linalg.eigh(spread)[1][..., -1] @ self.directions.T
        points = []
        for side in (along > 0.0, along < 0.0):
            lengths = np.where(side, self.lengths, 0.0)
            # A cone's centre of mass is three quarters of the way to its base.
            lever = lengths**4 @ self.directions / np.maximum((lengths**3).sum(axis=1, keepdims=True), 1e-9)
            points.append(self.seeds + 0.75 * lever)
        return np.concatenate(points)

    @property
    def volumes(self) -> np.ndarray:
        """Volume that the rays of each seed span, (n_seeds,) mm^3."""
        return 4.0 / 3.0 * np.pi * (self.lengths**3).mean(axis=1)

    @cached_property
    def volume(self) -> float:
        """Volume in mm^3 that the rays of all seeds span together: right for an organ that they see all of."""
        if len(self.seeds) == 1:
            return float(self.volumes[0])
        ends = self.seeds[:, None] + self.lengths[..., None] * self.directions
        low, high = (limit(ends.reshape(-1, 3) @ self.axes, axis=0) for limit in (np.min, np.max))
        inside = (np.arange(_LATTICE) + 0.5) / _LATTICE
        lattice = np.stack(np.meshgrid(inside, inside, inside), axis=-1).reshape(-1, 3)
        points = (low + (high - low) * lattice) @ np.linalg.inv(self.axes)
        # Far from a seed rays are far apart: how far it sees between them is their mean. No farther than its longest.
        seen = np.zeros(len(points), dtype=bool)
        tree = cKDTree(self.directions)
        for seed, lengths in zip(self.seeds, self.lengths):
            away = points - seed
            distances = np.linalg.norm(away, axis=1)
            asked = np.flatnonzero(~seen & (distances <= lengths.max()))
            _, rays = tree.query(away[asked] / np.maximum(distances[asked], 1e-9)[:, None], k=_RAYS_BETWEEN)
            seen[asked] = distances[asked] <= lengths[rays].mean(axis=1)
        box = np.prod(high - low) * abs(np.linalg.det(np.linalg.inv(self.axes)))
        return float(seen.mean() * box)


def find_edges(image: Image, seeds) -> Edges:
    """Follow rays from the seeds to the first place where the grey level changes for good.

    Parameters
    ----------
    image : Image
    seeds : array_like, shape (n, 3) or (3,)
        Points in the organ, RAS mm.

    Returns
    -------
    Edges

    Raises
    ------
    ValueError
        If a seed is not a point of the volume.

    Notes
    -----
    A change is a step away from the mean of the last millimetres, so a coil's slow bias is followed.
    The directions of the rays are symmetric under any permutation and flip of the image's axes and turn with
    them, so a permuted, flipped or rotated copy of the volume gives the same edges.
    """
    seeds = checked_seeds(image, seeds)
    step = float(image.spacing.min())
    directions = _directions(image)
    contrast = _contrast_around(image, seeds, directions)
    level, noise = levels_at(image, seeds, contrast)
    rays = len(directions)
    starts, along = np.repeat(seeds, rays, axis=0), np.tile(directions, (len(seeds), 1))
    smallest = np.maximum(_STEP_NOISE * noise, _STEP_SHARE * contrast)
    edge, last, inner, outer, inside = _followed(
        image, starts, along, np.repeat(level, rays), np.repeat(smallest, rays), step
    )
    found = edge >= 0
    middle = float(np.median(np.concatenate([inside, level])))
    spread = 1.4826 * float(np.median(np.abs(inside - middle))) if inside.size else 0.0
    shape = (len(seeds), rays)
    distances = (last * step).reshape(shape)
    return Edges(
        distances=distances,
        found=found.reshape(shape),
        points=seeds[:, None, :] + distances[..., None] * directions,
        inner=inner.reshape(shape),
        outer=outer.reshape(shape),
        levels=level,
        middle=middle,
        spread=spread,
        directions=directions,
        axes=image.ijk_to_ras[:3, :3] / image.spacing,
    )


def contrast_of(levels: np.ndarray, valid: np.ndarray, radii: np.ndarray) -> float:
    """Contrast of what rays (n, m) see nearby: it is the same whatever is added to all levels.

    Parameters
    ----------
    levels : ndarray, shape (n, m)
    valid : ndarray of bool, shape (n, m)
    radii : ndarray, shape (m,)
        mm.

    Returns
    -------
    float
        Larger than 0.
    """
    near = levels[valid & (radii < _SURROUNDINGS_MM)]
    low, high = np.quantile(near, [_EXTREME, 1.0 - _EXTREME]) if near.size else (0.0, 0.0)
    return float(high - low) or float(np.ptp(near) if near.size else 0.0) or 1.0


def noise_of(changes: np.ndarray) -> float:
    """Scaled median of absolute differences."""
    return 1.4826 * float(np.median(changes)) if changes.size else 0.0


def joined(first: Edges, second: Edges, chosen: np.ndarray) -> Edges:
    """Edges of two sets of seeds in one organ, the second one's chosen only; the levels inside are the first one's."""
    both = {
        name: np.concatenate([getattr(first, name), getattr(second, name)[chosen]])
        for name in ("distances", "found", "points", "inner", "outer", "levels")
    }
    return replace(first, **both)


def _directions(image):
    """Return unit vectors along small whole-number directions of the grid's axes, RAS, (n, 3)."""
    whole = np.array([v for v in itertools.product(range(-3, 4), repeat=3) if np.gcd.reduce(v) == 1], dtype=float)
    directions = whole @ (image.ijk_to_ras[:3, :3] / image.spacing).T
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _contrast_around(image, seeds, directions):
    """Contrast in the surroundings of the seeds."""
    radii = np.arange(0.0, _SURROUNDINGS_MM, _RAY_STEP_MM)
    levels, valid = Sampler(image).values(seeds[:, None, None] + directions[:, None] * radii[:, None])
    return contrast_of(levels, valid, radii)


def _followed(image, starts, along, level, smallest, step):
    """Follow rays to their edges, which are steps by at least so much.

    Returns the sample of each edge (-1 where there is none), the number of samples before it or within the volume, the
    levels before and behind it, and all grey levels before edges that were found.
    """
    edge, last = np.full((2, len(starts)), -1)
    inner, outer = np.zeros((2, len(starts)))
    inside, asked = [], np.arange(len(starts))
    for reach in (_SHORT_RAY_MM, _LONGEST_RAY_MM):
        profiles, valid = _profiles(image, starts[asked], along[asked], np.arange(0.0, reach, step))
        steps = _steps(profiles, valid, level[asked], smallest[asked], step)
        # The end of a short ray is nothing to judge by.
        settled = (steps[0] >= 0) & (steps[0] + _depth(step) < profiles.shape[1] - 1) | (reach == _LONGEST_RAY_MM)
        done = asked[settled]
        edge[done], inner[done], outer[done] = (part[settled] for part in steps)
        last[done] = np.where(edge[done] >= 0, edge[done], valid[settled].sum(axis=1))
        before = (np.arange(profiles.shape[1]) < last[done][:, None]) & (edge[done] >= 0)[:, None]
        inside.append(profiles[settled][before & valid[settled]])
        asked = asked[~settled]
        if not len(asked):
            break
    return edge, last, inner, outer, np.concatenate(inside)


def _profiles(image, starts, along, distances):
    """Grey levels along rays, shape (rays, samples), and where they are in the volume."""
    levels, valid = Sampler(image).values(starts[:, None] + along[:, None, :] * distances[:, None])
    # Single voxels of noise do not end an organ.
    return ndimage.median_filter(continued(levels, valid), size=(1, 3), mode="nearest"), valid


def continued(levels, valid):
    """Grey levels along rays, (rays, samples), which beyond the volume are those of its last sample."""
    last = np.maximum(valid.sum(axis=1) - 1, 0)[:, None]
    return np.take_along_axis(levels, np.minimum(np.arange(levels.shape[1]), last), axis=1)


def _depth(step):
    """Count the samples behind an edge from which the level there is taken."""
    return max(int(round(_DEPTH_MM / step)), 2)


def levels_at(image, seeds, contrast):
    """Robust level and noise in a ball around each seed, of the voxels on the seed's side of an edge through it.

    Parameters
    ----------
    image : Image
    seeds : ndarray, shape (n, 3)
        RAS mm.
    contrast : float
        Of the surroundings.

    Returns
    -------
    levels, noise : ndarray, shape (n,)
        The noise is the scaled median difference of neighbours, along the axis of the grid where they differ least.
    """
    reach = np.maximum(np.floor(_BALL_MM / image.spacing), 1)
    offsets = np.stack(np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij"), axis=-1)
    near = np.linalg.norm(offsets * image.spacing, axis=-1) <= max(_BALL_MM, image.spacing.min())
    voxels = voxels_of(image, seeds)[:, None, None, None, ::-1] + offsets.astype(int)
    i, j, k = np.moveaxis(voxels.clip(0, image.size - 1), -1, 0)
    levels = image.array[k, j, i].astype(float)
    differences = [np.median(np.abs(np.diff(levels, axis=axis)).reshape(len(seeds), -1), axis=1) for axis in (1, 2, 3)]
    noise = 1.4826 / np.sqrt(2.0) * np.min(differences, axis=0)
    here = levels[(slice(None), *(np.array(near.shape) // 2))]
    smallest = np.maximum(_STEP_NOISE * noise, _STEP_SHARE * contrast)
    own = np.abs(levels - here[:, None, None, None]) <= smallest[:, None, None, None]
    return np.nanmedian(np.where(own & near, levels, np.nan).reshape(len(seeds), -1), axis=1), noise


def _steps(profiles, inside_volume, level, smallest, step):
    """Find the first lasting step along each ray.

    Returns the sample of the edge (-1 where there is none) and the levels before and behind it.
    """
    window, lag = int(np.ceil(_WINDOW_MM / step)), int(np.ceil(_LAG_MM / step))
    before = np.repeat(level[:, None], window + lag, axis=1)
    sums = np.cumsum(np.hstack([np.zeros((len(level), 1)), before, profiles]), axis=1)
    running = (sums[:, window : window + profiles.shape[1]] - sums[:, : profiles.shape[1]]) / window

    far = (np.abs(profiles - running) > smallest[:, None]) & inside_volume
    far[:, :-1] &= far[:, 1:]
    edge = np.where(far.any(axis=1), far.argmax(axis=1), -1)

    at = np.where(edge >= 0, edge, np.maximum(inside_volume.sum(axis=1) - 1, 0))[:, None]
    inner = np.take_along_axis(running, at, axis=1)
    depth = np.minimum(at + np.arange(_depth(step)), profiles.shape[1] - 1)
    behind = np.take_along_axis(profiles, depth, axis=1) - inner
    behind *= np.take_along_axis(inside_volume, depth, axis=1)
    signed = behind * np.sign(behind[:, :1])
    outer = inner + signed.max(axis=1, keepdims=True) * np.sign(behind[:, :1])
    return edge, inner[:, 0], outer[:, 0]
