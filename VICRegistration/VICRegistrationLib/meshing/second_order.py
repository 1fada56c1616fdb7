"""From straight to curved tetrahedra: nodes in the middles of the edges, on the exact surface at the boundary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from .elements import EDGES, scaled_jacobians
from .groups import boundary_faces

# Where curving an edge makes an element worse than this, the edge is curved half as much, at most so often.
_HALVINGS = 4
# Rounds of going to and fro between two surfaces, to the curve in which they meet.
_ROUNDS = 4


def second_order(
    points: np.ndarray,
    tetrahedra: np.ndarray,
    region: np.ndarray,
    surfaces: Sequence[BSplineSurface],
    *,
    least_quality: float,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Give tetrahedra nodes in the middles of their edges.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4) ndarray of int
    region : (m,) ndarray of int
    surfaces : sequence of BSplineSurface
        On which the faces between regions and those of the boundary lie.
    least_quality : float
        Scaled Jacobian that curving must not go below; elements that were worse when straight stay straight.

    Returns
    -------
    points : (n + e, 3) ndarray
        RAS mm; the middles behind the corners.
    tetrahedra : (m, 10) ndarray of int
    flattened : int
        Number of edges whose middle is not on the surface, for the sake of the elements' shape.
    """
    ends = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    edges, number = np.unique(ends, axis=0, return_inverse=True)
    number = number.reshape(-1, len(EDGES))
    straight = points[edges].mean(axis=1)
    shift = _shifts(points, tetrahedra, region, surfaces, edges, straight)
    curved = (shift != 0.0).any(axis=1)
    share = np.ones(len(edges))
    cells = np.column_stack([tetrahedra, len(points) + number])
    doubtful = np.flatnonzero(curved[number].any(axis=1))
    for halving in range(_HALVINGS + 1):
        nodes = np.concatenate([points, straight + share[:, None] * shift])
        bad = doubtful[scaled_jacobians(nodes, cells[doubtful]) < least_quality]
        if not len(bad):
            break
        share[np.unique(number[bad])] *= 0.5 if halving < _HALVINGS - 1 else 0.0
    nodes = np.concatenate([points, straight + share[:, None] * shift])
    return nodes, cells, int(np.count_nonzero(curved & (share < 1.0)))


def _shifts(points, tetrahedra, region, surfaces, edges, straight) -> np.ndarray:
    """How far the middle of every edge is from the surfaces that it lies on, (e, 3)."""
    faces, on_surface = boundary_faces(points, tetrahedra, region, surfaces)
    of_faces = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    key = edges[:, 0] * len(points) + edges[:, 1]
    row = np.searchsorted(key, of_faces[:, 0] * len(points) + of_faces[:, 1])
    touched = np.zeros((len(surfaces), len(edges)), dtype=bool)
    touched[np.repeat(on_surface, 3), row] = True
    target = straight.copy()
    for surface, mine in zip(surfaces, touched):
        if mine.any():
            target[mine] = closest_points(surface, target[mine]).points
    crease = touched.sum(axis=0) > 1
    for _ in range(_ROUNDS if crease.any() else 0):
        for surface, mine in zip(surfaces, touched & crease):
            if mine.any():
                target[mine] = closest_points(surface, target[mine]).points
    return target - straight
