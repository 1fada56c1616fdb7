"""Triangles of a closed surface made more equal: edges flipped, nodes moved to the middle of their neighbours."""

from __future__ import annotations

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface

_ROUNDS = 6
_PASSES = 8
# An edge is flipped only if the two triangles lie this flat (cosine), before and after.
_FLAT = 0.7


def relaxed(surface: BSplineSurface, points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make triangles more equal without leaving the surface.

    Parameters
    ----------
    surface : BSplineSurface
    points : (n, 3) ndarray
        RAS mm, on the surface.
    triangles : (m, 3) ndarray of int
        Closed, all turned the same way.

    Returns
    -------
    points : (n, 3) ndarray
        Of the best of some rounds, judged by the smallest angle; the given ones, if none was better.
    triangles : (m, 3) ndarray of int
    """
    best = smallest_angle(points, triangles), points, triangles
    for _ in range(_ROUNDS):
        triangles = _flipped(points, triangles)
        points = closest_points(surface, _smoothed(points, triangles), starts=0).points
        least = smallest_angle(points, triangles)
        if least > best[0]:
            best = least, points, triangles
    return best[1], best[2]


def corner_angles(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Angles at the corners of triangles, (m, 3) radians."""
    corners = points[triangles]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = np.linalg.norm(np.cross(ahead, back), axis=2)
    return np.arctan2(cross, np.einsum("nij,nij->ni", ahead, back))


def smallest_angle(points: np.ndarray, triangles: np.ndarray) -> float:
    """Smallest angle of all triangles, radians."""
    return float(corner_angles(points, triangles).min())


def _smoothed(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Nodes in the mean of the centres of their triangles, weighted by area."""
    corners = points[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weighted = area[:, None] * corners.mean(axis=1)
    moved = np.zeros_like(points)
    for corner in triangles.T:
        moved += np.column_stack([np.bincount(corner, weights=axis, minlength=len(points)) for axis in weighted.T])
    total = np.bincount(triangles.ravel(), weights=np.repeat(area, 3), minlength=len(points))
    return moved / total[:, None]


def _flipped(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Flip edges whose opposite angles add up to more than 180 degrees, as far as that is safe."""
    triangles = triangles.copy()
    for _ in range(_PASSES):
        chosen = _flips(points, triangles)
        if not len(chosen):
            break
        # Columns: two triangles, and the nodes a, b of the edge, c, d opposite of it.
        first, second, a, b, c, d = chosen.T
        triangles[first], triangles[second] = np.column_stack([c, a, d]), np.column_stack([d, b, c])
    return triangles


def _flips(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Rows (triangle, triangle, a, b, c, d) of flips that do not disturb each other."""
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    order = np.lexsort(np.sort(sides, axis=1).T)
    # Every edge of a closed surface stands twice.
    one, two = order[0::2], order[1::2]
    angles = np.roll(corner_angles(points, triangles), 1, axis=1).ravel()
    opposite = np.roll(triangles, 1, axis=1).ravel()
    a, b = sides[one].T
    rows = np.column_stack([one // 3, two // 3, a, b, opposite[one], opposite[two]])
    gain = angles[one] + angles[two] - np.pi
    rows, gain = rows[gain > 1e-6], gain[gain > 1e-6]
    rows = rows[np.argsort(-gain)]
    rows = rows[_safe(points, sides, rows)]
    return rows[_independent(rows[:, :2], len(triangles))]


def _safe(points: np.ndarray, sides: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Whether the new edge is not there yet and the triangles lie flat before and after."""
    size = len(points)
    _, _, a, b, c, d = rows.T
    there = np.isin(np.minimum(c, d) * size + np.maximum(c, d), np.sort(sides, axis=1) @ np.array([size, 1]))

    def normal(i, j, k):
        cross = np.cross(points[j] - points[i], points[k] - points[i])
        return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    new = normal(c, a, d), normal(d, b, c)
    mean = normal(a, b, c) + normal(b, a, d)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    flat = [np.einsum("nk,nk->n", one, mean) > _FLAT for one in new]
    return ~there & flat[0] & flat[1]


def _independent(pairs: np.ndarray, size: int) -> np.ndarray:
    """Rows of pairs that are the first ones to claim both of their triangles."""
    rank = np.full(size, len(pairs))
    number = np.arange(len(pairs))
    np.minimum.at(rank, pairs[:, 0], number)
    np.minimum.at(rank, pairs[:, 1], number)
    return (rank[pairs[:, 0]] == number) & (rank[pairs[:, 1]] == number)
