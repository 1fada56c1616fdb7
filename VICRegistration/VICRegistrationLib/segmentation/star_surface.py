"""An organ's shape from one place in it: the star-shaped surface on which the image shows most of an edge.

It needs no limits of grey levels, and looks again from its own middle, so that it matters little where the place is.
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

# Samples along a ray are so far apart, up to the longest.
_STEP_MM, _LONGEST_MM = 0.75, 100.0
# Rays are followed within this distance of the place given: the middle of a long organ is far from a place at its end.
_REACH_MM = 1.5 * _LONGEST_MM
# Radii to choose from begin here, and each is longer than the one before by this ratio.
_SHORTEST_MM, _RATIO, _MOST_APART = 2.0, 1.05, 9
# Single voxels of noise are averaged over this length.
_BLUR_MM = 0.5
# An edge is the step between the means over samples before and behind. What the level falls farther before and behind
# it is shading: half of that is no edge.
_BEFORE, _BEHIND, _EARLIER, _LATER = (-3, -1), (1, 2), (-8, -5), (5, 8)
_SHADING = 0.5
# In thick slices an edge is blurred: there the samples above are as many times as far apart as a voxel is longer along
# the ray than so many of them. In seven bladders resampled to slices of 2.5 to 4 mm, axial and sagittal, the mean Dice
# coefficient of the region is 0.910 without, 0.954 so, 0.935 with half and 0.919 with twice of it.
_VOXEL_SAMPLES = 1.5
# A step of this share of the contrast counts three quarters of a full edge.
STEP_SHARE = 0.4
# Steps of less than this share are no edge. Where they count, those of noise may make a small surface around the place.
_SLIGHT = 0.06
# Change of the grey level from sample to sample that is shading, in shares of the contrast, or noise.
_SLOW, _NOISE = 0.06, 1.0
# Weights of the sharp changes that were crossed before, of how far the level has risen on the way, as from a dark wall
# to the fat behind it, of slopes of 45 degrees, and of the volume's end, where a full edge weighs 1. The end may weigh
# 0.1 to 0.5 in a bladder that is cut twice (IM0228), and anything up to 0.7 in the others. In seven bladders slopes may
# weigh 0.055 to 0.22; with less than 0.12 a rectum in thick slices goes on through the anal canal.
_CROSSED, _RISEN, _STIFFNESS, _END = 0.35, 0.35, 0.13, 0.25
# Cost of missing a place where the wall is known to be, by more than the surface may rise between two rays; and of a
# radius that is not to be chosen.
_MISSED, _BESIDE = 50.0, 1.0
# The first look is from the place given, the others from the middle of what was seen, until that moves by less than
# this, mm, and so many at most. In real bladders it is still 2 to 14 mm away after three looks from a place near the
# wall.
_SETTLED_MM, _LOOKS = 1.0, 10
# From a dark spot or near the wall, a small surface may cost less than the organ's, as that is seen from there. Where
# no ray is as long as this, the looks are done once more without shorter radii, and the surface that costs less in the
# end is taken. In six bladders where the click decides, 11 to 15 mm find all; with 8 mm one is lost, with 20 mm two.
_SMALL_MM = 15.0
# A place this little outside of the surface is held.
_HELD_MM = 2.0
# The last two looks count slopes from those of a smooth shape: the logarithm of the lengths that were found, as
# spherical harmonics up to this degree. Slopes weigh more then. In 8 hard bladders the mean Dice coefficient of the
# region is 0.960, and 0.956 without; degrees of 2 and 6, and weights of 0.1 and 0.4, change single ones by up to 0.01.
_DEGREE, _STIFFER = 4, 0.2
# The last one follows more directions, near the surface that was found: so many samples to either side.
_FINE, _NEAR = 5, 10
# Behind the edge, the outside level is the one farthest from the inside within so many samples, as in a thin wall.
_DEPTH = 5
# What strengths of an edge mean: one is there.
AN_EDGE = 0.46


@dataclass(frozen=True, eq=False)
class Star:
    """A closed surface that is seen from one place, one entry per direction.

    Attributes
    ----------
    center : ndarray, shape (3,)
        RAS mm.
    directions : ndarray, shape (n, 3)
        Unit vectors, RAS.
    lengths : ndarray, shape (n,)
        From the centre to the surface, mm.
    strengths : ndarray, shape (n,)
        How much of an edge the image shows there, from 0 to 1.
    ends : ndarray, shape (n,)
        From the centre to where the volume ends, mm.
    inner, outer : ndarray, shape (n,)
        Grey levels before and behind the surface.
    contrast : float
        Unit of the steps.
    falls : bool
        Whether the level falls at the edge.
    cost : float
        Mean over the directions.
    """

    center: np.ndarray
    directions: np.ndarray
    lengths: np.ndarray
    strengths: np.ndarray
    ends: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    contrast: float
    falls: bool
    cost: float

    @property
    def points(self) -> np.ndarray:
        """Where the rays end, (n, 3) RAS mm."""
        return self.center + self.lengths[:, None] * self.directions

    @property
    def cut(self) -> np.ndarray:
        """Where the volume ends before an edge, (n,) of bool."""
        return self.lengths > self.ends

    @cached_property
    def middle(self) -> np.ndarray:
        """Centre of mass of what lies in the volume, (3,) RAS mm: a cone's is three quarters of the way to its base."""
        lengths = np.minimum(self.lengths, self.ends)
        return self.center + 0.75 * (lengths**4 @ self.directions) / (lengths**3).sum()

    @property
    def found(self) -> np.ndarray:
        """Where there is an edge, (n,) of bool."""
        return (self.strengths > AN_EDGE) & ~self.cut


def find_star(image: Image, seeds: np.ndarray, wall: np.ndarray | None = None) -> Star:
    """Find the star-shaped surface of least cost around a place.

    Parameters
    ----------
    image : Image
    seeds : (3,) or (n, 3) ndarray
        RAS mm, in the volume: the place, or several in the organ about their mean. A surface that holds them all is not
        left for one that does not.
    wall : (n, 3) ndarray, optional
        Places that the surface has to pass, RAS mm.

    Returns
    -------
    Star

    Notes
    -----
    Along each ray, a step of the grey level lowers the cost where it is sharp, and what the ray has crossed before
    raises it: sharp changes, and any rise (of an organ brighter than its wall; a fall of another). Whether the level
    falls or rises at an organ's edge is what costs less. Two last looks, the second at more directions, compare the
    surface with its own smooth shape: where no edge is seen, it goes on as that does.
    """
    seeds = np.atleast_2d(seeds)
    seed = seeds.mean(axis=0)
    level = float(image.array[tuple(np.rint(image.to_ijk(seed[None])[0, ::-1]).astype(int))])
    search = _Search(image, seeds, np.empty((0, 3)) if wall is None else wall)
    found = []
    for falls in (True, False):
        found.append(search.settled(seed, falls=falls))
        if found[-1].lengths.max() < _SMALL_MM:
            found.append(search.settled(seed, falls=falls, least=_SMALL_MM))
    star = search.closely(search.stiffer(min(found, key=lambda star: star.cost)))
    return replace(star, inner=star.inner + level, outer=star.outer + level)


def blurred(image: Image) -> np.ndarray:
    """Average fine voxels over about a millimetre."""
    return ndimage.uniform_filter(image.array, size=tuple(2 * np.rint(_BLUR_MM / image.spacing[::-1]).astype(int) + 1))


def _around(image: Image, seed: np.ndarray) -> Image:
    """Cut out what is within reach of a place, in grey levels from that at the place, averaged."""
    voxel = np.rint(image.to_ijk(seed[None])[0, ::-1]).astype(int)
    reach = np.ceil(_REACH_MM / image.spacing[::-1]).astype(int)
    crop = image.crop(np.maximum(voxel - reach, 0), np.minimum(voxel + reach + 1, image.array.shape))
    # Before the numbers are made short: a constant that is added to the image then changes nothing.
    levels = (crop.array.astype(float) - float(image.array[tuple(voxel)])).astype(np.float32)
    return Image(blurred(Image(levels, crop.ijk_to_ras)), crop.ijk_to_ras)


class _Search:
    """Looks for a surface around places (m, 3) in an image, through places of the wall (n, 3) that are known."""

    def __init__(self, image: Image, seeds: np.ndarray, wall: np.ndarray):
        self.image, self.seeds, self.wall = image, seeds, wall
        self.sampler = Sampler(_around(image, seeds.mean(axis=0)))
        self.axes = image.ijk_to_ras[:3, :3] / image.spacing

    def look(self, center: np.ndarray, *, falls: bool, least: float = 0.0, shape: np.ndarray | None = None) -> Star:
        """Look once, from a place, at radii from the least one on, mm; slopes count from those of a shape, (n,) mm."""
        radii = np.arange(_STEP_MM / 2.0, _LONGEST_MM, _STEP_MM)
        directions = sphere().directions @ self.axes.T
        rays = self.rays(center, directions, np.tile(radii, (len(directions), 1)))
        costs, strengths = rays.costs(falls, self.wall)
        places = _chosen(costs + _MISSED * (radii < least), radii, shape)
        return rays.star(falls, places, costs, strengths)

    def rays(self, center: np.ndarray, directions: np.ndarray, radii: np.ndarray) -> _Rays:
        """Look along rays."""
        levels, valid = self.sampler.values(center + directions[:, None] * radii[..., None])
        valid = np.logical_and.accumulate(valid, axis=1)
        voxels = np.linalg.norm(directions @ np.linalg.inv(self.axes).T * self.image.spacing, axis=1)
        widths = np.maximum(np.rint(voxels / (_VOXEL_SAMPLES * _STEP_MM)), 1.0).astype(int)
        return _Rays(center, directions, radii, continued(levels.astype(float), valid), valid, widths[:, None])

    def settled(self, seed: np.ndarray, *, falls: bool, least: float = 0.0) -> Star:
        """Look from a place, and again from the middle of what was seen until it moves no more."""
        star = self.look(seed, falls=falls, least=least)
        image = self.image
        for _ in range(_LOOKS - 1):
            center = image.to_ras(np.clip(image.to_ijk(star.middle[None]), 0.0, image.size - 1.0))[0]
            if np.linalg.norm(center - star.center) < _SETTLED_MM:
                break
            further = self.look(center, falls=star.falls, least=least)
            if len(self.seeds) > 1 and self.holds(star) and not self.holds(further):
                break
            star = further
        return star

    def holds(self, star: Star) -> bool:
        """Whether a surface holds all places, or nearly."""
        away = self.seeds - star.center
        distances = np.linalg.norm(away, axis=1)
        lengths = between(star.directions, star.lengths, away / np.maximum(distances, 1e-9)[:, None])
        return bool((distances <= lengths + _HELD_MM).all())

    def stiffer(self, star: Star) -> Star:
        """Look once more from the same place, with slopes counted from those of the smooth shape of what was seen."""
        return self.look(star.center, falls=star.falls, shape=_shape(star, star.directions))

    def closely(self, star: Star) -> Star:
        """Look at more directions, near a surface that was found."""
        ball = sphere(_FINE)
        directions = ball.directions @ self.axes.T
        # Before they are turned: many are as near as others, and the last digit of the turn would choose among them.
        lengths = between(sphere().directions, star.lengths, ball.directions)
        inner = int(np.ceil(lengths.max() / _STEP_MM))
        steps = _STEP_MM * np.arange(-inner, _NEAR + _LATER[1] + 1)
        rays = self.rays(star.center, directions, np.maximum(lengths[:, None] + steps, _STEP_MM / 2.0))
        costs, strengths = rays.costs(star.falls, self.wall)
        near = slice(max(inner - _NEAR, 0), inner + _NEAR + 1)
        slopes = 2.0 * _STEP_MM / ((lengths[ball.first] + lengths[ball.second]) * ball.angles)
        shape = (_shape(star, directions) - lengths) / _STEP_MM
        best = cheapest_radii(ball, costs[:, near], slopes, stiffness=_STIFFER, most=_MOST_APART, shape=shape)
        places = near.start + best
        return rays.star(star.falls, places, costs, strengths)


@dataclass(frozen=True, eq=False)
class _Rays:
    """Grey levels along rays from a place: radii, levels and where they are in the volume, each (n, m).

    `widths`, (n, 1), are samples from one that counts to the next.
    """

    center: np.ndarray
    directions: np.ndarray
    radii: np.ndarray
    levels: np.ndarray
    valid: np.ndarray
    widths: np.ndarray

    @cached_property
    def contrast(self) -> float:
        """Unit of the steps."""
        return contrast_of(self.levels, self.valid, self.radii)

    def costs(self, falls: bool, wall: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cost of every sample, and how much of an edge there is, where the level falls or rises."""
        levels = self.levels if falls else -self.levels
        crossed = _CROSSED * _crossed(self.levels, self.valid, self.contrast, self.widths)
        crossed += _RISEN * _risen(levels, self.contrast, self.widths)
        strengths = _strengths(levels, self.contrast, self.widths)
        last = np.maximum(self.valid.sum(axis=1) - 1, 0)[:, None]
        ends = np.take_along_axis(crossed, last, axis=1) - _END
        return np.where(self.valid, crossed - strengths, ends) + self._missed(wall), strengths

    def _missed(self, wall: np.ndarray) -> np.ndarray:
        """Cost of missing known places of the wall: that of every sample of the rays next to them, (n, m)."""
        away = wall - self.center
        distances = np.linalg.norm(away, axis=1)
        alike = self.directions @ (away / distances[:, None]).T
        cost, rays = np.zeros_like(self.levels), alike.argmax(axis=0)
        for ray in np.unique(rays):
            of_ray = rays == ray
            aside = distances[of_ray] * np.sqrt(np.maximum(1.0 - alike[ray, of_ray] ** 2, 0.0))
            missed = np.abs(self.radii[ray, :, None] - distances[of_ray]) > _STEP_MM + _BESIDE * aside
            cost[ray] = _MISSED * missed.all(axis=1)
        return cost

    def star(self, falls: bool, places: np.ndarray, costs: np.ndarray, strengths: np.ndarray) -> Star:
        """Make a star of the sample that was chosen on each ray."""
        rays, levels, sign = np.arange(len(places)), self.levels, 1.0 if falls else -1.0
        depths = np.minimum(places[:, None] + self.widths * np.arange(_DEPTH), levels.shape[1] - 1)
        return Star(
            center=self.center,
            directions=self.directions,
            lengths=self.radii[rays, places],
            strengths=strengths[rays, places],
            ends=self.radii[rays, np.maximum(self.valid.sum(axis=1) - 1, 0)],
            inner=_means(levels, *_BEFORE, self.widths)[rays, places],
            outer=sign * (sign * np.take_along_axis(levels, depths, 1)).min(axis=1),
            contrast=self.contrast,
            falls=falls,
            cost=float(costs[rays, places].mean()),
        )


def _strengths(levels: np.ndarray, contrast: float, widths: np.ndarray) -> np.ndarray:
    """How much of an edge there is at every sample where levels fall, from 0 to 1."""
    earlier, before, behind, later = (_means(levels, *part, widths) for part in (_EARLIER, _BEFORE, _BEHIND, _LATER))
    shading = np.maximum(earlier - before, 0.0) + np.maximum(behind - later, 0.0)
    steps = (before - behind - _SHADING * shading) / contrast
    return np.tanh(np.maximum(steps - _SLIGHT, 0.0) / STEP_SHARE)


def _crossed(levels: np.ndarray, valid: np.ndarray, contrast: float, widths: np.ndarray) -> np.ndarray:
    """Sharp changes of the level that a ray has crossed before each sample, in units of the contrast."""
    places = np.arange(levels.shape[1])
    changes = np.abs(levels - np.take_along_axis(levels, np.maximum(places - widths, 0), axis=1))
    slow = max(_SLOW * contrast, _NOISE * noise_of(changes[valid]))
    return _before(np.cumsum(np.maximum(changes - slow, 0.0) / widths, axis=1) / contrast, widths)


def _risen(levels: np.ndarray, contrast: float, widths: np.ndarray) -> np.ndarray:
    """How far levels have risen at most on the way to each sample, in units of the contrast."""
    levels = _means(levels, -1, 1, np.ones_like(widths))
    risen = np.maximum.accumulate(levels - np.minimum.accumulate(levels, axis=1), axis=1) / contrast
    return _before(risen, widths)


def _before(sums: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Shift sums to where an edge at every sample begins; 0 at the first ones."""
    places = np.arange(sums.shape[1]) - _BEHIND[1] * widths
    return np.where(places >= 0, np.take_along_axis(sums, np.maximum(places, 0), axis=1), 0.0)


def _means(levels: np.ndarray, first: int, last: int, widths: np.ndarray) -> np.ndarray:
    """Means over the samples from the first to the last one, counted from every sample in widths (n, 1)."""
    most = int(widths.max())
    left, right = max(-first, 0) * most, max(last, 0) * most
    sums = np.cumsum(np.pad(np.pad(levels, ((0, 0), (left, right)), mode="edge"), ((0, 0), (1, 0))), axis=1)
    start = np.arange(levels.shape[1]) + left + first * widths
    count = (last - first) * widths + 1
    return (np.take_along_axis(sums, start + count, axis=1) - np.take_along_axis(sums, start, axis=1)) / count


def _shape(star: Star, directions: np.ndarray) -> np.ndarray:
    """Lengths of a star's smooth shape along directions (n, 3), mm."""
    return np.exp(smoothed(star.directions, np.log(star.lengths), directions, degree=_DEGREE))


def _chosen(costs: np.ndarray, radii: np.ndarray, shape: np.ndarray | None) -> np.ndarray:
    """Sample of each ray on the surface of least cost. Slopes count from those of a shape, (n,) mm, if one is given."""
    count = int(np.log(_LONGEST_MM / _SHORTEST_MM) / np.log(_RATIO)) + 1
    coarse = _SHORTEST_MM * _RATIO ** np.arange(count)
    bins = np.searchsorted(coarse * np.sqrt(_RATIO), radii)
    places, lowest = np.empty((2, len(costs), count))
    for number, radius in enumerate(coarse):
        samples = np.flatnonzero(bins == number)
        if not len(samples):
            samples = np.array([np.abs(radii - radius).argmin()])
        places[:, number] = samples[costs[:, samples].argmin(axis=1)]
        lowest[:, number] = costs[:, samples].min(axis=1)
    slopes = np.log(_RATIO) / sphere().angles
    stiffness = _STIFFNESS if shape is None else _STIFFER
    samples = None if shape is None else np.log(shape) / np.log(_RATIO)
    best = cheapest_radii(sphere(), lowest, slopes, stiffness=stiffness, most=_MOST_APART, shape=samples)
    return places[np.arange(len(costs)), best].astype(int)
