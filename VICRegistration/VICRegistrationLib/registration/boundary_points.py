"""Boundary points: points on the organ's wall that the user gives."""

from __future__ import annotations

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface

# Points farther from the surface are refused: they are meant for another organ, or lie in another frame.
LARGEST_DISTANCE_MM = 30.0
# Largest distance of a corrected surface from a boundary point of weight 1.
LARGEST_LEFT_MM = 0.5
# No patient lies farther from the origin, and squares of far larger numbers overflow.
_LARGEST_COORDINATE_MM = 1e6


def boundary_deviations(surface: BSplineSurface, points) -> np.ndarray:
    """Signed distances of boundary points from a surface.

    Parameters
    ----------
    surface : BSplineSurface
    points : (n, 3) array_like
        RAS mm.

    Returns
    -------
    (n,) ndarray
        mm, positive where the point lies outside of the surface.

    Raises
    ------
    ValueError
        If the points are not (n, 3) finite numbers.
    """
    return closest_points(surface, checked_boundary_points(points)).distances


def checked_boundary_points(points) -> np.ndarray:
    """Check the shape and the numbers of boundary points, and return them as an array.

    Parameters
    ----------
    points : (n, 3) array_like or None
        RAS mm; None and empty lists are no points.

    Returns
    -------
    (n, 3) ndarray

    Raises
    ------
    ValueError
        If the points are not (n, 3) finite numbers.
    """
    try:
        found = np.array([] if points is None else points, dtype=float)
    except (TypeError, ValueError):
        msg = f"The boundary points {points!r} are not (n, 3) numbers; give RAS coordinates in mm."
        raise ValueError(msg) from None
    if found.shape in ((0,), (0, 3)):
        return found.reshape(0, 3)
    if found.ndim != 2 or found.shape[1] != 3:
        msg = f"Boundary points of shape {found.shape} were given; (n, 3) RAS coordinates in mm are needed."
        raise ValueError(msg)
    # Comparisons with nan are False.
    bad = np.flatnonzero(~(np.abs(found) <= _LARGEST_COORDINATE_MM).all(axis=1))
    if len(bad):
        msg = f"Boundary point {bad[0] + 1} is {found[bad[0]].tolist()}; RAS coordinates of a patient, mm, are needed."
        raise ValueError(msg)
    return found


def check_distances(points: np.ndarray, distances: np.ndarray) -> None:
    """Raise an error for boundary points that cannot be meant for this surface.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    distances : (n,) ndarray
        From the surface, mm.

    Raises
    ------
    ValueError
        If one is farther away than `LARGEST_DISTANCE_MM`.
    """
    if not len(points):
        return
    worst = int(np.argmax(np.abs(distances)))
    if abs(distances[worst]) > LARGEST_DISTANCE_MM:
        place = ", ".join(f"{x:.1f}" for x in points[worst])
        msg = (
            f"Boundary point {worst + 1} at ({place}) mm is {abs(distances[worst]):.0f} mm from the surface; those "
            f"within {LARGEST_DISTANCE_MM:g} mm correct it. Move or remove the point, or separate the organ anew."
        )
        raise ValueError(msg)
