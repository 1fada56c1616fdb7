"""Triangles of other programs made fit to measure against: one corner at each place, each triangle once."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

# Corners nearer than this are one, as a fraction of the largest coordinate: some ten times the spacing of single
# precision numbers, in which most mesh files are written.
_ROUNDING = 1e-6


def joined(points: np.ndarray, triangles: np.ndarray, *, rounded: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Make one corner of all that are at one place, and drop triangles that have no three corners left.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int
    rounded : bool
        Whether corners that differ by rounding are at one place too.

    Returns
    -------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int
    """
    points, number = np.unique(points, axis=0, return_inverse=True)
    number = number.reshape(-1)
    if rounded:
        near = cKDTree(points).query_pairs(_ROUNDING * np.abs(points).max(), output_type="ndarray")
        links = sparse.coo_matrix((np.ones(len(near), dtype=np.int8), near.T), shape=(len(points), len(points)))
        _, group = csgraph.connected_components(links, directed=False)
        _, first = np.unique(group, return_index=True)
        points, number = points[first], group[number]
    triangles = number[triangles].astype(np.int64)
    a, b, c = triangles.T
    return points, triangles[(a != b) & (b != c) & (c != a)]


def without_copies(triangles: np.ndarray) -> np.ndarray:
    """Drop triangles that are there again.

    Parameters
    ----------
    triangles : (m, 3) ndarray of int

    Returns
    -------
    (k, 3) ndarray of int
        If all triangles are there twice or more, one of each, whichever way its copies are turned (a surface with two
        sides). Else those that are turned the same way once: where two bodies touch, each has its own.
    """
    corners = np.sort(triangles, axis=1)
    first = np.argmin(triangles, axis=1)
    following = triangles[np.arange(len(triangles)), (first + 1) % 3]
    turned = following == corners[:, 2]
    _, place, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
    if len(count) and count.min() > 1:
        return triangles[np.sort(place)]
    _, place = np.unique(np.column_stack([corners, turned]), axis=0, return_index=True)
    return triangles[np.sort(place)]
