"""Integrals over triangles with 3 or 6 nodes, flat or curved."""

from __future__ import annotations

import numpy as np
from scipy import sparse

# Gauss points in each direction of the collapsed square: exact for polynomials of degree 6, in all that matters here.
_GAUSS = 4


def normal_integrals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Integrals of every node's function times the normal: the forces of a unit pull.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3 or 6) ndarray of int
        Counter-clockwise seen from where the normal points to; middles of the edges 01, 12 and 20.

    Returns
    -------
    (n, 3) ndarray
        mm^2. Exact, so that those of a closed surface add up to nothing.
    """
    shapes, derivatives, weights = _rule(triangles.shape[1])
    normals = _normals(points, triangles, derivatives)
    parts = np.einsum("q,qa,mqk->mak", weights, shapes, normals)
    flat = triangles.ravel()
    return np.stack([np.bincount(flat, parts[..., k].ravel(), len(points)) for k in range(3)], axis=1)


def surface_mass(points: np.ndarray, triangles: np.ndarray) -> sparse.csr_matrix:
    """Integrals of the products of nodes' functions.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3 or 6) ndarray of int

    Returns
    -------
    (n, n) csr_matrix
        mm^2.
    """
    shapes, derivatives, weights = _rule(triangles.shape[1])
    areas = np.linalg.norm(_normals(points, triangles, derivatives), axis=2)
    values = np.einsum("q,mq,qa,qb->mab", weights, areas, shapes, shapes, optimize=True)
    count = triangles.shape[1]
    rows, columns = np.repeat(triangles, count, axis=1), np.tile(triangles, count)
    shape = (len(points), len(points))
    return sparse.coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()


def _normals(points, triangles, derivatives) -> np.ndarray:
    """Cross the tangents at the points of the rule: normals (m, q, 3), as long as the area is stretched."""
    tangents = np.einsum("mak,qad->mqdk", points[triangles], derivatives, optimize=True)
    return np.cross(tangents[:, :, 0], tangents[:, :, 1])


def _rule(nodes: int):
    """Shape functions (q, a), their derivatives (q, a, 2) and weights (q,) at the points of the rule."""
    x, weight = np.polynomial.legendre.leggauss(_GAUSS)
    x, weight = (x + 1.0) / 2.0, weight / 2.0
    s, t = (part.ravel() for part in np.meshgrid(x, x, indexing="ij"))
    weights = np.outer(weight * (1.0 - x), weight).ravel()
    corners = np.column_stack([1.0 - s - t * (1.0 - s), s, t * (1.0 - s)])
    slopes = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    if nodes == 3:
        return corners, np.broadcast_to(slopes, (len(weights), 3, 2)), weights
    first, second = np.array([0, 1, 2]), np.array([1, 2, 0])
    shapes = np.concatenate([corners * (2.0 * corners - 1.0), 4.0 * corners[:, first] * corners[:, second]], axis=1)
    at_corners = (4.0 * corners[:, :, None] - 1.0) * slopes
    at_middles = 4.0 * (corners[:, first, None] * slopes[second] + corners[:, second, None] * slopes[first])
    return shapes, np.concatenate([at_corners, at_middles], axis=1), weights
