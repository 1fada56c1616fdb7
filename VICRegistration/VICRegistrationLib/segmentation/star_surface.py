"""Star-shaped surface of an organ: one radius along each direction from a centre, chosen by optimal surface detection.

The surface needs no threshold. The search is repeated from the centroid of the surface that was found, so that the
result depends little on where in the organ the seed is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .ray_edges import continued, contrast_of, noise_of
from .sphere import between, cheapest_radii, smoothed, sphere

# Distance between samples along a ray, and length of the rays. With samples 0.375 or 1.5 mm apart the Dice coefficient
# of the star-shaped region changes by at most 0.01 in three hard bladders (IM0228, IM0952, IM1383).
STEP_MM, _LONGEST_MM = 0.75, 100.0
# The image is cropped to this distance from the seed: the centre of a long organ is far from a seed at its end.
_REACH_MM = 1.5 * _LONGEST_MM
# The radii to choose from begin here, each is longer than the one before by this ratio, and those of neighbouring rays
# are at most so many places apart.
_SHORTEST_MM, _RATIO, _MOST_APART = 2.0, 1.05, 9
# Fine voxels are averaged over this distance to each side, against noise.
_BLUR_MM = 0.5
# The step at a sample is the difference between the means over the places before and behind it, at these distances. A
# change of the level between the earlier places and those before, or between those behind and the later ones, is taken
# for shading, and this share of it is subtracted from the step.
_BEFORE_MM, _BEHIND_MM, _EARLIER_MM, _LATER_MM = (-2.25, -0.75), (0.75, 1.5), (-6.0, -3.75), (3.75, 6.0)
_SHADING = 0.5
# Thick slices blur an edge. So the distances above are multiplied by the length of a voxel along the ray over this
# length, mm, rounded to a whole number of at least 1. In seven bladders resampled to slices of 2.5 to 4 mm, axial and
# sagittal, the mean Dice coefficient of the region is 0.910 without this, 0.954 with it, 0.935 with half and 0.919 with
# twice this length.
_VOXEL_MM = 1.125
# A step of this share of the contrast has an edge strength of tanh(1), three quarters of the largest.
STEP_SHARE = 0.4
# This share of the contrast is subtracted from each step first. Otherwise steps of noise may favour a small surface
# around the seed.
_LEAST_STEP = 0.06
# Changes of the grey level are differences between places this far apart. Changes up to this share of the contrast per
# mm are taken for shading, and up to so many standard deviations for noise.
_CHANGE_MM, _SHADING_CHANGE, _NOISE_CHANGE = 0.75, 0.08, 1.0
# Weights in the cost, in which the largest edge strength lowers the cost by 1: of the sharp changes that the ray has
# crossed before; of how far the level has risen on the way, as from a dark wall to the fat behind it; of slopes of 45
# degrees between neighbouring rays (the smoothness weight); and of the border of the volume, which counts as an edge.
# Sharp changes may weigh 0.1 to 0.6: with 0 the surface leaks, and with 0.7 it leaves dark urine out (IM0228, IM0952).
# With 0.1, 0.2 and 0.4 for the border, 18 clicks in two bladders that the volume cuts (IM0228, IM1523) find these, and
# from the deepest places the Dice coefficient of the region varies by 0.002; with 0.46, IM0228 is 1.8 mm off. In seven
# bladders slopes may weigh 0.055 to 0.22; with less than 0.12 a rectum in thick slices goes on through the anal canal.
_CROSSED_WEIGHT, _RISE_WEIGHT, _SMOOTHNESS, _BORDER_WEIGHT = 0.3, 0.35, 0.13, 0.2
# Cost of a radius that is excluded or misses a known place of the wall. A radius of the ray nearest to a place misses
# it if they differ by more than a sample plus this many times the distance of the place from the ray.
_EXCLUDED_COST, _WALL_SLOPE = 50.0, 1.0
# The search is repeated from the centroid of the surface until that moves by less than this, mm, and so many times at
# most. It ends early where the cost is not below 0, that of a surface which has no edge and has crossed nothing. In
# real bladders the centroid is still 2 to 14 mm away after three searches from a seed near the wall.
_CONVERGED_MM, _MOST_SEARCHES = 1.0, 10
# From a seed near the wall or in a dark or bright spot, the search may end at a small surface, though the organ's costs
# less. So a larger one is searched around it: with no radius shorter than its longest one, nor than this. Of both, the
# one of less cost is taken. The larger one is found once more around its centroid with all radii, because the organ's
# wall may be nearer. With 7.5, 15 and 30 mm the same 18 clicks find the bladder.
LEAST_MM = 15.0
# A seed that lies outside of the surface by at most this counts as inside.
_SEED_TOLERANCE_MM = 2.0
# The last two searches measure slopes from a smooth shape: spherical harmonics up to this degree, fitted to the
# logarithm of the radii that were found. The smoothness weight is then the larger one here. In 8 hard bladders the mean
# Dice coefficient of the region is 0.960, and 0.956 without; degrees of 2 and 6, and weights of 0.1 and 0.4, change
# single ones by up to 0.01.
_DEGREE, _SHAPE_SMOOTHNESS = 4, 0.2
# The last search has more directions (whole numbers up to the first of these, see `sphere`), and radii within this
# distance of the surface that was found.
_FINE, _NEAR_MM = 5, 7.5
# The wall may be thin: the level outside is the one farthest from the level inside up to this distance from the edge.
_WALL_MM = 3.0
# Edges of a greater strength count as found.
EDGE_STRENGTH = 0.46


@dataclass(frozen=True, eq=False)
class Star:
    """A closed star-shaped surface: one radius for each direction from its centre.

    Attributes
    ----------
    center : ndarray, shape (3,)
        RAS mm.
    directions : ndarray, shape (n, 3)
        Unit vectors, RAS.
    radii : ndarray, shape (n,)
        From the centre to the surface, mm.
    strengths : ndarray, shape (n,)
        Edge strength at the surface, from 0 to 1.
    border : ndarray, shape (n,)
        Distance from the centre to the last sample in the volume, mm.
    inner, outer : ndarray, shape (n,)
        Grey levels before and behind the surface.
    contrast : float
        Contrast of the grey levels around the centre, larger than 0; the unit of steps.
    bright : bool
        True if the organ is brighter than what borders on it.
    cost : float
        Mean cost over the directions that are not cut, without that of slopes, plus what the cut ones have crossed,
        divided by the number of all directions. The border of the volume counts neither for a surface nor against it.
    """

    center: np.ndarray
    directions: np.ndarray
    radii: np.ndarray
    strengths: np.ndarray
    border: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    contrast: float
    bright: bool
    cost: float

    @property
    def points(self) -> np.ndarray:
        """Points of the surface, (n, 3) RAS mm."""
        return self.center + self.radii[:, None] * self.directions

    @property
    def cut(self) -> np.ndarray:
        """Where the surface lies beyond the border of the volume, (n,) of bool."""
        return self.radii > self.border

    @cached_property
    def centroid(self) -> np.ndarray:
        """Centre of mass of the part in the volume, (3,) RAS mm."""
        radii = np.minimum(self.radii, self.border)
        # A cone's centre of mass is three quarters of the way to its base.
        return self.center + 0.75 * (radii**4 @ self.directions) / (radii**3).sum()

    @property
    def found(self) -> np.ndarray:
        """Where an edge was found, (n,) of bool."""
        return (self.strengths > EDGE_STRENGTH) & ~self.cut


def find_star(image: Image, seeds: np.ndarray, wall: np.ndarray | None = None) -> Star:
    """Find the star-shaped surface of least cost around seeds.

    Parameters
    ----------
    image : Image
    seeds : (3,) or (n, 3) ndarray
        RAS mm, in the volume. The first search starts from their mean. A surface that contains all of several seeds is
        not replaced by one that does not.
    wall : (n, 3) ndarray, optional
        Places that the surface has to pass, RAS mm.

    Returns
    -------
    Star

    Notes
    -----
    The cost of a radius is low where the grey level has a sharp step. What the ray has crossed before that raises the
    cost: sharp changes, and any rise of the level (a fall for an organ that is darker than its wall). Both a bright and
    a dark organ are tried, and the surface of less cost is taken. As in optimal surface detection [1]_, the surface is
    smooth because slopes between neighbouring rays cost their square. The last two searches, the second with more
    directions, measure slopes from a smooth shape fitted to the surface, so that it continues as that shape where the
    image shows no edge.

    References
    ----------
    .. [1] K. Li, X. Wu, D. Chen, M. Sonka, "Optimal surface segmentation in volumetric images", IEEE Trans. PAMI 28(1),
       2006.
    """
    seeds = np.atleast_2d(seeds)
    seed = seeds.mean(axis=0)
    level = float(image.array[tuple(np.rint(image.to_ijk(seed[None])[0, ::-1]).astype(int))])
    search = _Search(image, seeds, np.empty((0, 3)) if wall is None else wall)
    star = search.refined(search.smoother(min(search.candidates(seed), key=lambda star: star.cost)))
    return replace(star, inner=star.inner + level, outer=star.outer + level)


def blurred(image: Image) -> np.ndarray:
    """Average fine voxels over about a millimetre; the array of an image."""
    return ndimage.uniform_filter(image.array, size=tuple(2 * np.rint(_BLUR_MM / image.spacing[::-1]).astype(int) + 1))


def _around(image: Image, seed: np.ndarray) -> Image:
    """Crop the image around a seed, subtract the grey level at the seed, and average."""
    voxel = np.rint(image.to_ijk(seed[None])[0, ::-1]).astype(int)
    reach = np.ceil(_REACH_MM / image.spacing[::-1]).astype(int)
    crop = image.crop(np.maximum(voxel - reach, 0), np.minimum(voxel + reach + 1, image.array.shape))
    # In double precision, so that a constant added to all grey levels does not change the result.
    levels = (crop.array.astype(float) - float(image.array[tuple(voxel)])).astype(np.float32)
    return Image(blurred(Image(levels, crop.ijk_to_ras)), crop.ijk_to_ras)


class _Search:
    """Search for a surface around seeds (m, 3) in an image, through known places (n, 3) of the wall."""

    def __init__(self, image: Image, seeds: np.ndarray, wall: np.ndarray):
        self.image, self.seeds, self.wall = image, seeds, wall
        self.sampler = Sampler(_around(image, seeds.mean(axis=0)))
        self.axes = image.ijk_to_ras[:3, :3] / image.spacing

    def once(self, center: np.ndarray, *, bright: bool, shortest: float = 0.0, shape: np.ndarray | None = None) -> Star:
        """Find the surface around a centre with radii from the shortest on, mm.

        Slopes are measured from those of a smooth shape with radii (n,), mm, if one is given.
        """
        radii = np.arange(STEP_MM / 2.0, _LONGEST_MM, STEP_MM)
        directions = sphere().directions @ self.axes.T
        rays = self.rays(center, directions, np.tile(radii, (len(directions), 1)))
        costs, strengths = rays.costs(bright, self.wall)
        samples = _chosen(costs + _EXCLUDED_COST * (radii < shortest), radii, shape)
        return rays.star(bright, samples, costs, strengths)

    def rays(self, center: np.ndarray, directions: np.ndarray, radii: np.ndarray) -> _Rays:
        """Sample the image along rays."""
        levels, valid = self.sampler.values(center + directions[:, None] * radii[..., None])
        valid = np.logical_and.accumulate(valid, axis=1)
        voxels = np.linalg.norm(directions @ np.linalg.inv(self.axes).T * self.image.spacing, axis=1)
        scales = np.maximum(np.rint(voxels / _VOXEL_MM), 1.0).astype(int)
        return _Rays(center, directions, radii, continued(levels.astype(float), valid), valid, scales[:, None])

    def candidates(self, seed: np.ndarray) -> list[Star]:
        """Find surfaces of a bright and of a dark organ around a seed, and larger ones around these."""
        found = []
        for bright in (True, False):
            star = self.repeated(seed, bright=bright)
            larger = self.repeated(star.center, bright=bright, shortest=max(LEAST_MM, star.radii.max()))
            found += [star, larger]
            if larger.cost <= min(each.cost for each in found):
                again = self.repeated(larger.center, bright=bright)
                if not self.loses_seeds(larger, again):
                    found.append(again)
        return found

    def repeated(self, seed: np.ndarray, *, bright: bool, shortest: float = 0.0) -> Star:
        """Find the surface around a seed, and again around its own centroid until that stays in place."""
        star = self.once(seed, bright=bright, shortest=shortest)
        image = self.image
        for _ in range(_MOST_SEARCHES - 1):
            center = image.to_ras(np.clip(image.to_ijk(star.centroid[None]), 0.0, image.size - 1.0))[0]
            if np.linalg.norm(center - star.center) < _CONVERGED_MM:
                break
            further = self.once(center, bright=bright, shortest=shortest)
            if self.loses_seeds(star, further):
                break
            star = further
            if star.cost >= 0.0:
                break
        return star

    def loses_seeds(self, star: Star, further: Star) -> bool:
        """Whether there are several seeds, and a surface contains all of them while a further one does not."""
        return len(self.seeds) > 1 and self.contains_seeds(star) and not self.contains_seeds(further)

    def contains_seeds(self, star: Star) -> bool:
        """Whether all seeds are inside of a surface, within the tolerance."""
        away = self.seeds - star.center
        distances = np.linalg.norm(away, axis=1)
        radii = between(star.directions, star.radii, away / np.maximum(distances, 1e-9)[:, None])
        return bool((distances <= radii + _SEED_TOLERANCE_MM).all())

    def smoother(self, star: Star) -> Star:
        """Find the surface again around the same centre, with slopes measured from a smooth shape fitted to it."""
        return self.once(star.center, bright=star.bright, shape=_shape(star, star.directions))

    def refined(self, star: Star) -> Star:
        """Find the surface again with more directions, near the one that was found."""
        ball = sphere(_FINE)
        directions = ball.directions @ self.axes.T
        # Before they are turned: many are equally near to others, and rounding errors would choose among them.
        radii = between(sphere().directions, star.radii, ball.directions)
        inner = int(np.ceil(radii.max() / STEP_MM))
        count = _samples(_NEAR_MM)
        steps = STEP_MM * np.arange(-inner, count + _samples(_LATER_MM[1]) + 1)
        rays = self.rays(star.center, directions, np.maximum(radii[:, None] + steps, STEP_MM / 2.0))
        costs, strengths = rays.costs(star.bright, self.wall)
        near = slice(max(inner - count, 0), inner + count + 1)
        slopes = 2.0 * STEP_MM / ((radii[ball.first] + radii[ball.second]) * ball.angles)
        shape = (_shape(star, directions) - radii) / STEP_MM
        best = cheapest_radii(
            ball, costs[:, near], slopes, smoothness=_SHAPE_SMOOTHNESS, most_apart=_MOST_APART, shape=shape
        )
        return rays.star(star.bright, near.start + best, costs, strengths)


@dataclass(frozen=True, eq=False)
class _Rays:
    """Grey levels along n rays from a centre: radii, mm, levels, and whether they are in the volume, each (n, m).

    `scales`, (n, 1), multiply the distances in which an edge is measured.
    """

    center: np.ndarray
    directions: np.ndarray
    radii: np.ndarray
    levels: np.ndarray
    valid: np.ndarray
    scales: np.ndarray

    @cached_property
    def contrast(self) -> float:
        """Contrast of the grey levels along the rays."""
        return contrast_of(self.levels, self.valid, self.radii)

    def costs(self, bright: bool, wall: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cost and edge strength at every sample, each (n, m), of an organ that is bright or dark."""
        levels = self.levels if bright else -self.levels
        crossed = _CROSSED_WEIGHT * _crossed(self.levels, self.valid, self.contrast, self.scales)
        crossed += _RISE_WEIGHT * _largest_rise(levels, self.contrast, self.scales)
        strengths = _strengths(levels, self.contrast, self.scales)
        last = np.maximum(self.valid.sum(axis=1) - 1, 0)[:, None]
        beyond = np.take_along_axis(crossed, last, axis=1) - _BORDER_WEIGHT
        return np.where(self.valid, crossed - strengths, beyond) + self._cost_of_wall(wall), strengths

    def _cost_of_wall(self, wall: np.ndarray) -> np.ndarray:
        """Cost of the samples that miss the known places of the wall nearest to their ray, (n, m)."""
        away = wall - self.center
        distances = np.linalg.norm(away, axis=1)
        cosines = self.directions @ (away / distances[:, None]).T
        cost, rays = np.zeros_like(self.levels), cosines.argmax(axis=0)
        for ray in np.unique(rays):
            of_ray = rays == ray
            aside = distances[of_ray] * np.sqrt(np.maximum(1.0 - cosines[ray, of_ray] ** 2, 0.0))
            missed = np.abs(self.radii[ray, :, None] - distances[of_ray]) > STEP_MM + _WALL_SLOPE * aside
            cost[ray] = _EXCLUDED_COST * missed.all(axis=1)
        return cost

    def star(self, bright: bool, samples: np.ndarray, costs: np.ndarray, strengths: np.ndarray) -> Star:
        """Make the surface through the chosen sample of each ray."""
        rays, levels, sign = np.arange(len(samples)), self.levels, 1.0 if bright else -1.0
        inside, chosen = self.valid[rays, samples], costs[rays, samples]
        # Beyond the border the cost is what has been crossed, less the border's weight.
        crossed = chosen[~inside] + _BORDER_WEIGHT
        behind = np.minimum(samples[:, None] + self.scales * np.arange(_samples(_WALL_MM) + 1), levels.shape[1] - 1)
        return Star(
            center=self.center,
            directions=self.directions,
            radii=self.radii[rays, samples],
            strengths=strengths[rays, samples],
            border=self.radii[rays, np.maximum(self.valid.sum(axis=1) - 1, 0)],
            inner=_means(levels, _BEFORE_MM, self.scales)[rays, samples],
            outer=sign * (sign * np.take_along_axis(levels, behind, 1)).min(axis=1),
            contrast=self.contrast,
            bright=bright,
            cost=float(chosen[inside].sum() / max(inside.sum(), 1) + crossed.sum() / len(rays)),
        )


def _strengths(levels: np.ndarray, contrast: float, scales: np.ndarray) -> np.ndarray:
    """Edge strength, from 0 to 1, of a fall of the level at every sample."""
    parts = (_EARLIER_MM, _BEFORE_MM, _BEHIND_MM, _LATER_MM)
    earlier, before, behind, later = (_means(levels, part, scales) for part in parts)
    shading = np.maximum(earlier - before, 0.0) + np.maximum(behind - later, 0.0)
    steps = (before - behind - _SHADING * shading) / contrast
    return np.tanh(np.maximum(steps - _LEAST_STEP, 0.0) / STEP_SHARE)


def _crossed(levels: np.ndarray, valid: np.ndarray, contrast: float, scales: np.ndarray) -> np.ndarray:
    """Sum of the sharp changes that a ray has crossed before each sample, in units of the contrast."""
    samples, lag = np.arange(levels.shape[1]), _samples(_CHANGE_MM)
    apart = lag * scales
    changes = np.abs(levels - np.take_along_axis(levels, np.maximum(samples - apart, 0), axis=1))
    slow = max(_SHADING_CHANGE * lag * STEP_MM * contrast, _NOISE_CHANGE * noise_of(changes[valid]))
    return _before(np.cumsum(np.maximum(changes - slow, 0.0) / apart, axis=1) / contrast, scales)


def _largest_rise(levels: np.ndarray, contrast: float, scales: np.ndarray) -> np.ndarray:
    """Largest rise of the level between two places before each sample, in units of the contrast."""
    levels = _means(levels, (-_CHANGE_MM, _CHANGE_MM), np.ones_like(scales))
    rises = np.maximum.accumulate(levels - np.minimum.accumulate(levels, axis=1), axis=1) / contrast
    return _before(rises, scales)


def _before(sums: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Shift sums outward by half an edge, so that an edge does not count as crossed at its own sample."""
    samples = np.arange(sums.shape[1]) - _samples(_BEHIND_MM[1]) * scales
    return np.where(samples >= 0, np.take_along_axis(sums, np.maximum(samples, 0), axis=1), 0.0)


def _samples(distance: float) -> int:
    """Return the number of samples in a distance, mm, at least 1; negative for a negative distance."""
    return int(np.copysign(max(np.rint(abs(distance) / STEP_MM), 1.0), distance))


def _means(levels: np.ndarray, distances: tuple[float, float], scales: np.ndarray) -> np.ndarray:
    """Mean over the samples between two distances, mm, from every sample; a ray's scale, (n, 1), multiplies these."""
    first, last = map(_samples, distances)
    most = int(scales.max())
    left, right = max(-first, 0) * most, max(last, 0) * most
    sums = np.cumsum(np.pad(np.pad(levels, ((0, 0), (left, right)), mode="edge"), ((0, 0), (1, 0))), axis=1)
    start = np.arange(levels.shape[1]) + left + first * scales
    count = (last - first) * scales + 1
    return (np.take_along_axis(sums, start + count, axis=1) - np.take_along_axis(sums, start, axis=1)) / count


def _shape(star: Star, directions: np.ndarray) -> np.ndarray:
    """Radii of a star's smooth shape along directions (n, 3), mm."""
    return np.exp(smoothed(star.directions, np.log(star.radii), directions, degree=_DEGREE))


def _chosen(costs: np.ndarray, radii: np.ndarray, shape: np.ndarray | None) -> np.ndarray:
    """Sample of each ray on the surface of least cost; slopes are measured from a shape's, (n,) mm, if one is given.

    The surface is found on coarse radii in equal ratios. Each has the cost of the cheapest sample nearest to it.
    """
    count = int(np.log(_LONGEST_MM / _SHORTEST_MM) / np.log(_RATIO)) + 1
    coarse = _SHORTEST_MM * _RATIO ** np.arange(count)
    bins = np.searchsorted(coarse * np.sqrt(_RATIO), radii)
    cheapest, lowest = np.empty((2, len(costs), count))
    for number, radius in enumerate(coarse):
        samples = np.flatnonzero(bins == number)
        if not len(samples):
            samples = np.array([np.abs(radii - radius).argmin()])
        cheapest[:, number] = samples[costs[:, samples].argmin(axis=1)]
        lowest[:, number] = costs[:, samples].min(axis=1)
    slopes = np.log(_RATIO) / sphere().angles
    smoothness = _SMOOTHNESS if shape is None else _SHAPE_SMOOTHNESS
    places = None if shape is None else np.log(shape) / np.log(_RATIO)
    best = cheapest_radii(sphere(), lowest, slopes, smoothness=smoothness, most_apart=_MOST_APART, shape=places)
    return cheapest[np.arange(len(costs)), best].astype(int)
