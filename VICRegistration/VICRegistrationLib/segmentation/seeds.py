"""Seeds: points that a user has placed in an organ."""

from __future__ import annotations

import itertools

import numpy as np

from ..imaging.image import Image

_NUDGE_MM = 1e-6 * np.array([1.0, 1.7, 2.9])


def checked_seeds(image: Image, seeds) -> np.ndarray:
    """Bring seeds to shape (n, 3), RAS mm, and refuse those that are not points of the volume."""
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
    # Not the other way round: a point so far away that its index overflows has no order.
    outside = ~((index >= -0.5) & (index <= image.size - 0.5)).all(axis=1)
    if outside.any():
        corners = image.to_ras(list(itertools.product(*([-0.5, n - 0.5] for n in image.size))))
        ranges = ", ".join(
            f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in zip("RAS", corners.min(0), corners.max(0))
        )
        place = ", ".join(f"{value:.1f}" if abs(value) < 1e6 else f"{value:g}" for value in points[outside][0])
        msg = f"The seed ({place}) mm lies outside the volume ({ranges} mm); place it in the organ (RAS mm)."
        raise ValueError(msg)
    return points


def voxels_of(image: Image, points) -> np.ndarray:
    """Voxels (k, j, i) that hold RAS points of the volume, shape (n, 3).

    A point between two voxels goes to the one on its right, anterior or superior side, whichever way the axes
    of the grid run.
    """
    index = image.to_ijk(np.asarray(points) + _NUDGE_MM)
    return np.rint(index[:, ::-1]).astype(int).clip(0, np.array(image.array.shape) - 1)
