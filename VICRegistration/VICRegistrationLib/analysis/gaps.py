"""Gaps and overlaps between organs: where two closed surfaces come closest, and their common volume."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import triangulate
from ..geometry.volume_fractions import Box

# Surfaces touch if their distance is at most this, mm.
TOUCH = 1e-3
# Samples in u and in v at which the search for extreme distances starts; every knot span gets at least four.
_SAMPLES = (64, 40)
# The search ends when its patch of the surface is as small as this, mm.
_RESOLUTION = 2e-4
_STARTS = 6
_PATCH = 4
_MAX_ROUNDS = 40
# The common volume is counted in a box with so many cells along each edge. The chord error of the triangles is a share
# of the box's thickness, but at least a share of the surface's size. The result is within 1 % of the formula for balls
# that overlap by 0.3 mm or more.
_CELLS = 96
_CHORD_ERROR, _LEAST_CHORD_ERROR = 1e-3, 5e-6
_MAX_SHRINKINGS = 12


@dataclass(frozen=True)
class Place:
    """A point of one surface and the closest point of the other.

    Parameters
    ----------
    distance : float
        Distance between them, mm, not negative.
    points : ((r, a, s), (r, a, s))
        On the first and on the second surface, RAS mm.
    parameters : ((u, v), (u, v))
        On the first and on the second surface.
    """

    distance: float
    points: tuple[tuple[float, float, float], tuple[float, float, float]]
    parameters: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Gap:
    """Gap or overlap of two organs.

    Parameters
    ----------
    first, second : str
        Names of the organs.
    relation : {"apart", "touching", "overlapping", "first inside second", "second inside first", "identical"}
        Organs that are apart, or touching within 0.001 mm, have no common volume; surfaces of overlapping organs cross.
    nearest : Place
        Where the surfaces are closest. If they cross, it is one of the crossing points, with the distance 0.
    deepest : Place, optional
        The point of either surface that is deepest inside the other organ; None without a common volume.
    common_volume : float
        mm^3, 0 if there is none. Exact if one organ is inside the other, within 1 % for an overlap of 0.3 mm or more.
    """

    first: str
    second: str
    relation: str
    nearest: Place
    deepest: Place | None = None
    common_volume: float = 0.0

    @property
    def distance(self) -> float:
        """Smallest distance if the organs have no common volume, else minus the largest penetration depth; mm."""
        return self.nearest.distance if self.deepest is None else -self.deepest.distance

    def __str__(self) -> str:
        """Return a sentence with the place."""
        place = self.nearest if self.deepest is None else self.deepest
        r, a, s = np.mean(place.points, axis=0)
        where = f"at R {r:.1f}, A {a:.1f}, S {s:.1f} mm"
        if self.deepest is None:
            return f"{self.first} and {self.second} are {place.distance:.2f} mm apart {where}"
        volume = self.common_volume
        amount = f"{volume / 1000.0:.1f} ml" if volume >= 1000.0 else f"{volume:.3g} mm³"
        relation = self.relation.replace("first", self.first).replace("second", self.second)
        common = f"{self.first} and {self.second} have {amount} in common ({relation})"
        return f"{common}, {place.distance:.2f} mm deep {where}"


def gaps(surfaces: Mapping[str, BSplineSurface]) -> tuple[Gap, ...]:
    """Measure gap or overlap of every pair of organs.

    Parameters
    ----------
    surfaces : mapping of str to BSplineSurface
        Closed surfaces with outward normals, RAS mm, by the organs' names.

    Returns
    -------
    tuple of Gap
        In the order of the pairs.

    Raises
    ------
    ValueError
        If a surface is open or inside out; the message names the organ.
    """
    for name, surface in surfaces.items():
        _check(name, surface)
    return tuple(
        gap(surfaces[first], surfaces[second], names=(first, second)) for first, second in combinations(surfaces, 2)
    )


def gap(first: BSplineSurface, second: BSplineSurface, *, names: tuple[str, str] = ("first", "second")) -> Gap:
    """Measure gap or overlap of two organs.

    Parameters
    ----------
    first, second : BSplineSurface
        Closed, with outward normals, RAS mm.
    names : (str, str)
        Names of the organs.

    Returns
    -------
    Gap

    Raises
    ------
    ValueError
        If a surface is open or inside out.

    Notes
    -----
    Distances are those of the exact surfaces: from samples of one surface to their closest points on the other, then
    around the best samples on smaller and smaller patches, down to 0.0002 mm. Details smaller than the spacing of the
    samples (1/64 of the circumference) may be missed.
    """
    for name, surface in zip(names, (first, second)):
        _check(name, surface)
    sides = _Side(first, second), _Side(second, first, turned=True)
    lowest = [sides[0].extreme(_as_is)]
    nearest = sides[0].place(lowest[0])
    # No point of the first surface is in the second organ, so all or none of the second surface is in the first.
    if lowest[0].distance > TOUCH and sides[1].distances.min() > 0.0:
        return Gap(*names, "apart", nearest)
    lowest.append(sides[1].extreme(_as_is))
    if min(found.distance for found in lowest) >= -TOUCH:
        if all(np.abs(side.distances).max() <= TOUCH for side in sides):
            return Gap(*names, "identical", nearest, nearest, first.volume())
        return Gap(*names, "touching" if nearest.distance <= TOUCH else "apart", nearest)
    deeper = int(lowest[1].distance < lowest[0].distance)
    deepest = sides[deeper].place(lowest[deeper])
    for side, relation in zip(sides, ("first inside second", "second inside first")):
        if side.is_inside():
            nearest = side.place(side.extreme(np.abs))
            return Gap(*names, relation, nearest, deepest, side.surface.volume())
    crossing = sides[0].place(sides[0].extreme(np.abs))
    boundary = np.concatenate([side.near() for side in sides])
    volume = _common_volume((first, second), boundary, max(side.spacing for side in sides), deepest)
    return Gap(*names, "overlapping", replace(crossing, distance=0.0), deepest, volume)


def _common_volume(
    surfaces: tuple[BSplineSurface, BSplineSurface], boundary: np.ndarray, margin: float, deepest: Place
) -> float:
    """Count the common volume of two solids, mm^3.

    Every point of its boundary is within the margin, mm, of one of the given points, (n, 3).
    """
    # Along the principal axes, so that the box of a thin overlap is thin.
    axes = np.linalg.svd(boundary - boundary.mean(axis=0), full_matrices=len(boundary) < 3)[2]
    box, middle = Box.around(boundary, axes, margin=margin), np.mean(deepest.points, axis=0)
    for _ in range(_MAX_SHRINKINGS):
        chords = (max(_CHORD_ERROR * box.lengths.min(), _LEAST_CHORD_ERROR * surface.size) for surface in surfaces)
        meshes = (triangulate(surface, chord_error=chord) for surface, chord in zip(surfaces, chords))
        both = np.logical_and(*(box.inside(mesh.points, mesh.triangles, _CELLS) for mesh in meshes))
        matrix = box.cells(_CELLS)
        found = np.argwhere(both)[:, ::-1] @ matrix[:3, :3].T + matrix[:3, 3]
        if len(found):
            smaller = Box.around(found, axes, margin=box.lengths / _CELLS)
            if smaller.volume > 0.7 * box.volume:
                return box.volume * len(found) / both.size
            box = smaller
        else:
            # Thinner than a cell: its middle is halfway between the deepest point and the closest point to that.
            box = Box(middle - box.edges.sum(axis=0) / 4.0, box.edges / 2.0)
    return 0.0


def _check(name: str, surface: BSplineSurface) -> None:
    if not surface.closed:
        msg = f"The surface of {name} is open; a gap or an overlap is one of closed surfaces (a seam and two poles)."
        raise ValueError(msg)
    if not surface.volume() > 0.0:
        msg = f"The surface of {name} is inside out or flat; reverse the order of the control net's rows."
        raise ValueError(msg)


def _as_is(distances: np.ndarray) -> np.ndarray:
    return distances


@dataclass(frozen=True)
class _Found:
    """Parameters of a point of a surface, and its signed distance from the other one, mm."""

    parameters: tuple[float, float]
    distance: float


class _Side:
    """One of two surfaces, with signed distances of its samples from the other one, mm, negative inside that."""

    def __init__(self, surface: BSplineSurface, other: BSplineSurface, *, turned: bool = False) -> None:
        self.surface, self.other, self.turned = surface, other, turned
        self.low, self.high = np.array(surface.domain).T
        axes = [surface.span_steps(axis, per_span=4, least=least) for axis, least in enumerate(_SAMPLES)]
        grid = surface.grid(*axes)
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).max() for axis in (0, 1)]
        self.spacing = float(np.hypot(*steps)) / 2.0
        self.points = grid.reshape(-1, 3)
        u, v = np.meshgrid(*axes, indexing="ij")
        self.parameters = np.column_stack([u.ravel(), v.ravel()])
        self.distances = closest_points(other, self.points).distances

    def near(self) -> np.ndarray:
        """Choose the samples (n, 3) that may bound the common volume."""
        return self.points[self.distances <= self.spacing]

    def is_inside(self) -> bool:
        """Whether no point of the surface lies outside of the other one."""
        return self.distances.max() <= TOUCH and self.extreme(np.negative).distance <= TOUCH

    def extreme(self, cost: Callable[[np.ndarray], np.ndarray]) -> _Found:
        """Find the point at which a cost of the signed distance is least."""
        costs = cost(self.distances)
        starts = self._starts(costs)
        parameters, distances = self.parameters[starts], self.distances[starts]
        reach = np.full(len(starts), self.spacing)
        for _ in range(_MAX_ROUNDS):
            parameters, distances, reach = self._round(parameters, distances, reach, cost)
            costs = cost(distances)
            best = np.argmin(costs)
            if reach[best] <= _RESOLUTION:
                break
            # Along a surface the distance changes by at most the length, so some patches cannot have the best point.
            keep = costs - reach <= costs[best]
            parameters, distances, reach = parameters[keep], distances[keep], reach[keep]
        best = np.argmin(cost(distances))
        u, v = map(float, parameters[best])
        return _Found((u, v), float(distances[best]))

    def _starts(self, costs: np.ndarray) -> np.ndarray:
        """Choose a few of the best samples, at a distance from each other."""
        order = np.argsort(costs, kind="stable")
        order = order[costs[order] <= costs[order[0]] + self.spacing]
        chosen: list[int] = []
        while len(order) and len(chosen) < _STARTS:
            chosen.append(order[0])
            order = order[np.linalg.norm(self.points[order] - self.points[order[0]], axis=1) > 2.0 * self.spacing]
        return np.array(chosen)

    def _round(self, parameters, distances, reach, cost):
        """Search patches around parameters (n, 2) of sizes (n,) mm; they shrink unless the best point is at an edge."""
        speeds = [
            np.linalg.norm(self.surface.points(*parameters.T, **order), axis=1) for order in ({"du": 1}, {"dv": 1})
        ]
        # At a pole, where u moves nothing, the patch covers all u.
        half = (self.high - self.low) / 2.0
        extent = np.minimum(reach[:, None] / np.maximum(np.column_stack(speeds), 1e-12 * self.surface.size), half)
        steps = np.linspace(-1.0, 1.0, 2 * _PATCH + 1)
        pattern = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        tried = self._inside_domain(parameters[:, None] + extent[:, None] * pattern).reshape(-1, 2)
        found = closest_points(self.other, self.surface.points(*tried.T)).distances.reshape(len(parameters), -1)
        best = np.argmin(cost(found), axis=1)
        rows = np.arange(len(parameters))
        better = cost(found[rows, best]) < cost(distances)
        at_edge = better & (np.abs(pattern[best]).max(axis=1) == 1.0)
        parameters = np.where(better[:, None], tried.reshape(len(rows), -1, 2)[rows, best], parameters)
        distances = np.where(better, found[rows, best], distances)
        return parameters, distances, np.where(at_edge, reach, reach / (_PATCH - 1.0))

    def _inside_domain(self, parameters: np.ndarray) -> np.ndarray:
        """Parameters wrapped at seams and clamped at other edges."""
        wraps = np.array([self.surface.closed_u, self.surface.closed_v])
        wrapped = self.low + np.mod(parameters - self.low, self.high - self.low)
        return np.clip(np.where(wraps, wrapped, parameters), self.low, self.high)

    def place(self, found: _Found) -> Place:
        """Return a found point with the closest one of the other surface, in the order of the pair."""
        own = np.array([found.parameters])
        point = self.surface.points(*own.T)
        foot = closest_points(self.other, point)
        points, parameters = np.concatenate([point, foot.points]), np.concatenate([own, foot.parameters])
        if self.turned:
            points, parameters = points[::-1], parameters[::-1]
        return Place(abs(found.distance), *(tuple(map(tuple, values.tolist())) for values in (points, parameters)))
