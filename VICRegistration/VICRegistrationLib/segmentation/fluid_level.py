"""The level between two fluids in an organ: in a patient who lies, that of sediment, blood or contrast agent in urine.

It is a sharp edge within the organ, where a search for edges ends. It differs from a wall: it is a plane, it is
horizontal, and the image is as even behind it as before it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..imaging.image import Image, patient_side
from ..imaging.morphology import largest_piece
from ..imaging.region import Region, region_from_mask
from ..imaging.sampling import Sampler
from .edge_support import edge_strengths
from .star_surface import Star

# The boundary is flat where it is within this distance of a plane; columns are looked at so far apart, mm, and so many
# at most choose the plane, by slopes of which the steepest are beyond the largest tilt.
_WITHIN_MM, _COLUMN_MM, _MOST_COLUMNS = 1.0, 1.0, 2000
_SLOPES = np.tan(np.radians(np.arange(-7.5, 8.0, 1.5)))
_ROUNDS = 4
# Nearer to the rim of the flat part, a wall beside the level is seen, mm.
_RIM_MM = 2.0
# Grey levels are looked at so far before and behind the level, in mm or, where these are longer, voxels. A region may
# end so far beside the level, and across half the width of an edge it is looked for in every column.
_DEPTHS = np.arange(-8.0, 8.1, 0.5)
_BEFORE, _BEHIND, _FARTHER = (np.abs(_DEPTHS - middle) <= 1.0 for middle in (-3.0, 3.0, 5.0))
_BESIDE, _EDGE = np.abs(_DEPTHS) <= 5.0, np.abs(_DEPTHS) <= 2.0
# They are averaged over this width along the level: noise goes, and a wall's unevenness stays.
_AVERAGED_MM = 5.0
# Smallest area, cm2, largest tilt, degrees, and departure from a plane, mm; and largest change of the grey level behind
# it, in units of the step, under this share of the level: elsewhere the layer is not as deep. Of 91 bladders with a
# layer painted in, as deep as 0.12 to 0.35 of the lumen, tilted by up to 5 degrees and blurred by up to 2 mm, 52 end at
# a level by these, and none of 112 without one; with half or twice of any one of the four, 37 to 54, and none. With
# half or twice of the flatness, the columns, the rim, the averaging or the share, 32 to 52, and none.
_AREA_CM2, _TILT, _UNEVEN_MM, _CHANGE, _DEEPEST = 4.0, 5.0, 0.2, 0.1, 0.25
# A layer is as deep as this, mm, under this share of the level: a wall is thinner.
_DEEP_MM, _CONTINUED = 4.0, 0.5


@dataclass(frozen=True, eq=False)
class FluidLevel:
    """A horizontal plane in an organ at which the grey level changes.

    Attributes
    ----------
    plane : ndarray, shape (3,)
        The plane is A = plane[0] R + plane[1] S + plane[2], RAS mm.
    sign : float
        1 if the layer lies anterior of the level, -1 if posterior.
    places : ndarray, shape (n, 3)
        Places of the level that are farther from the wall than its rim, RAS mm.
    area_cm2 : float
        Area of these.
    heights, levels : ndarray, shape (m,)
        Typical grey levels at distances from the level, mm, positive in the layer.
    """

    plane: np.ndarray
    sign: float
    places: np.ndarray
    area_cm2: float
    heights: np.ndarray
    levels: np.ndarray

    @property
    def side(self) -> str:
        """Side of the patient at which the layer lies."""
        return patient_side(np.array([0.0, self.sign, 0.0]))

    def removed_from(self, image: Image) -> Image:
        """Make the layer as bright as what it borders on: a constant is added to all that lies behind the level.

        Parameters
        ----------
        image : Image

        Returns
        -------
        Image
        """
        heights = self._heights_of(image)
        added = np.where(_EDGE, self.levels[_BEFORE].mean() - self.levels, 0.0)
        added[_DEPTHS > 2.0] = self.levels[_BEFORE].mean() - self.levels[_BEHIND].mean()
        array = image.array + np.where(heights > 0.0, added[-1], 0.0)
        near = np.abs(heights) < self.heights[_EDGE][-1]
        array[near] = image.array[near] + np.interp(heights[near], self.heights, added)
        return Image(array, image.ijk_to_ras)

    def joined(self, image: Image, region: Region, further: Region) -> Region:
        """Join a region before the level with another one behind it, and with what that has beside the level.

        Parameters
        ----------
        image : Image
            On whose grid both lie.
        region, further : Region

        Returns
        -------
        Region
            With threshold and erosion of the first one.
        """
        mask = np.zeros(image.array.shape, dtype=bool)
        for part in (region, further):
            heights = self._heights_of(part.image)
            used = heights < 0.0 if part is region else heights > self.heights[0]
            mask[tuple(slice(first, first + size) for first, size in zip(part.offset, part.mask.shape))] |= (
                part.mask & used
            )
        whole = region_from_mask(image, largest_piece(mask))
        return replace(whole, threshold=region.threshold, erosion=region.erosion)

    def layer_ml(self, region: Region) -> float:
        """Volume of the part of a region behind the level, ml."""
        behind = region.mask & (self._heights_of(region.image) > 0.0)
        return float(np.count_nonzero(behind)) * region.image.voxel_volume / 1000.0

    def is_passed_by(self, region: Region) -> bool:
        """Whether a region goes on behind the level, by more than a wall is thick."""
        deeper = self.places + np.array([0.0, self.sign * _DEEP_MM, 0.0])
        voxels = np.rint(region.image.to_ijk(deeper)[:, ::-1]).astype(int)
        within = voxels[np.all((voxels >= 0) & (voxels < region.mask.shape), axis=1)]
        return bool(region.mask[tuple(within.T)].sum() > _CONTINUED * len(voxels))

    def support_behind(self, image: Image, region: Region, star: Star) -> float:
        """Mean strength of the edge along a region's boundary behind the level, from 0 to 1, see `edge_strengths`."""
        places, strengths = edge_strengths(image, region, star)
        behind = self.sign * _over(places, self.plane) > _DEEP_MM
        return float(strengths[behind].mean()) if behind.any() else 0.0

    def _heights_of(self, image: Image) -> np.ndarray:
        """Heights of an image's voxels, mm."""
        k, j, i = np.ogrid[tuple(map(slice, image.array.shape))]
        weights = self.sign * np.array([-self.plane[0], 1.0, -self.plane[1]]) @ image.ijk_to_ras[:3]
        return weights[0] * i + weights[1] * j + weights[2] * k + (weights[3] - self.sign * self.plane[2])


def find_fluid_level(image: Image, region: Region) -> FluidLevel | None:
    """Find a level at the back or at the front of a region.

    Parameters
    ----------
    image : Image
    region : Region
        It ends at the level, or a few millimetres beside it.

    Returns
    -------
    FluidLevel or None
        None where the boundary is no such level.
    """
    found = (_level_at(image, region, sign) for sign in (-1.0, 1.0))
    return next((level for level in found if level is not None), None)


def _level_at(image: Image, region: Region, sign: float) -> FluidLevel | None:
    """Find a level at one side."""
    columns = _Columns.of(region, sign)
    plane = columns.plane()
    core = columns.core(plane)
    area = float(np.count_nonzero(core) * np.prod(columns.sizes)) / 100.0
    if area < _AREA_CM2:
        return None
    places, levels = columns.look(image, plane, core)
    if len(levels):
        plane = plane + np.array([0.0, 0.0, sign * columns.unit * _steepest(levels)])
        places, levels = columns.look(image, plane, core)
    if not len(levels):
        # The volume ends there.
        return None
    heights, crossed = _crossings(levels)
    if not crossed.any():
        return None
    crossings = places[crossed] + np.array([0.0, sign * columns.unit, 0.0]) * heights[crossed, None]
    plane, uneven = _through(crossings)
    places, levels = columns.look(image, plane, core)
    if uneven > _UNEVEN_MM or np.degrees(np.arctan(np.hypot(*plane[:2]))) > _TILT or not len(levels):
        return None
    before, behind, farther = (levels[:, part].mean(axis=1) for part in (_BEFORE, _BEHIND, _FARTHER))
    change = np.quantile(np.abs(farther - behind), _DEEPEST) / max(abs(np.median(behind - before)), 1e-9)
    if change > _CHANGE:
        return None
    return FluidLevel(plane, sign, places, area, columns.unit * _DEPTHS, np.median(levels, axis=0))


@dataclass(frozen=True, eq=False)
class _Columns:
    """Where a region ends along columns of voxels towards one side.

    `ends`, (p, q, 3), are RAS mm; `met`, (p, q), is true where a column meets the region. `sizes`, (2,), are the
    distances between columns, and `unit` that in which depths are given, mm.
    """

    ends: np.ndarray
    met: np.ndarray
    sizes: np.ndarray
    sign: float
    unit: float

    @classmethod
    def of(cls, region: Region, sign: float) -> _Columns:
        """Columns of a region towards the front, or the back where `sign` is negative."""
        along = region.ijk_to_ras[1, :3] / region.spacing
        axis = int(np.argmax(np.abs(along)))
        spacing = np.delete(region.spacing[::-1], 2 - axis)
        strides = np.maximum(np.rint(_COLUMN_MM / spacing).astype(int), 1)
        mask = np.moveaxis(region.mask, 2 - axis, 0)[:, :: strides[0], :: strides[1]]
        if along[axis] * sign > 0.0:
            last = len(mask) - 0.5 - np.argmax(mask[::-1], axis=0)
        else:
            last = np.argmax(mask, axis=0) - 0.5
        rows, lines = np.indices(last.shape) * strides[:, None, None]
        kji = np.insert(np.stack([rows, lines], axis=-1).astype(float), 2 - axis, last, axis=-1)
        ends = region.image.to_ras(kji[..., ::-1].reshape(-1, 3)).reshape(kji.shape)
        return cls(ends, mask.any(axis=0), strides * spacing, sign, max(1.0, float(region.spacing[axis])))

    def plane(self) -> np.ndarray:
        """Plane at which most columns end."""
        middle = self.ends[self.met].mean(axis=0)
        ends = self.ends[self.met] - middle
        few = ends[:: -(-len(ends) // _MOST_COLUMNS)]
        _, plane = max((_most(few, slopes) for slopes in itertools.product(_SLOPES, repeat=2)), key=lambda one: one[0])
        for _ in range(_ROUNDS):
            plane = _least_squares(ends[np.abs(_over(ends, plane)) < _WITHIN_MM])
        return plane + np.array([0.0, 0.0, middle[1] - plane[:2] @ middle[::2]])

    def core(self, plane: np.ndarray) -> np.ndarray:
        """Columns (p, q) of the largest part that ends at a plane, without its rim."""
        largest = largest_piece(self.met & (np.abs(_over(self.ends, plane)) < _WITHIN_MM))
        return ndimage.distance_transform_edt(np.pad(largest, 1), sampling=self.sizes)[1:-1, 1:-1] > _RIM_MM

    def look(self, image: Image, plane: np.ndarray, core: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 3) of a plane, and the grey levels (n, m) around them, averaged; those in the volume alone."""
        places = self.ends[core].copy()
        places[:, 1] -= _over(places, plane)
        points = places[:, None] + self.sign * self.unit * _DEPTHS[:, None] * np.array([0.0, 1.0, 0.0])
        levels, valid = Sampler(image).values(points)
        seen = valid.all(axis=1)
        width = np.maximum(np.rint(_AVERAGED_MM / self.sizes).astype(int), 1)
        weights, sums = np.zeros(core.shape), np.zeros((*core.shape, len(_DEPTHS)))
        weights[core], sums[core] = seen, levels * seen[:, None]
        weights = ndimage.uniform_filter(weights, width, mode="constant")[core][seen]
        sums = ndimage.uniform_filter(sums, (*width, 1), mode="constant")[core][seen]
        return places[seen], sums / weights[:, None]


def _over(points: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """How far points (..., 3) lie anterior of a plane, mm."""
    return points[..., 1] - points[..., ::2] @ plane[:2] - plane[2]


def _most(ends: np.ndarray, slopes: tuple[float, float]) -> tuple[int, np.ndarray]:
    """How many of the ends (n, 3) are near the best plane of some slopes, and that plane."""
    over = np.sort(_over(ends, np.array([*slopes, 0.0])))
    counts = np.searchsorted(over, over + 2.0 * _WITHIN_MM) - np.arange(len(over))
    first = int(counts.argmax())
    return int(counts[first]), np.array([*slopes, over[first] + _WITHIN_MM])


def _least_squares(points: np.ndarray) -> np.ndarray:
    """Plane through points (n, 3)."""
    return np.linalg.lstsq(np.column_stack([points[:, ::2], np.ones(len(points))]), points[:, 1], rcond=None)[0]


def _through(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Plane through most of the points (n, 3), and how far they typically lie beside it, mm."""
    plane = _least_squares(points)
    for _ in range(_ROUNDS):
        beside = np.abs(_over(points, plane))
        plane = _least_squares(points[beside <= 4.0 * np.median(beside)])
    return plane, 1.4826 * float(np.median(np.abs(_over(points, plane))))


def _steepest(levels: np.ndarray) -> float:
    """At which depth the typical one of levels (n, m) changes most."""
    typical = np.median(levels, axis=0)
    change = np.abs(np.gradient(typical)) * _BESIDE
    return float(_DEPTHS[change.argmax()])


def _crossings(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depths (n,) at which levels (n, m) are half-way between those before and behind, and where there is one."""
    if not len(levels):
        return np.zeros(0), np.zeros(0, dtype=bool)
    before, behind = levels[:, _BEFORE].mean(axis=1), levels[:, _BEHIND].mean(axis=1)
    sign = np.sign(np.median(before - behind))
    excess = sign * (levels - (before + behind)[:, None] / 2.0)[:, _EDGE]
    passes = (excess[:, :-1] > 0.0) & (excess[:, 1:] <= 0.0)
    rows, first = np.arange(len(levels)), passes.argmax(axis=1)
    start, end = excess[rows, first], excess[rows, first + 1]
    share = start / np.where(passes[rows, first], start - end, 1.0)
    return _DEPTHS[_EDGE][first] + share * np.diff(_DEPTHS)[0], passes.any(axis=1)
