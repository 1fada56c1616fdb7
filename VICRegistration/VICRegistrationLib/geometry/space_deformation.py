"""Smooth deformations of space by radial basis functions, to move a surface through points without folding it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial.distance import cdist

from .parametrization import Parametrization
from .projection import closest_points
from .surface import BSplineSurface

# Steepest slope of Wendland's function of radius 1. A displacement by less than radius / slope does not fold space.
_STEEPEST = 2.11
# Largest slope of the displacement in one step of a deformation: far below 1, where space folds.
_STEP_SLOPE = 0.25
# Two points contradict each other if their feet on the surface are closer than the first, mm, and the wall between them
# would be steeper than the second, because a normal meets the wall only once. If the feet are farther apart, a step of
# the wall can pass both: without the first limit, two of seven bladders with up to 16 points miss some by 6 mm. With
# half of it nothing changes there, with twice of it one point is missed by 2 mm.
_ONE_NORMAL, _STEEPEST_WALL = 0.5, 3.0
# Points closer to each other than this, mm, are one point, clicked twice.
_SAME = 0.1
# Regularisation: about the share of a displacement that a step leaves, so that feet close together do not make the
# equations singular; with a tenth of it the surface comes as near to the points.
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


@dataclass(frozen=True, eq=False)
class CardinalDeformation:
    """A deformation of space x + sum_i E_i(x) q_i, whose degrees of freedom q_i are the displacements of its centres.

    The cardinal functions E_i are combinations of Wendland's functions at all centres and an affine part: E_i is 1 at
    its own centre and 0 at the others, and together they reproduce every affine map.

    Parameters
    ----------
    centers : (n, 3) ndarray
        RAS mm, at least four, not in one plane.
    radius : float
        Of Wendland's function, mm.
    """

    centers: np.ndarray
    radius: float

    def matrix(self, points: np.ndarray) -> np.ndarray:
        """Values of the functions at points.

        Parameters
        ----------
        points : (m, 3) ndarray
            RAS mm.

        Returns
        -------
        (m, n) ndarray
            Its product with displacements of the centres, (n, 3) mm, gives those of the points.
        """
        return self._terms(points) @ self._coefficients

    def _terms(self, points: np.ndarray) -> np.ndarray:
        """Wendland's functions and the affine part, (m, n + 4)."""
        middle = self.centers.mean(axis=0)
        affine = np.column_stack([np.ones(len(points)), (points - middle) / self.radius])
        return np.hstack([wendland(cdist(points, self.centers), self.radius), affine])

    @cached_property
    def _coefficients(self) -> np.ndarray:
        """Coefficients of the terms in each function, (n + 4, n)."""
        n = len(self.centers)
        terms = self._terms(self.centers)
        system = np.zeros((n + 4, n + 4))
        system[:n], system[n:, :n] = terms, terms[:, n:].T
        return np.linalg.solve(system, np.eye(n + 4, n))


def deformed_through(closed: Parametrization, points: np.ndarray, radius: float) -> BSplineSurface:
    """Deform a surface so that it passes through points.

    Parameters
    ----------
    closed : Parametrization
        The surface, and how its control points may move.
    points : (n, 3) ndarray
        At least one, in the surface's frame, mm.
    radius : float
        Radius around a point within which space is moved, mm.

    Returns
    -------
    BSplineSurface
        With the same net. It passes the points as nearly as this net allows.

    Notes
    -----
    The deformation consists of small steps that do not fold space; neither does their composition. Each step
    interpolates displacements of the feet, the present places of the surface nearest to the points. In each step,
    points that contradict each other are replaced by their mean: the points in a lobe that the surface has not reached
    may have the same foot at first, and different ones later.
    """
    surface = closed.surface
    farthest = np.abs(closest_points(surface, points).distances).max()
    count = max(int(np.ceil(farthest * _STEEPEST / (_STEP_SLOPE * radius))), 2)
    for left in range(count, 0, -1):
        surface = _moved(closed.at(surface), points, radius, 1.0 / left)
    return surface


def agreeing(surface: BSplineSurface, points: np.ndarray) -> np.ndarray:
    """Replace points that repeat or contradict each other by their mean.

    Parameters
    ----------
    surface : BSplineSurface
    points : (n, 3) ndarray
        In the frame of the surface, mm.

    Returns
    -------
    (m, 3) ndarray
        mm.
    """
    feet = closest_points(surface, points)
    apart, rise = cdist(feet.points, feet.points), np.abs(np.subtract.outer(feet.distances, feet.distances))
    contradict = (apart < _ONE_NORMAL) & (rise > _STEEPEST_WALL * apart)
    joined = contradict | (apart < _SAME)
    number, place = csgraph.connected_components(sparse.csr_matrix(joined), directed=False)
    return np.stack([points[place == group].mean(axis=0) for group in range(number)])


def _moved(closed: Parametrization, points: np.ndarray, radius: float, share: float) -> BSplineSurface:
    """Move a surface by a share of its distance to the points."""
    points = agreeing(closed.surface, points)
    feet = closest_points(closed.surface, points).points
    kernel = wendland(cdist(feet, feet), radius) + _LEFT * np.eye(len(feet))
    weights = np.linalg.solve(kernel, share * (points - feet))
    net = closed.surface.control_net
    flat = net.reshape(-1, 3)
    moved = flat + wendland(cdist(flat, feet), radius) @ weights
    return closed.deform(closed.fit(moved.reshape(net.shape)))
