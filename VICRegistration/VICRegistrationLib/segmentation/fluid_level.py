"""The level between two fluids in an organ of a lying patient: that of sediment, blood or contrast agent in urine.

A level is a sharp edge in the organ, at which both ways of separation end. It differs from a wall: it is flat and
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
from .ray_surface import RaySurface

# The boundary is flat where it is within this distance of a plane, mm. It is sampled by columns with this spacing, mm,
# of which so many at most choose the plane among planes with these slopes (up to 7.5 degrees, more than the largest
# tilt).
_WITHIN_MM, _COLUMN_MM, _MOST_COLUMNS = 1.0, 1.0, 2000
_SLOPES = np.tan(np.radians(np.arange(-7.5, 8.0, 1.5)))
# Rounds in which a plane is fitted again to the points near it.
_ROUNDS = 4
# Columns nearer than this to the rim of the flat part are left out, mm: they may show the wall beside the level.
_RIM_MM = 2.0
# Depths at which grey levels are sampled along each column, negative before the level and positive behind it, in mm or,
# if these are longer, voxels. Then the depths at which the levels before, behind and farther behind are measured; those
# in which a region may end beside the level; and those in which the level is located in each column.
_DEPTHS = np.arange(-8.0, 8.1, 0.5)
_BEFORE, _BEHIND, _FARTHER = (np.abs(_DEPTHS - middle) <= 1.0 for middle in (-3.0, 3.0, 5.0))
_BESIDE, _EDGE = np.abs(_DEPTHS) <= 5.0, np.abs(_DEPTHS) <= 2.0
# The grey levels are averaged over this width along the level. This removes noise, but not the unevenness of a wall.
_AVERAGED_MM = 5.0
# Conditions for a level: smallest area, cm2, largest tilt, degrees, largest departure from a plane, mm, and largest
# change of the grey level behind it, in units of the step at the level. The last one must hold under this share of the
# level: elsewhere the layer may be too shallow. Of 91 bladders with a layer painted in, as deep as 0.12 to 0.35 of the
# lumen, tilted by up to 5 degrees and blurred by up to 2 mm, 52 end at a level by these, and none of 112 without one;
# with half or twice of any one of the four, 37 to 54, and none. With half or twice of the flatness, the columns, the
# rim, the averaging or the share, 32 to 52, and none.
_AREA_CM2, _TILT, _UNEVEN_MM, _CHANGE, _DEEPEST = 4.0, 5.0, 0.2, 0.1, 0.25
# A region continues behind the level if it is at least this deep, mm, under this share of the level. A wall is thinner.
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
        Points of the level, without those near the wall, RAS mm.
    area_cm2 : float
        Area of the level, without its rim.
    depths, levels : ndarray, shape (m,)
        Median grey levels at distances from the plane, mm, positive in the layer.
    """

    plane: np.ndarray
    sign: float
    places: np.ndarray
    area_cm2: float
    depths: np.ndarray
    levels: np.ndarray

    @property
    def side(self) -> str:
        """Side of the patient at which the layer lies: "anterior" or "posterior"."""
        return patient_side(np.array([0.0, self.sign, 0.0]))

    def removed_from(self, image: Image) -> Image:
        """Remove the contrast at the level: add a constant to all voxels behind it, so that both fluids are as bright.

        Parameters
        ----------
        image : Image

        Returns
        -------
        Image
        """
        depths = self._depths_of(image)
        added = np.where(_EDGE, self.levels[_BEFORE].mean() - self.levels, 0.0)
        added[_DEPTHS > 2.0] = self.levels[_BEFORE].mean() - self.levels[_BEHIND].mean()
        array = image.array + np.where(depths > 0.0, added[-1], 0.0)
        near = np.abs(depths) < self.depths[_EDGE][-1]
        array[near] = image.array[near] + np.interp(depths[near], self.depths, added)
        return Image(array, image.ijk_to_ras)

    def joined(self, image: Image, region: Region, further: Region) -> Region:
        """Join the part of a region before the level with a further region behind it.

        Parameters
        ----------
        image : Image
            Both regions are on its grid.
        region : Region
            Used before the level.
        further : Region
            Used behind the level, and as far before it as the first region may end beside it.

        Returns
        -------
        Region
            The largest piece, with threshold and erosion of the first region.
        """
        before = replace(region, mask=region.mask & (self._depths_of(region.image) < 0.0))
        behind = replace(further, mask=further.mask & (self._depths_of(further.image) > self.depths[0]))
        mask = np.logical_or(*(part.in_box((0, 0, 0), image.array.shape) for part in (before, behind)))
        whole = region_from_mask(image, largest_piece(mask))
        return replace(whole, threshold=region.threshold, erosion=region.erosion)

    def layer_ml(self, region: Region) -> float:
        """Volume of the part of a region behind the level, ml."""
        behind = region.mask & (self._depths_of(region.image) > 0.0)
        return float(np.count_nonzero(behind)) * region.image.voxel_volume / 1000.0

    def is_passed_by(self, region: Region) -> bool:
        """Whether a region continues behind the level by more than the thickness of a wall."""
        deeper = self.places + np.array([0.0, self.sign * _DEEP_MM, 0.0])
        voxels = np.rint(region.image.to_ijk(deeper)[:, ::-1]).astype(int)
        within = voxels[np.all((voxels >= 0) & (voxels < region.mask.shape), axis=1)]
        return bool(region.mask[tuple(within.T)].sum() > _CONTINUED * len(voxels))

    def support_behind(self, image: Image, region: Region, surface: RaySurface) -> float:
        """Mean strength of the edge along a region's boundary behind the level, from 0 to 1, see `edge_strengths`."""
        places, strengths = edge_strengths(image, region, surface)
        behind = self.sign * _anterior_distance(places, self.plane) > _DEEP_MM
        return float(strengths[behind].mean()) if behind.any() else 0.0

    def _depths_of(self, image: Image) -> np.ndarray:
        """How far behind the level an image's voxels lie, in the anterior-posterior direction, mm."""
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
        None if there is no level at either side.
    """
    found = (_level_at(image, region, sign) for sign in (-1.0, 1.0))
    return next((level for level in found if level is not None), None)


def _level_at(image: Image, region: Region, sign: float) -> FluidLevel | None:
    """Find a level at the front of a region, or at its back if the sign is negative."""
    columns = _Columns.of(region, sign)
    plane = columns.plane()
    core = columns.core(plane)
    area = float(np.count_nonzero(core) * np.prod(columns.sizes)) / 100.0
    if area < _AREA_CM2:
        return None
    places, levels = columns.sampled(image, plane, core)
    if len(levels):
        # The region may end a little before or behind the level.
        plane = plane + np.array([0.0, 0.0, sign * columns.unit * _depth_of_change(levels)])
        places, levels = columns.sampled(image, plane, core)
    if not len(levels):
        # The region ends at the border of the volume.
        return None
    depths, crossed = _crossings(levels)
    if not crossed.any():
        return None
    crossings = places[crossed] + np.array([0.0, sign * columns.unit, 0.0]) * depths[crossed, None]
    plane, uneven = _robust_plane(crossings)
    places, levels = columns.sampled(image, plane, core)
    if uneven > _UNEVEN_MM or np.degrees(np.arctan(np.hypot(*plane[:2]))) > _TILT or not len(levels):
        return None
    before, behind, farther = (levels[:, part].mean(axis=1) for part in (_BEFORE, _BEHIND, _FARTHER))
    change = np.quantile(np.abs(farther - behind), _DEEPEST) / max(abs(np.median(behind - before)), 1e-9)
    if change > _CHANGE:
        return None
    return FluidLevel(plane, sign, places, area, columns.unit * _DEPTHS, np.median(levels, axis=0))


@dataclass(frozen=True, eq=False)
class _Columns:
    """Ends of a region along columns of voxels towards the front, or towards the back if `sign` is negative.

    `ends`, (p, q, 3), are the last points of the region along the columns, RAS mm; `crossed`, (p, q), is true where a
    column crosses the region. `sizes`, (2,), are the distances between columns, and `unit` is the unit of depths, mm.
    """

    ends: np.ndarray
    crossed: np.ndarray
    sizes: np.ndarray
    sign: float
    unit: float

    @classmethod
    def of(cls, region: Region, sign: float) -> _Columns:
        """Columns through a region along the axis of the grid that is nearest to the anterior-posterior direction."""
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
        """Plane near which most columns end."""
        middle = self.ends[self.crossed].mean(axis=0)
        ends = self.ends[self.crossed] - middle
        some = ends[:: -(-len(ends) // _MOST_COLUMNS)]
        planes = (_best_plane(some, slopes) for slopes in itertools.product(_SLOPES, repeat=2))
        _, plane = max(planes, key=lambda count_and_plane: count_and_plane[0])
        for _ in range(_ROUNDS):
            plane = _least_squares(ends[np.abs(_anterior_distance(ends, plane)) < _WITHIN_MM])
        return plane + np.array([0.0, 0.0, middle[1] - plane[:2] @ middle[::2]])

    def core(self, plane: np.ndarray) -> np.ndarray:
        """Largest connected part, without its rim, of the columns that end near a plane, (p, q) of bool."""
        largest = largest_piece(self.crossed & (np.abs(_anterior_distance(self.ends, plane)) < _WITHIN_MM))
        return ndimage.distance_transform_edt(np.pad(largest, 1), sampling=self.sizes)[1:-1, 1:-1] > _RIM_MM

    def sampled(self, image: Image, plane: np.ndarray, core: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 3) of a plane in the columns of a core, RAS mm, and averaged grey levels (n, m) at all depths.

        Columns that leave the volume are left out.
        """
        places = self.ends[core].copy()
        places[:, 1] -= _anterior_distance(places, plane)
        points = places[:, None] + self.sign * self.unit * _DEPTHS[:, None] * np.array([0.0, 1.0, 0.0])
        levels, valid = Sampler(image).values(points)
        inside = valid.all(axis=1)
        width = np.maximum(np.rint(_AVERAGED_MM / self.sizes).astype(int), 1)
        weights, sums = np.zeros(core.shape), np.zeros((*core.shape, len(_DEPTHS)))
        weights[core], sums[core] = inside, levels * inside[:, None]
        weights = ndimage.uniform_filter(weights, width, mode="constant")[core][inside]
        sums = ndimage.uniform_filter(sums, (*width, 1), mode="constant")[core][inside]
        return places[inside], sums / weights[:, None]


def _anterior_distance(points: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Distance of points (..., 3) from a plane in the anterior direction, mm."""
    return points[..., 1] - points[..., ::2] @ plane[:2] - plane[2]


def _best_plane(ends: np.ndarray, slopes: tuple[float, float]) -> tuple[int, np.ndarray]:
    """Plane with given slopes that has most of the ends (n, 3) near it: the number of these, and the plane."""
    over = np.sort(_anterior_distance(ends, np.array([*slopes, 0.0])))
    counts = np.searchsorted(over, over + 2.0 * _WITHIN_MM) - np.arange(len(over))
    first = int(counts.argmax())
    return int(counts[first]), np.array([*slopes, over[first] + _WITHIN_MM])


def _least_squares(points: np.ndarray) -> np.ndarray:
    """Plane of least squares through points (n, 3)."""
    return np.linalg.lstsq(np.column_stack([points[:, ::2], np.ones(len(points))]), points[:, 1], rcond=None)[0]


def _robust_plane(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Robust plane through points (n, 3), and their scaled median distance from it, mm."""
    plane = _least_squares(points)
    for _ in range(_ROUNDS):
        beside = np.abs(_anterior_distance(points, plane))
        plane = _least_squares(points[beside <= 4.0 * np.median(beside)])
    return plane, 1.4826 * float(np.median(np.abs(_anterior_distance(points, plane))))


def _depth_of_change(levels: np.ndarray) -> float:
    """Depth at which the median of levels (n, m) over the columns changes most."""
    change = np.abs(np.gradient(np.median(levels, axis=0))) * _BESIDE
    return float(_DEPTHS[change.argmax()])


def _crossings(levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depths (n,) at which levels (n, m) are half-way between those before and behind, and whether there is one."""
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
