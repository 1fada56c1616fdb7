"""Surface of a long or bent organ: one radius along each ray from its axis, chosen by optimal surface detection.

A star-shaped surface contains only what straight lines from its centre reach. In a long or bent organ that is a part.
The search begins along the axis of this part and is repeated along the axis of what was found, which grows until it
reaches both ends of the organ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.centreline import Centreline, centreline, interpolated
from ..imaging.image import Image
from .ray_graph import RayGraph, gabriel_graph
from .ray_search import RaySearch
from .ray_surface import RaySurface

# Lengths in half widths of the organ: distance between neighbouring rays, in the searches and in the last one;
_COARSE, _FINE = 0.25, 0.2
# from the ends of the organ to those of the axis;
_FROM_END = 0.5
# and spacing of the lattice from which the axis is computed, and of the points of the axis. Clicks near the ends of 10
# tubes that are bent by 60 or 180 degrees, with gaps in the wall and shading, find all of the tube with 0.15 to 0.5
# and 0.1 to 0.4 between rays, 0.25 to 1 at the ends, 0.1 and 0.2 for the lattice, and 0.05 to 0.2 for the points. With
# 0.6 between rays or 1.5 at the ends some axes stop growing.
_LATTICE, _STEP = 0.2, 0.1
# The lattice has at most so many steps along each of its axes: an organ that is longer than about 50 half widths has no
# axis here. Rays along it would take a minute.
_MOST_STEPS = 50
# The search is repeated until the axis has not grown by more than a step, so many times in a row; or so many times. If
# it ends at the first time, one of 30 such clicks finds half of the tube. The 10 clicks need 9 to 13 searches.
_MOST_WITHOUT_GROWTH, _MOST_SEARCHES = 2, 20
# While the axis grows, the surface need not be the one of least cost. More rounds take up to twice the time.
_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class Axis:
    """Rays from the axis of an organ: across it, and in all directions beyond its ends.

    Parameters
    ----------
    points : (n, 3) ndarray
        From one end to the other, RAS mm.
    tangents : (n, 3) ndarray
        Unit vectors.
    frames : (n, 3, 2) ndarray
        Two unit vectors across the axis.
    half_width : float
        Radius of a circle with the area of the organ's median cross-section, mm.
    """

    points: np.ndarray
    tangents: np.ndarray
    frames: np.ndarray
    half_width: float

    @classmethod
    def within(cls, line: Centreline, half_width: float) -> Axis:
        """Axis of an organ with a half width, mm, along its centreline, without the ends of this."""
        steps = np.linalg.norm(np.diff(line.points, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        step = _STEP * half_width
        # Of a ball, hardly any axis is left; it may grow.
        cut = min(_FROM_END * half_width, along[-1] / 2.0 - step)
        wanted = np.linspace(cut, along[-1] - cut, max(int((along[-1] - 2.0 * cut) / step) + 1, 3))
        points = interpolated(along, line.points, wanted)
        tangents = np.gradient(points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        across = interpolated(along, line.frames[..., 0], wanted)
        across -= np.einsum("nk,nk->n", across, tangents)[:, None] * tangents
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        return cls(points, tangents, np.stack([across, np.cross(tangents, across)], axis=2), half_width)

    @cached_property
    def length(self) -> float:
        """Length, mm."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def half_length(self) -> float:
        """Half of the length, in half widths of the organ."""
        return self.length / (2.0 * self.half_width)

    @cached_property
    def tree(self) -> cKDTree:
        """Tree of the points."""
        return cKDTree(self.points)

    def graph(self, *, fine: bool) -> RayGraph:
        """Rays through evenly spread places of a capsule around the axis, see :func:`capsule`."""
        return capsule(self.half_length, _FINE if fine else _COARSE)

    def rays(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins, RAS mm, and unit vectors of the rays through places (n, 3) of the capsule, each (n, 3)."""
        heights = np.clip(places[:, 2], -self.half_length, self.half_length)
        known = np.linspace(-self.half_length, self.half_length, len(self.points))
        origins, tangents, frames = (
            interpolated(known, values, heights) for values in (self.points, self.tangents, self.frames)
        )
        directions = np.einsum("nkb,nb->nk", frames, places[:, :2]) + (places[:, 2] - heights)[:, None] * tangents
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places on the capsule of the rays through points (m, 3), RAS mm, and distances from the axis, mm.

        Where rays cross inside of a tight bend, the ray is the one from the nearest place of the axis.
        """
        _, nearest = self.tree.query(points)
        away = points - self.points[nearest]
        along = np.einsum("mk,mk->m", away, self.tangents[nearest])
        # Between the ends, what is left along the axis is the distance from the nearest of its points.
        last = len(self.points) - 1
        along = np.where(((nearest == 0) & (along < 0.0)) | ((nearest == last) & (along > 0.0)), along, 0.0)
        across = np.einsum("mk,mkb->mb", away, self.frames[nearest])
        distances = np.linalg.norm(np.column_stack([across, along]), axis=1)
        places = np.column_stack([across, along]) / np.maximum(distances, 1e-9)[:, None]
        places[:, 2] += self.half_length * (2.0 * nearest / last - 1.0)
        return places, distances


def find_along_axis(image: Image, star: RaySurface, wall: np.ndarray | None = None) -> RaySurface | None:
    """Find the surface of least cost along an organ's axis.

    Parameters
    ----------
    image : Image
    star : RaySurface
        The star-shaped surface of a part of the organ, or of all of it.
    wall : (n, 3) ndarray, optional
        Places that the surface has to pass, RAS mm.

    Returns
    -------
    RaySurface or None
        Its source is an :class:`Axis`. None if the organ is too flat or too thin for its length to have an axis.

    Notes
    -----
    Costs are those of the star-shaped surface, see :func:`.star_surface.find_star`. Nothing farther than 150 mm from
    the centre of the star-shaped surface is searched.
    """
    search, surface, longest, without_growth = RaySearch(image, star.source.point, wall), star, 0.0, 0
    for _ in range(_MOST_SEARCHES):
        axis = _axis_of(surface, search.axes)
        if axis is None:
            return None
        grows = axis.length > longest + _STEP * axis.half_width
        without_growth = 0 if grows else without_growth + 1
        if without_growth == _MOST_WITHOUT_GROWTH:
            break
        surface, longest = search.surface(axis, bright=star.bright, rounds=_ROUNDS), max(axis.length, longest)
    return search.refined(surface)


def capsule(half_length: float, step: float) -> RayGraph:
    """Spread places over a straight capsule of radius 1: rings around its axis.

    Parameters
    ----------
    half_length : float
        Half of the length of the axis, which lies along z.
    step : float
        Distance between neighbours.

    Returns
    -------
    RayGraph
    """
    rings = max(round(2.0 * half_length / step), 1)
    circles = round(np.pi / 2.0 / step)
    latitudes = np.pi / 2.0 * np.arange(1, circles + 1) / circles
    heights = half_length * (2.0 * np.arange(rings + 1) / rings - 1.0)
    cap = half_length + np.sin(latitudes)
    heights = np.concatenate([-cap[::-1], heights, cap])
    widths = np.concatenate([np.cos(latitudes[::-1]), np.ones(rings + 1), np.cos(latitudes)])
    places = []
    for number, (height, width) in enumerate(zip(heights, widths)):
        count = max(round(2.0 * np.pi * width / step), 1)
        angles = 2.0 * np.pi * (np.arange(count) + 0.5 * (number % 2)) / count
        ring = [width * np.cos(angles), width * np.sin(angles), np.full(count, height)]
        places.append(np.stack(ring, axis=1))
    return gabriel_graph(np.concatenate(places), 2.0 * step, half_length=half_length)


def _axis_of(surface: RaySurface, axes: np.ndarray) -> Axis | None:
    """Axis of the part of a surface in the volume; the columns of axes are those of the image's grid."""
    surface = replace(surface, radii=np.minimum(surface.radii, surface.border))
    along = surface.points @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    spacing = max(_LATTICE * float(np.median(surface.radii)), float((high - low).max()) / _MOST_STEPS)
    counts = np.ceil((high - low) / spacing).astype(int) + 3
    lattice = np.eye(4)
    lattice[:3, :3] = spacing * axes
    lattice[:3, 3] = axes @ ((low + high - spacing * (counts - 1)) / 2.0)
    k, j, i = np.indices(counts[::-1])
    nodes = np.stack([i, j, k], axis=-1).reshape(-1, 3) @ lattice[:3, :3].T + lattice[:3, 3]
    inside = (surface.inward(nodes) > 0.0).reshape(counts[::-1])
    line = centreline(inside, lattice)
    if line is None:
        return None
    half_width = float(np.sqrt(np.median(np.abs(np.linalg.det(line.sections)))))
    # The lattice does not show the sections of a thinner organ.
    return None if half_width < spacing else Axis.within(line, half_width)
