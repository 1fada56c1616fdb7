"""Where the triangles of one sheet pass through those of another."""

from __future__ import annotations

import numpy as np

from ..meshing.elements import TRIANGLE_EDGES

# Edges that are compared with the triangles near them at a time.
_BLOCK = 50


def crossing(points: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray | None:
    """Find a place where an edge of one set of triangles passes through a triangle of the other.

    Parameters
    ----------
    points : (n, 3) ndarray
    first, second : (m, 3) ndarray of int
        Triangles over the same points. Those that have a vertex in common touch, and do not count.

    Returns
    -------
    (3,) ndarray or None
        The first place that is found.

    References
    ----------
    .. [1] T. Möller and B. Trumbore: Fast, minimum storage ray-triangle intersection. J. Graphics Tools 2, 1997.
    """
    for edges_of, through in ((first, second), (second, first)):
        edges = np.unique(np.sort(edges_of[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1), axis=0)
        edges = _meeting(points, edges, through)
        for start in range(0, len(edges), _BLOCK):
            some = edges[start : start + _BLOCK]
            found = _passing(points, some, _meeting(points, through, some))
            if found is not None:
                return found
    return None


def _meeting(points: np.ndarray, cells: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the cells whose box meets the box around all the others."""
    if not len(others):
        return cells[:0]
    low, high = points[others].min(axis=(0, 1)), points[others].max(axis=(0, 1))
    corners = points[cells]
    return cells[((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)]


def _passing(points: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Find a point in which one of the edges passes through one of the triangles."""
    if not len(triangles):
        return None
    begin, way = points[edges[:, 0]][:, None], (points[edges[:, 1]] - points[edges[:, 0]])[:, None]
    corner = points[triangles[:, 0]]
    a, b = points[triangles[:, 1]] - corner, points[triangles[:, 2]] - corner
    across = np.cross(way, b)
    volume = (across * a).sum(axis=-1)
    inverse = np.divide(1.0, volume, out=np.zeros_like(volume), where=np.abs(volume) > 1e-12)
    offset = begin - corner
    side = np.cross(offset, a)
    u, v = (offset * across).sum(axis=-1) * inverse, (way * side).sum(axis=-1) * inverse
    t = (b * side).sum(axis=-1) * inverse
    hit = (inverse != 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t >= 0.0) & (t <= 1.0)
    hit &= ~(edges[:, None, :, None] == triangles[None, :, None, :]).any(axis=(2, 3))
    if not hit.any():
        return None
    edge, _ = np.unravel_index(int(np.argmax(hit)), hit.shape)
    return (begin + t[hit][:1, None] * way)[edge, 0]
