"""Smooth deformations of space by radial basis functions, which take a surface through points without folding it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from .parametrization import Parametrization
from .projection import closest_points
from .surface import BSplineSurface

# The steepest slope of Wendland's function of radius 1. A displacement by less than radius / slope does not fold space.
_STEEPEST = 2.11
# Slope of the displacement in one step of a deformation: far from 1, where space folds.
_STEP_SLOPE = 0.25
# Share of a displacement that a step leaves, so that places close together do not make the equations singular; with a
# tenth of it the surface comes as near to the points.
_LEFT = 1e-3


def wendland(distances: np.ndarray, radius: float) -> np.ndarray:
    """Wendland's function of compact support, C2 in space: 1 at a centre, 0 from the radius on.

    Parameters
    ----------
    distances : ndarray
        From a centre, mm.
    radius : float
        mm.

    Returns
    -------
    ndarray
        Same shape.

    References
    ----------
    H. Wendland: Piecewise polynomial, positive definite and compactly supported radial functions of minimal degree.
    Advances in Computational Mathematics 4, 389-396, 1995.
    """
    share = np.minimum(distances / radius, 1.0)
    return (1.0 - share) ** 4 * (4.0 * share + 1.0)


def deformed_through(closed: Parametrization, points: np.ndarray, radius: float) -> BSplineSurface:
    """Deform a surface so that it passes through points.

    Parameters
    ----------
    closed : Parametrization
        The surface, and how its control points may move.
    points : (n, 3) ndarray
        At least one, in the surface's frame, mm; no two that contradict each other.
    radius : float
        How far around a point space is moved, mm.

    Returns
    -------
    BSplineSurface
        With the same net. It passes the points nearly: what its net cannot follow is left.

    Notes
    -----
    The deformation is made of small steps, each an interpolation of displacements from the places of the surface that
    are nearest to the points now. A composition of maps that do not fold space does not fold it.
    """
    surface = closed.surface
    farthest = np.abs(closest_points(surface, points).distances).max()
    count = max(int(np.ceil(farthest * _STEEPEST / (_STEP_SLOPE * radius))), 2)
    for left in range(count, 0, -1):
        surface = _moved(closed.at(surface), points, radius, 1.0 / left)
    return surface


def _moved(closed: Parametrization, points: np.ndarray, radius: float, share: float) -> BSplineSurface:
    """Move a surface by a share of its way to the points."""
    feet = closest_points(closed.surface, points).points
    kernel = wendland(cdist(feet, feet), radius) + _LEFT * np.eye(len(feet))
    weights = np.linalg.solve(kernel, share * (points - feet))
    net = closed.surface.control_net
    flat = net.reshape(-1, 3)
    moved = flat + wendland(cdist(flat, feet), radius) @ weights
    return closed.deform(closed.fit(moved.reshape(net.shape)))
