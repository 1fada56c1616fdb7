"""Erosion, dilation, filling of holes, largest piece and boundary of voxel masks, with lengths in millimetres."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def dilate(mask, spacing, radius_mm: float) -> np.ndarray:
    """Dilate a mask by a ball.

    Parameters
    ----------
    mask : ndarray of bool, shape (nk, nj, ni)
    spacing : array_like, shape (3,) or (3, 3)
        Distance in mm between voxels along i, j and k or, for sheared grids, the matrix whose columns are
        the steps along i, j and k (the upper left block of ``ijk_to_ras``).
    radius_mm : float
        A voxel is added if its centre is at most this far from the centre of a voxel of the mask; a ball of 2 mm does
        not reach from one 4 mm slice to the next.

    Returns
    -------
    ndarray of bool, shape (nk, nj, ni)
        Outside of the array counts as background.

    Raises
    ------
    ValueError
        If the radius is negative or not finite.

    Notes
    -----
    The ball is divided into runs of voxels along i. The flattened mask is dilated by runs of increasing length, and
    each run of the ball is one "or" with a shifted copy of it.
    """
    runs = _ball_runs(spacing, radius_mm)
    if len(runs) == 1 and runs[0][3] == 1:
        return np.array(mask, dtype=bool)
    pad = np.abs(runs[:, :2]).max(axis=0).tolist()
    pad.append(int(max(-runs[:, 2].min(), (runs[:, 2] + runs[:, 3]).max())))
    grid = np.pad(np.asarray(mask, dtype=bool), [(width, width) for width in pad])
    _, nj, ni = grid.shape
    flat = grid.ravel()
    grown = flat.copy()
    run, length = flat.copy(), 1
    for dk, dj, first, count in runs[np.argsort(runs[:, 3], kind="stable")].tolist():
        while length < count:
            run[:-length] |= flat[length:]
            length += 1
        _or_shifted(grown, run, (dk * nj + dj) * ni + first)
    inside = tuple(slice(width, width + size) for width, size in zip(pad, np.shape(mask)))
    return grown.reshape(grid.shape)[inside]


def erode(mask, spacing, radius_mm: float) -> np.ndarray:
    """Erode a mask by a ball, with the parameters and errors of `dilate`.

    Returns
    -------
    ndarray of bool, shape (nk, nj, ni)
        Outside of the array counts as mask, so that an organ cut by the border of the volume is not eroded from
        there. To erode it, pad the mask with background.
    """
    return ~dilate(~np.asarray(mask, dtype=bool), spacing, radius_mm)


def fill_holes(mask) -> np.ndarray:
    """Fill cavities: background that is not connected with the array's border along face neighbours.

    Parameters
    ----------
    mask : ndarray of bool, shape (nk, nj, ni)

    Returns
    -------
    ndarray of bool, shape (nk, nj, ni)
    """
    labels, count = ndimage.label(~np.asarray(mask, dtype=bool))
    open_to_border = np.zeros(count + 1, dtype=bool)
    for axis in range(3):
        for end in (0, -1):
            open_to_border[labels.take(end, axis=axis).ravel()] = True
    open_to_border[0] = False
    return ~open_to_border[labels]


def largest_piece(mask: np.ndarray) -> np.ndarray:
    """Keep the largest piece of a mask, connected along face neighbours.

    Parameters
    ----------
    mask : ndarray of bool
        In any number of dimensions.

    Returns
    -------
    ndarray of bool
        The first one of several pieces of the same size; the mask itself if it is empty.
    """
    labels, count = ndimage.label(mask)
    return mask if count < 2 else labels == np.bincount(labels.ravel())[1:].argmax() + 1


def boundary_voxels(mask) -> np.ndarray:
    """Find the voxels of a mask that have a face neighbour outside of it, or lie at the array's border.

    Parameters
    ----------
    mask : ndarray of bool, shape (nk, nj, ni)

    Returns
    -------
    ndarray of int, shape (n, 3)
        Their indices (k, j, i).
    """
    padded = np.pad(mask, 1)
    inner = padded[1:-1, 1:-1, 1:-1].copy()
    for axis in range(3):
        for end in (slice(None, -2), slice(2, None)):
            inner &= padded[tuple(end if a == axis else slice(1, -1) for a in range(3))]
    return np.argwhere(mask & ~inner)


def ball_reach(spacing, radius_mm: float) -> np.ndarray:
    """Return the largest offset of a voxel in the ball of `dilate` along k, j and i, shape (3,)."""
    runs = _ball_runs(spacing, radius_mm)
    along_i = max(-runs[:, 2].min(), (runs[:, 2] + runs[:, 3]).max() - 1)
    return np.array([*np.abs(runs[:, :2]).max(axis=0), along_i])


def _or_shifted(target, source, shift):
    """Or the source into the target, shifted back by ``shift``; the padding keeps what wraps around empty."""
    if shift > 0:
        target[:-shift] |= source[shift:]
    elif shift < 0:
        target[-shift:] |= source[:shift]
    else:
        target |= source


def _ball_runs(spacing, radius_mm):
    """Divide the ball into runs along i: rows of (dk, dj, first di, number of voxels)."""
    if not (np.isfinite(radius_mm) and radius_mm >= 0):
        msg = f"The radius is {radius_mm} mm; it must be zero or a positive length."
        raise ValueError(msg)
    spacing = np.asarray(spacing, dtype=float)
    steps = np.diag(spacing) if spacing.ndim == 1 else spacing
    # With a tolerance, so that a voxel at exactly the radius belongs to the ball in spite of rounding.
    radius = radius_mm * (1 + 1e-6)
    # Row n of the inverse times the radius bounds index n of every point of the ball.
    reach = np.floor(radius * np.linalg.norm(np.linalg.inv(steps), axis=1)).astype(int)
    dk, dj = (
        axis.ravel() for axis in np.meshgrid(*(np.arange(-n, n + 1) for n in (reach[2], reach[1])), indexing="ij")
    )
    # |di a + b|^2 <= r^2 is a quadratic inequality in di, with a the step along i.
    offset = np.outer(dj, steps[:, 1]) + np.outer(dk, steps[:, 2])
    square = steps[:, 0] @ steps[:, 0]
    middle = -(offset @ steps[:, 0]) / square
    rest = (radius**2 - (offset**2).sum(axis=1)) / square + middle**2
    half = np.sqrt(np.maximum(rest, 0.0))
    first = np.ceil(middle - half).astype(int)
    count = np.floor(middle + half).astype(int) - first + 1
    hit = (rest >= 0) & (count > 0)
    return np.stack([dk, dj, first, count], axis=1)[hit]
