"""Seeds: points that a user has placed in an organ."""

from __future__ import annotations

import itertools

import numpy as np

from ..imaging.image import Image

# Added to a point before it is rounded to a voxel, R, A, S: a point half-way between two voxels then goes to the same
# one whichever way the axes of the grid run.
_NUDGE_MM = 1e-6 * np.array([1.0, 1.7, 2.9])


def checked_seeds(image: Image, seeds) -> np.ndarray:
    """Check seeds and bring them to shape (n, 3).

    Parameters
    ----------
    image : Image
    seeds : array_like, shape (n, 3) or (3,)
        RAS mm.

    Returns
    -------
    ndarray, shape (n, 3)
        RAS mm.

    Raises
    ------
    ValueError
        If a seed is not a point of the volume, or there is none.
    """
    try:
        points = np.atleast_2d(np.asarray(seeds, dtype=float))
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        msg = f"The seeds have shape {np.shape(seeds)}; give at least one point R, A, S (mm) in the organ."
        raise ValueError(msg)
    if not np.isfinite(points).all():
        msg = "A seed has a coordinate that is not finite; give R, A, S in mm."
        raise ValueError(msg)
    with np.errstate(over="ignore", invalid="ignore"):
        index = image.to_ijk(points)
    # Negated, so that it is also true for NaN: the index of a very distant point overflows.
    outside = ~((index >= -0.5) & (index <= image.size - 0.5)).all(axis=1)
    if outside.any():
        msg = f"{point_outside(image, 'seed', points[outside][0])}; place it in the organ (RAS mm)."
        raise ValueError(msg)
    return points


def point_outside(image: Image, what: str, point) -> str:
    """Sentence, without its full stop, that says that a point (R, A, S, mm) lies outside the volume, and where that is.

    Bounds alone would contradict it where an oblique volume does not fill them.
    """
    corners = image.to_ras(list(itertools.product(*([-0.5, n - 0.5] for n in image.size))))
    low, high = corners.min(axis=0), corners.max(axis=0)
    ranges = ", ".join(f"{axis} {start:.1f} to {stop:.1f}" for axis, start, stop in zip("RAS", low, high))
    place = ", ".join(f"{value:.1f}" if abs(value) < 1e6 else f"{value:g}" for value in point)
    within = ""
    if np.all((low <= point) & (point <= high)):
        nearest = image.to_ras(np.clip(image.to_ijk(point), -0.5, image.size - 0.5))
        within = f", but oblique: its nearest voxel is {np.linalg.norm(nearest - point):.1f} mm away"
    return f"The {what} ({place}) mm lies outside the volume ({ranges} mm{within})"


def voxels_of(image: Image, points) -> np.ndarray:
    """Voxels (k, j, i) at points of the volume, (n, 3), RAS mm.

    A point half-way between two voxels goes to the one on its right, anterior or superior side.
    """
    index = image.to_ijk(np.asarray(points) + _NUDGE_MM)
    return np.rint(index[:, ::-1]).astype(int).clip(0, np.array(image.array.shape) - 1)
