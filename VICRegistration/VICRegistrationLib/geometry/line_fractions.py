"""Share of each voxel that lies inside a closed mesh, by lines through the voxels: fast enough for use during a fit."""

from __future__ import annotations

import numpy as np


def line_fractions(
    points: np.ndarray, triangles: np.ndarray, shape: tuple[int, int, int], ijk_to_ras: np.ndarray, *, lines: int = 2
) -> np.ndarray:
    """Fraction of every voxel that lies inside a closed surface, from lines along its longest edge.

    Parameters
    ----------
    points : (n, 3) ndarray
        Vertices, RAS mm.
    triangles : (m, 3) ndarray of int
        Vertex numbers of a closed surface, consistently oriented.
    shape : (nk, nj, ni)
        Shape of the image array.
    ijk_to_ras : (4, 4) ndarray
        Affine matrix from the centres of voxels to RAS mm.
    lines : int
        Number of lines through a voxel along each of its two shorter edges; lines^2 in all.

    Returns
    -------
    (nk, nj, ni) float32 ndarray
        From 0 to 1.

    Notes
    -----
    The part of each line inside is computed exactly, while :func:`.volume_fractions.volume_fractions` tests points. The
    phantoms are painted by that function, so that a fit is not tested with its own arithmetic. A line through a common
    edge of two triangles crosses exactly one of them, because both compute the same intersection for it.
    """
    ijk = (points - ijk_to_ras[:3, 3]) @ np.linalg.inv(ijk_to_ras[:3, :3]).T
    size, strides = np.array(shape[::-1]), np.array([1, shape[2], shape[2] * shape[1]])
    along = int(np.linalg.norm(ijk_to_ras[:3, :3], axis=0).argmax())
    rows, columns = (axis for axis in range(3) if axis != along)
    # Lines are numbered along the two other axes, from the outer faces of the volume.
    y, z = ((ijk[:, axis] + 0.5) * lines - 0.5 for axis in (rows, columns))
    row, column, x, sense = _crossings(ijk[:, along], y, z, triangles, lines * size[[rows, columns]])
    # A crossing changes the share of its voxel by the part behind the crossing, and that of all voxels behind by 1.
    voxel = np.clip(np.floor(x + 0.5), -1, size[along]).astype(np.int64)
    behind = np.where(voxel < 0, 0.0, voxel + 0.5 - x)
    line = strides[rows] * (row // lines) + strides[columns] * (column // lines)
    place, part = np.concatenate([voxel, voxel + 1]), np.concatenate([sense * behind, sense * (1.0 - behind)])
    index = np.concatenate([line, line]) + strides[along] * place
    seen = (place >= 0) & (place < size[along])
    steps = np.bincount(index[seen], part[seen] / lines**2, size.prod()).reshape(shape)
    shares = np.cumsum(steps, axis=2 - along, dtype=np.float32)
    # The orientation of the triangles decides the sign. Where folds overlap, the share is clipped to 1.
    return np.clip(np.sign(shares.sum()) * shares, 0.0, 1.0, out=shares)


def _crossings(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, triangles: np.ndarray, ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the crossings of triangles with lines along x at integers y and z below the ends.

    Returns y, z and x of each crossing, and its sense, 1 or -1.
    """
    # Corners in the order of z, so that both triangles at an edge compute it from the same end.
    order = np.argsort(z[triangles], axis=1, kind="stable")
    corners = np.take_along_axis(triangles, order, axis=1).T
    turns = np.where((order[:, 1] - order[:, 0]) % 3 == 1, 1.0, -1.0)
    triangle, column = _whole_numbers(z[corners[0]], z[corners[2]], ends[1])
    low, middle, high = corners[:, triangle]
    above = column >= z[middle]
    long_y, long_x = _on_edge(x, y, z, low, high, column)
    short_y, short_x = _on_edge(x, y, z, np.where(above, middle, low), np.where(above, high, middle), column)
    sense = turns[triangle] * np.sign(short_y - long_y)
    cut, row = _whole_numbers(np.minimum(long_y, short_y), np.maximum(long_y, short_y), ends[0])
    share = (row - long_y[cut]) / (short_y - long_y)[cut]
    return row, column[cut], long_x[cut] + share * (short_x - long_x)[cut], sense[cut]


def _on_edge(x, y, z, start, end, column) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate y and x at z = column on edges between two corners."""
    share = (column - z[start]) / (z[end] - z[start])
    return y[start] + share * (y[end] - y[start]), x[start] + share * (x[end] - x[start])


def _whole_numbers(first: np.ndarray, last: np.ndarray, end: int) -> tuple[np.ndarray, np.ndarray]:
    """List the integers n with first <= n < last, from 0 to below the end, for many pairs; and each one's pair."""
    first, last = (np.clip(np.ceil(value), 0, end).astype(np.int64) for value in (first, last))
    counts = last - first
    pair = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return pair, np.arange(len(pair)) + (first - before)[pair]
