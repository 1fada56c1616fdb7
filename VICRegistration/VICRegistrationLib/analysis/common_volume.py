"""Volume that two solids have in common, by quasi-random points in a box around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..geometry import bspline
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface

# Powers of the root of x^4 = x + 1: the sequence that fills a cube most evenly (M. Roberts, 2018).
_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)
_REPLICATES = 8
# Points of each replicate: so many at first, doubled until the error is small enough.
_FIRST, _MOST = 1024, 16384
# Standard error of the volume at which no more points are taken.
_ACCURACY = 0.005
# The box shrinks on a lattice of about so many points.
_LATTICE = 3000
_MAX_SHRINKINGS = 8
# Samples of each surface in u and in v that tell the side of points far from it; four for each control point at least.
_SAMPLES = (160, 100)


@dataclass(frozen=True)
class Overlap:
    """What two solids have in common.

    Parameters
    ----------
    volume : float
        mm^3.
    error : float
        Of the volume, mm^3: twice its standard error. Zero where a whole organ lies in the other one.
    center : (r, a, s)
        Centroid of the common volume, RAS mm.
    """

    volume: float
    error: float
    center: tuple[float, float, float]

    @classmethod
    def of_whole(cls, surface: BSplineSurface) -> Overlap:
        """Overlap of a solid with one that it lies inside of: exact.

        Parameters
        ----------
        surface : BSplineSurface
            Closed, normals outward.

        Returns
        -------
        Overlap
        """
        return cls(surface.volume(), 0.0, tuple(_centroid(surface).tolist()))


def common_volume(
    first: BSplineSurface, second: BSplineSurface, boundary: np.ndarray, *, margin: float, seed: int = 0
) -> Overlap:
    """Measure the common volume of two solids whose surfaces cross.

    Parameters
    ----------
    first, second : BSplineSurface
        Closed, normals outward, RAS mm.
    boundary : (n, 3) array_like
        Points, RAS mm; no point of the common volume's boundary is farther than `margin` from one of them.
    margin : float
        mm.
    seed : int
        Of the random numbers that shift the points; the same seed gives the same result.

    Returns
    -------
    Overlap

    Notes
    -----
    A box along the common volume's principal axes is shrunk around it. Eight randomly shifted copies of a quasi-random
    sequence (Cranley and Patterson, 1976) then give eight independent volumes without bias: their mean is the result,
    and their spread its error. Points are taken until the standard error is 0.5 %, or 131 072 are used. A point is
    inside where it lies on the inner side of both exact surfaces.
    """
    random = np.random.default_rng(seed)
    solids = _Solid(first), _Solid(second)
    box = _shrunk(solids, _Box.around(np.asarray(boundary, dtype=float), margin))
    shifts = random.random((_REPLICATES, 1, 3))
    counts, total, number = np.zeros(_REPLICATES), np.zeros(3), 0
    while number < _MOST:
        until = max(2 * number, _FIRST)
        unit = np.mod(shifts + np.arange(number, until)[:, None] * _STEPS, 1.0)
        points = box.points(unit.reshape(-1, 3))
        inside = _depth(solids, points, 0.0) <= 0.0
        counts += inside.reshape(_REPLICATES, -1).sum(axis=1)
        total += points[inside].sum(axis=0)
        number = until
        mean, error = counts.mean(), counts.std(ddof=1) / np.sqrt(_REPLICATES)
        if mean > 0.0 and error <= _ACCURACY * mean:
            break
    center = total / counts.sum() if counts.sum() else box.points(np.full((1, 3), 0.5))[0]
    scale = box.volume / number
    # With no point inside, the volume is below that of one point.
    return Overlap(float(mean * scale), float(2.0 * max(error, 1.0 / _REPLICATES) * scale), tuple(center.tolist()))


@dataclass(frozen=True, eq=False)
class _Box:
    """Oriented box: its corner and three edges (rows), RAS mm."""

    corner: np.ndarray
    edges: np.ndarray

    @classmethod
    def around(cls, points: np.ndarray, margin: float) -> _Box:
        """Box along the principal axes of points, wider by a margin."""
        center = points.mean(axis=0)
        axes = np.linalg.svd(points - center, full_matrices=True)[2]
        along = (points - center) @ axes.T
        low, high = along.min(axis=0) - margin, along.max(axis=0) + margin
        return cls(center + low @ axes, (high - low)[:, None] * axes)

    @property
    def volume(self) -> float:
        return float(np.linalg.norm(self.edges, axis=1).prod())

    def points(self, unit: np.ndarray) -> np.ndarray:
        """Take points of the unit cube to the box."""
        return self.corner + unit @ self.edges


def _shrunk(solids: tuple[_Solid, _Solid], box: _Box) -> _Box:
    """Shrink a box to what may be the common volume, as long as that pays."""
    for _ in range(_MAX_SHRINKINGS):
        lengths = np.linalg.norm(box.edges, axis=1)
        counts = np.ceil(lengths * (_LATTICE / box.volume) ** (1.0 / 3.0))
        ticks = [(np.arange(count) + 0.5) / count for count in counts]
        unit = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        # No point of the box is farther than this from a point of the lattice.
        radius = np.linalg.norm(lengths / counts) / 2.0
        points = box.points(unit)
        depth = _depth(solids, points, radius)
        kept = points[depth <= radius]
        if np.mean(depth <= 0.0) > 0.3 or len(kept) < 2:
            return box
        smaller = _Box.around(kept, radius)
        if smaller.volume > 0.7 * box.volume:
            return box
        box = smaller
    return box


class _Solid:
    """One solid, that tells on which side of its surface points lie."""

    def __init__(self, surface: BSplineSurface) -> None:
        self.surface = surface
        axes = [
            np.linspace(low, high, max(least, 4 * size) + 1)
            for (low, high), least, size in zip(surface.domain, _SAMPLES, surface.control_net.shape)
        ]
        grid = surface.grid(*axes)
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).max() for axis in (0, 1)]
        self.spacing = float(np.hypot(*steps)) / 2.0
        self.points = grid.reshape(-1, 3)
        u, v = np.meshgrid(*axes, indexing="ij")
        self.normals = surface.normals(u.ravel(), v.ravel())
        self.tree = cKDTree(self.points)

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (n,), negative inside; exact near the surface, elsewhere nearer to 0 by up to a spacing."""
        far, nearest = self.tree.query(points)
        height = np.einsum("nk,nk->n", points - self.points[nearest], self.normals[nearest])
        distances = np.copysign(np.maximum(far - self.spacing, 0.0), height)
        # Seen from afar there is no doubt about the side.
        doubtful = (far < 2.0 * self.spacing) | (np.abs(height) < 0.5 * far)
        distances[doubtful] = closest_points(self.surface, points[doubtful]).distances
        return distances


def _depth(solids: tuple[_Solid, _Solid], points: np.ndarray, least: float) -> np.ndarray:
    """Distance (n,) from being in both solids, never too large outside; of the second only where that matters."""
    depth = solids[0].distances(points)
    near = np.flatnonzero(depth <= least)
    depth[near] = np.maximum(depth[near], solids[1].distances(points[near]))
    return depth


def _centroid(surface: BSplineSurface) -> np.ndarray:
    """Centroid of a solid, by the divergence theorem: the integral of x_k^2 n_k / 2 over its surface; exact."""
    p, q = surface.degrees
    u, weights_u = bspline.gauss_points(p, surface.knots_u, 2 * p + 1)
    v, weights_v = bspline.gauss_points(q, surface.knots_v, 2 * q + 1)
    origin = surface.control_net.mean(axis=(0, 1))
    offset = surface.grid(u, v) - origin
    cross = np.cross(surface.grid(u, v, du=1), surface.grid(u, v, dv=1))
    moments = np.einsum("i,j,ijk,ijk->k", weights_u, weights_v, offset**2, cross) / 2.0
    return origin + moments / surface.volume()
