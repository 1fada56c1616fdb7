"""Closest points of a B-spline surface, and signed distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from . import bspline
from .surface import BSplineSurface

# Number of blocks in u and v into which the samples are divided; each block may give one start of the iteration.
_BLOCKS = (4, 3)
# Smallest number of samples in u and v; every span has at least four in each direction.
_SAMPLES = (80, 50)
# Largest number of further starts, in blocks that may be closer than the first one.
_STARTS = 4
# Largest number of Newton steps; the best point found is kept.
_MOST_STEPS = 60


@dataclass(frozen=True, eq=False)
class Projection:
    """Points projected to a surface.

    Parameters
    ----------
    parameters : (n, 2) ndarray
        (u, v) of the closest points.
    points : (n, 3) ndarray
        The closest points, RAS mm.
    distances : (n,) ndarray
        Signed distances in mm, positive on the side the normals point to (outside).
    """

    parameters: np.ndarray
    points: np.ndarray
    distances: np.ndarray


def closest_points(surface: BSplineSurface, points: np.ndarray) -> Projection:
    """Find the closest point of a surface for each of many points.

    Parameters
    ----------
    surface : BSplineSurface
        Open or closed; on an open surface the closest point may lie on its edge.
    points : (n, 3) array_like
        RAS mm.

    Returns
    -------
    Projection

    Raises
    ------
    ValueError
        If the points are not (n, 3) finite numbers.

    Notes
    -----
    Damped Newton iteration on |S(u, v) - p|^2 (The NURBS Book, section 6.1), exact to rounding on smooth
    surfaces. On the creases of a surface that is only continuous (degree 1) it may stop short of the closest
    point, by less than the spacing of the samples.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        msg = f"Points of shape {points.shape} were given; (n, 3) finite RAS coordinates in mm are needed."
        raise ValueError(msg)
    if not len(points):
        return Projection(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0))
    parameters = _closest_parameters(surface, points, _Samples.of(surface))
    feet = surface.points(*parameters.T)
    offset = points - feet
    outside = np.einsum("nk,nk->n", offset, surface.normals(*parameters.T)) >= 0.0
    distances = np.linalg.norm(offset, axis=1)
    return Projection(parameters, feet, np.where(outside, distances, -distances))


def _closest_parameters(surface: BSplineSurface, points: np.ndarray, known: _Samples) -> np.ndarray:
    """Find the parameters of the closest points, (n, 2), from the closest sample and from further starts."""
    _, nearest = cKDTree(known.points).query(points)
    parameters, squared = _descend(surface, points, known.parameters[nearest])
    owner, start = _further_starts(known, points, np.sqrt(squared), known.block[nearest])
    other, other_squared = _descend(surface, points[owner], start)
    # From far to near, so that the best of several starts is written last.
    order = np.argsort(-other_squared, kind="stable")
    order = order[other_squared[order] < squared[owner[order]]]
    parameters[owner[order]] = other[order]
    return parameters


# ------------------------------------------------------------------ starts


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of the surface with their parameters, divided into blocks of neighbours."""

    points: np.ndarray
    parameters: np.ndarray
    block: np.ndarray
    spacing: float

    @classmethod
    def of(cls, surface: BSplineSurface) -> _Samples:
        axes = [surface.span_steps(axis, per_span=4, least=number) for axis, number in enumerate(_SAMPLES)]
        grid = surface.grid(*axes)
        steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).max() for axis in (0, 1)]
        rows, columns = (len(axis) for axis in axes)
        block_u = np.arange(rows) * _BLOCKS[0] // rows
        block_v = np.arange(columns) * _BLOCKS[1] // columns
        keep = np.ones((rows, columns), dtype=bool)
        keep[-1] = not surface.closed_u
        keep[:, -1] = not surface.closed_v
        keep[1:, [0, -1]] &= ~np.array(surface.poles)
        u, v = np.meshgrid(*axes, indexing="ij")
        return cls(
            grid[keep],
            np.column_stack([u[keep], v[keep]]),
            np.add.outer(block_u * _BLOCKS[1], block_v)[keep],
            float(np.hypot(*steps)) / 2.0,
        )


def _further_starts(samples: _Samples, points, distances, first_block):
    """Find starts in other blocks that may hold a closer point: indices of points, parameters (m, 2)."""
    n_blocks = _BLOCKS[0] * _BLOCKS[1]
    reach = distances + samples.spacing
    block_distances = np.full((len(points), n_blocks), np.inf)
    block_starts = np.zeros((len(points), n_blocks), dtype=int)
    for block in range(n_blocks):
        members = np.flatnonzero(samples.block == block)
        if not len(members):
            continue
        low, high = samples.points[members].min(axis=0), samples.points[members].max(axis=0)
        to_box = np.linalg.norm(points - np.clip(points, low, high), axis=1)
        asked = np.flatnonzero((to_box <= reach) & (first_block != block))
        found, index = cKDTree(samples.points[members]).query(points[asked])
        block_distances[asked, block] = found
        block_starts[asked, block] = members[index]
    block_distances[block_distances > reach[:, None]] = np.inf
    order = np.argsort(block_distances, axis=1)[:, :_STARTS]
    owner, rank = np.nonzero(np.isfinite(np.take_along_axis(block_distances, order, axis=1)))
    return owner, samples.parameters[block_starts[owner, order[owner, rank]]]


# ------------------------------------------------------------------ Newton iteration


def _descend(surface: BSplineSurface, targets, start):
    """Damped Newton iteration from given parameters: final parameters (n, 2) and squared distances (n,)."""
    # There may be no further starts.
    if not len(targets):
        return start, np.zeros(0)
    track = _Track(surface)
    result = track.turned_at_poles(np.array(start), targets)
    active = np.arange(len(targets))
    local = track.derivatives(result)
    squared = _squared(local, targets)
    damping = np.zeros(len(targets))
    final = squared.copy()
    for _ in range(_MOST_STEPS):
        step, length = track.step(result[active], local, targets[active], damping)
        moving = length > track.tolerance
        if not moving.any():
            break
        active, step, damping = active[moving], step[moving], damping[moving]
        local = local[:, moving]
        candidate = track.turned_at_poles(track.inside(result[active] + step), targets[active])
        candidate_local = track.derivatives(candidate)
        candidate_squared = _squared(candidate_local, targets[active])
        # The tolerance covers rounding of the squared distance, and is far below the effect of a step.
        better = candidate_squared <= final[active] * (1.0 + 1e-13) + track.tolerance**2
        result[active[better]] = candidate[better]
        final[active[better]] = candidate_squared[better]
        local[:, better] = candidate_local[:, better]
        damping = np.where(better, np.where(damping > 0.01, damping / 10.0, 0.0), np.maximum(8.0 * damping, 0.1))
    return result, final


def _squared(local, targets):
    return np.square(local[0] - targets).sum(axis=1)


class _Track:
    """One surface with its domain, seams and poles, for the iteration."""

    def __init__(self, surface: BSplineSurface) -> None:
        self.surface = surface
        self.low, self.high = np.array(surface.domain).T
        self.wraps = np.array([surface.closed_u, surface.closed_v])
        self.tolerance = 1e-12 * surface.size
        u = surface.span_steps(0, per_span=4, least=64)
        self.poles = []
        for pole, v, inward in zip(surface.poles, (self.low[1], self.high[1]), (1.0, -1.0)):
            if pole:
                slopes = inward * surface.grid(u, [v], dv=1)[:, 0]
                length = np.linalg.norm(slopes, axis=1, keepdims=True)
                slopes = np.divide(slopes, length, out=np.zeros_like(slopes), where=length > 0)
                self.poles.append((v, u, slopes, surface.points(u[:1], [v])[0]))

    def derivatives(self, parameters):
        """S, S_u, S_v, S_uu, S_uv and S_vv at parameters (n, 2), as (6, n, 3)."""
        surface, first, values = self.surface, [], []
        for axis, knots in enumerate(surface.knots):
            orders = [
                bspline.nonzero_basis(surface.degrees[axis], knots, parameters[:, axis], order) for order in range(3)
            ]
            first.append(orders[0][0][:, None] + np.arange(surface.degrees[axis] + 1))
            values.append(np.stack([value for _, value in orders], axis=1))
        patch = surface.control_net[first[0][:, :, None], first[1][:, None, :]]
        n, rows, columns, _ = patch.shape
        along_u = (values[0] @ patch.reshape(n, rows, -1)).reshape(n, 3, columns, 3)
        zeroth, once = values[1] @ along_u[:, 0], values[1][:, :2] @ along_u[:, 1]
        twice = values[1][:, :1] @ along_u[:, 2]
        return np.stack([zeroth[:, 0], once[:, 0], zeroth[:, 1], twice[:, 0], once[:, 1], zeroth[:, 2]])

    def inside(self, parameters):
        """Parameters wrapped at seams and clamped at other edges."""
        wrapped = self.low + np.mod(parameters - self.low, self.high - self.low)
        return np.clip(np.where(self.wraps, wrapped, parameters), self.low, self.high)

    def turned_at_poles(self, parameters, targets):
        """At a pole, where every u is the same point, choose the u along which v leads towards the target."""
        for v, u, slopes, place in self.poles:
            here = np.flatnonzero(parameters[:, 1] == v)
            if len(here):
                best = np.argmax((targets[here] - place) @ slopes.T, axis=1)
                parameters[here, 0] = u[best]
        return parameters

    def step(self, parameters, local, targets, damping):
        """Newton step (n, 2) within the domain, and its length on the surface, (n,) mm.

        The two unknowns are scaled to millimetres, so that damping and length are comparable near poles.
        """
        offset = local[0] - targets
        lengths = np.linalg.norm(local[1:3], axis=2).T
        free = lengths > 1e-9 * self.surface.size
        scale = np.where(free, lengths, 1.0)
        tangents = local[1:3].transpose(1, 0, 2) / scale[..., None]
        gradient = np.einsum("nak,nk->na", tangents, offset)
        blocked = ((parameters <= self.low) & (gradient > 0.0)) | ((parameters >= self.high) & (gradient < 0.0))
        free &= ~blocked | self.wraps
        gradient = np.where(free, gradient, 0.0)
        flat = np.einsum("nak,nbk->nab", tangents, tangents)
        curved = np.einsum("cnk,nk->nc", local[3:], offset)[:, [[0, 1], [1, 2]]]
        hessian = flat + curved / (scale[:, :, None] * scale[:, None, :])
        fixed = ~(free[:, :, None] & free[:, None, :])
        for matrix in (flat, hessian):
            matrix[fixed] = 0.0
            matrix[:, [0, 1], [0, 1]] += np.where(free, damping[:, None], 1.0)
        solution = -_solved_positive(hessian, flat, gradient)
        solution = np.where(free, solution, 0.0)
        step = solution / scale
        shrink = np.minimum(1.0, (self.high - self.low) / 8.0 / np.maximum(np.abs(step), 1e-300)).min(axis=1)
        moved = np.einsum("na,nak->nk", solution * shrink[:, None], tangents)
        return step * shrink[:, None], np.linalg.norm(moved, axis=1)


def _solved_positive(hessian, flat, gradient):
    """Solve 2x2 systems with the Hessian, or the Gauss-Newton matrix where it is not positive definite."""
    positive = (hessian[:, 0, 0] > 0.0) & (_determinant(hessian) > 1e-8 * hessian[:, 0, 0] * hessian[:, 1, 1])
    matrix = np.where(positive[:, None, None], hessian, flat)
    matrix[~positive] += 1e-6 * np.eye(2)
    right = np.stack(
        [
            matrix[:, 1, 1] * gradient[:, 0] - matrix[:, 0, 1] * gradient[:, 1],
            matrix[:, 0, 0] * gradient[:, 1] - matrix[:, 0, 1] * gradient[:, 0],
        ],
        axis=1,
    )
    return right / _determinant(matrix)[:, None]


def _determinant(matrix):
    return matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
