"""Edges of an organ along rays from seeds in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .seeds import checked_seeds, voxels_of
from .sphere import small_whole_numbers

# The level around a seed is measured in the voxels within this distance.
_BALL_MM = 3.0
# The inside level at a sample is the mean over a window along the ray. The window ends before the sample, so that a
# blurred edge at the sample is outside of it.
_WINDOW_MM, _LAG_MM = 6.0, 1.5
# The wall may be thin: the outside level is the one farthest from the inside level within this distance of the edge.
_DEPTH_MM = 4.0
# Rays are followed to the short length first; those without an edge by then, to the long one.
_SHORT_RAY_MM, _LONGEST_RAY_MM = 50.0, 150.0
# The level at the end of a ray is that of the organ if it differs by at most this share of the contrast.
_SAME_LEVEL_SHARE = 0.45
# The volume that the rays of several seeds span is measured on a lattice of so many points along each axis; the
# distance to the edge in between rays is the mean of so many rays.
_LATTICE, _RAYS_BETWEEN = 20, 4
# The distance of the nearest wall is this quantile of the rays' lengths.
_NEAREST = 0.1
# Rays within 15 degrees of each other are neighbours.
_COS_NEIGHBOURS = np.cos(np.deg2rad(15.0))
# An edge is a step by this share of the contrast around the seeds and by this many standard deviations of the noise.
_STEP_SHARE, _STEP_NOISE = 0.35, 4.0
# The contrast is the range of the levels within this distance, without this share of the darkest and of the brightest;
# they are sampled at this spacing. Within less than 60 mm a full bladder may leave no room for what surrounds it; with
# 60 to 240 mm all seven are found.
_SURROUNDINGS_MM, _EXTREME, _RAY_STEP_MM = 120.0, 0.1, 1.5


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges along rays from seeds in an organ, one entry per ray.

    Attributes
    ----------
    distances : ndarray, shape (n_seeds, n_rays)
        From the seed to the edge, mm; to the end of the ray where no edge was found.
    found : ndarray of bool, shape (n_seeds, n_rays)
        Whether an edge was found.
    points : ndarray, shape (n_seeds, n_rays, 3)
        The edge or, where none was found, the end of the ray, RAS mm.
    inner, outer : ndarray, shape (n_seeds, n_rays)
        Grey levels before and behind the edge. Where no edge was found, ``inner`` is the level before the end of the
        ray and ``outer`` has no meaning.
    levels : ndarray, shape (n_seeds,)
        Grey levels around the seeds.
    median_level, spread : float
        Median and scaled median absolute deviation of the grey levels in the organ.
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
    median_level: float
    spread: float
    directions: np.ndarray
    axes: np.ndarray

    @cached_property
    def seeds(self) -> np.ndarray:
        """Starting points of the rays, (n_seeds, 3), RAS mm."""
        return self.points[:, 0] - self.distances[:, :1] * self.directions[0]

    @cached_property
    def contrast(self) -> float:
        """Difference between the median levels in the organ and behind the edges; infinite without edges."""
        return float(np.abs(self.median_level - np.median(self.outer[self.found]))) if self.found.any() else np.inf

    @cached_property
    def escaped(self) -> np.ndarray:
        """Rays that have left the organ through a gap or along a wall, (n_seeds, n_rays) of bool.

        The level before their end is not that of the organ, or they have no edge up to the largest length.
        """
        other = np.abs(self.inner - self.median_level) > _SAME_LEVEL_SHARE * self.contrast
        return other | (~self.found & (self.distances > _LONGEST_RAY_MM - 1.0))

    @cached_property
    def lengths(self) -> np.ndarray:
        """Median distance of each ray's neighbours that have not escaped, mm, (n_seeds, n_rays); 0 if all have."""
        around = self.directions @ self.directions.T > _COS_NEIGHBOURS
        neighbours = np.argsort(~around, axis=1, kind="stable")[:, : around.sum(axis=1).max()]
        counted = np.take_along_axis(around, neighbours, axis=1) & ~self.escaped[:, neighbours]
        # Infinite distances of escaped rays are sorted to the end, behind the ones that count.
        ordered = np.sort(np.where(counted, self.distances[:, neighbours], np.inf), axis=2)
        count = counted.sum(axis=2)[..., None]
        low, high = (
            np.take_along_axis(ordered, np.maximum(place, 0), axis=2)[..., 0]
            for place in ((count - 1) // 2, count // 2 * (count > 0))
        )
        return np.where(count[..., 0] > 0, (low + high) / 2.0, 0.0)

    @cached_property
    def wall_distances(self) -> np.ndarray:
        """Distance of the nearest wall from each seed, a low quantile of the lengths, (n_seeds,) mm."""
        return np.quantile(self.lengths, _NEAREST, axis=1)

    @cached_property
    def half_centroids(self) -> np.ndarray:
        """Centres of mass of both halves of the volume that the rays of each seed span, (2 n_seeds, 3), RAS mm.

        The volume is divided by the plane through the seed across its longest principal axis. In a bent organ the
        centres may lie outside.
        """
        second_moments = np.einsum("sr,ra,rb->sab", self.lengths**5, self.directions, self.directions)
        along = np.linalg.eigh(second_moments)[1][..., -1] @ self.directions.T
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
        """Volume of the union of what the rays of each seed span, mm^3."""
        if len(self.seeds) == 1:
            return float(self.volumes[0])
        ends = self.seeds[:, None] + self.lengths[..., None] * self.directions
        low, high = (limit(ends.reshape(-1, 3) @ self.axes, axis=0) for limit in (np.min, np.max))
        inside = (np.arange(_LATTICE) + 0.5) / _LATTICE
        lattice = np.stack(np.meshgrid(inside, inside, inside), axis=-1).reshape(-1, 3)
        points = (low + (high - low) * lattice) @ np.linalg.inv(self.axes)
        # Far from a seed its rays are far apart, so the distance to the edge in between is averaged over several.
        spanned = np.zeros(len(points), dtype=bool)
        tree = cKDTree(self.directions)
        for seed, lengths in zip(self.seeds, self.lengths):
            away = points - seed
            distances = np.linalg.norm(away, axis=1)
            others = np.flatnonzero(~spanned & (distances <= lengths.max()))
            _, rays = tree.query(away[others] / np.maximum(distances[others], 1e-9)[:, None], k=_RAYS_BETWEEN)
            spanned[others] = distances[others] <= lengths[rays].mean(axis=1)
        box = np.prod(high - low) * abs(np.linalg.det(np.linalg.inv(self.axes)))
        return float(spanned.mean() * box)


def find_edges(image: Image, seeds) -> Edges:
    """Find the first lasting change of the grey level along rays from seeds.

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
    A change is measured from the mean of the last millimetres, so that the slow bias of a coil is no edge.
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
    edge, last, inner, outer, inside = _first_edges(
        image, starts, along, np.repeat(level, rays), np.repeat(smallest, rays), step
    )
    found = edge >= 0
    median_level = float(np.median(np.concatenate([inside, level])))
    spread = 1.4826 * float(np.median(np.abs(inside - median_level))) if inside.size else 0.0
    shape = (len(seeds), rays)
    distances = (last * step).reshape(shape)
    return Edges(
        distances=distances,
        found=found.reshape(shape),
        points=seeds[:, None, :] + distances[..., None] * directions,
        inner=inner.reshape(shape),
        outer=outer.reshape(shape),
        levels=level,
        median_level=median_level,
        spread=spread,
        directions=directions,
        axes=image.ijk_to_ras[:3, :3] / image.spacing,
    )


def contrast_of(levels: np.ndarray, valid: np.ndarray, radii: np.ndarray) -> float:
    """Contrast of the surroundings of a place: the range of the levels along rays nearby, without extremes.

    Parameters
    ----------
    levels : ndarray, shape (..., m)
        Grey levels along rays from the place.
    valid : ndarray of bool, shape (..., m)
        Whether the samples are in the volume.
    radii : ndarray, shape (m,) or (..., m)
        Distances of the samples from the place, mm.

    Returns
    -------
    float
        Larger than 0; 1 if all levels are the same.
    """
    near = levels[valid & (radii < _SURROUNDINGS_MM)]
    low, high = np.quantile(near, [_EXTREME, 1.0 - _EXTREME]) if near.size else (0.0, 0.0)
    return float(high - low) or float(np.ptp(near) if near.size else 0.0) or 1.0


def noise_of(changes: np.ndarray) -> float:
    """Median of absolute differences, scaled to a standard deviation of normal noise; 0 without any."""
    return 1.4826 * float(np.median(changes)) if changes.size else 0.0


def joined(first: Edges, second: Edges, chosen: np.ndarray) -> Edges:
    """Join the edges of two sets of seeds in one organ: all of the first, and those of the chosen seeds of the second.

    The median level and its spread are those of the first.
    """
    both = {
        name: np.concatenate([getattr(first, name), getattr(second, name)[chosen]])
        for name in ("distances", "found", "points", "inner", "outer", "levels")
    }
    return replace(first, **both)


def _directions(image):
    """Return unit vectors along small whole numbers in the frame of the grid's axes, RAS, (n, 3)."""
    directions = small_whole_numbers(3) @ (image.ijk_to_ras[:3, :3] / image.spacing).T
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _contrast_around(image, seeds, directions):
    """Contrast in the surroundings of the seeds."""
    radii = np.arange(0.0, _SURROUNDINGS_MM, _RAY_STEP_MM)
    levels, valid = Sampler(image).values(seeds[:, None, None] + directions[:, None] * radii[:, None])
    return contrast_of(levels, valid, radii)


def _first_edges(image, starts, along, level, smallest, step):
    """Find the first edge along each ray, a step of at least the ray's smallest one.

    Returns the sample of each edge (-1 where there is none), the number of samples before it or, without one, in the
    volume, the levels before and behind it, and all grey levels before edges.
    """
    edge, last = np.full((2, len(starts)), -1)
    inner, outer = np.zeros((2, len(starts)))
    inside, open_rays = [], np.arange(len(starts))
    for reach in (_SHORT_RAY_MM, _LONGEST_RAY_MM):
        profiles, valid = _profiles(image, starts[open_rays], along[open_rays], np.arange(0.0, reach, step))
        steps = _steps(profiles, valid, level[open_rays], smallest[open_rays], step)
        # An edge near the end of a short ray is searched again on the long one, which shows the level behind it.
        clear_of_end = steps[0] + _outside_samples(step) < profiles.shape[1] - 1
        complete = (steps[0] >= 0) & clear_of_end | (reach == _LONGEST_RAY_MM)
        done = open_rays[complete]
        edge[done], inner[done], outer[done] = (part[complete] for part in steps)
        last[done] = np.where(edge[done] >= 0, edge[done], valid[complete].sum(axis=1))
        before = (np.arange(profiles.shape[1]) < last[done][:, None]) & (edge[done] >= 0)[:, None]
        inside.append(profiles[complete][before & valid[complete]])
        open_rays = open_rays[~complete]
        if not len(open_rays):
            break
    return edge, last, inner, outer, np.concatenate(inside)


def _profiles(image, starts, along, distances):
    """Grey levels along rays, (rays, samples), and whether they are in the volume."""
    levels, valid = Sampler(image).values(starts[:, None] + along[:, None, :] * distances[:, None])
    # The median removes noise of single voxels, which are no edges.
    return ndimage.median_filter(continued(levels, valid), size=(1, 3), mode="nearest"), valid


def continued(levels, valid):
    """Continue grey levels along rays, (rays, samples), by the last one in the volume."""
    last = np.maximum(valid.sum(axis=1) - 1, 0)[:, None]
    return np.take_along_axis(levels, np.minimum(np.arange(levels.shape[1]), last), axis=1)


def _outside_samples(step):
    """Return the number of samples, from an edge on, in which the outside level is searched."""
    return max(int(round(_DEPTH_MM / step)), 2)


def levels_at(image, seeds, contrast):
    """Median level and noise in a ball around each seed, of the voxels on the seed's side of any edge through the ball.

    Parameters
    ----------
    image : Image
    seeds : ndarray, shape (n, 3)
        RAS mm.
    contrast : float
        Contrast of the surroundings.

    Returns
    -------
    levels, noise : ndarray, shape (n,)
        The noise is the scaled median difference between neighbours, along the axis of the grid where it is least.
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
    """Find the first step along each ray that two samples in a row show.

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
    depth = np.minimum(at + np.arange(_outside_samples(step)), profiles.shape[1] - 1)
    behind = np.take_along_axis(profiles, depth, axis=1) - inner
    behind *= np.take_along_axis(inside_volume, depth, axis=1)
    signed = behind * np.sign(behind[:, :1])
    outer = inner + signed.max(axis=1, keepdims=True) * np.sign(behind[:, :1])
    return edge, inner[:, 0], outer[:, 0]
