"""The map of space that moves the parts no image shows: from the organs of the model to the fitted ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.distance import cdist

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface

# Samples of each organ at which the map is known, around and from pole to pole.
_SAMPLES = (14, 10)
# Nuggets of the kriging, mm^2: variances of the samples along the normal, within the surface, and of landmarks, which
# are placed to 2 mm. The variance of the map itself is 1 mm^2 for each mm of distance. On seven known maps ligaments
# and fasciae are off by 2.0 mm in the mean from 800 to 6400 within the surface, by 2.3 mm with 400 in one round, by 2.7
# mm where both are 0.01. Landmarks from 4 to 32 give the same to 0.1 mm, and so do normals from 0.5 to 14; with less,
# space is compressed more beside sharp ends: to 0.12 of its size beside a real vagina with 4, 0.24 with 10, 0.28 with
# 16.
_NORMAL, _TANGENTIAL, _LANDMARK = 10.0, 1600.0, 4.0
# How often samples are matched with the surface; a third time changes the means by 0.01 mm.
_ROUNDS = 2
# Half the distance over which the map's derivatives are taken, mm.
_STEP_MM = 0.5


class CarryingMap:
    """Smoothest map of space from organs and landmarks of a model to those of an image.

    Parameters
    ----------
    source, target : mapping of str to BSplineSurface
        The organs of the model and the fitted organs, by the same names and with the same nets; RAS mm.
    landmarks : (m, 3) ndarray, optional
        Landmarks of the model, RAS mm.
    places : (m, 3) ndarray, optional
        Positions of these landmarks in the image, RAS mm.
    nugget : float
        Variance of the samples along the surface's normals, mm^2: the larger, the less the map bends at sharp ends of
        organs.

    Notes
    -----
    Biharmonic radial basis functions (-r in space) with an affine part: they have the least bending energy, and far
    from the samples they become affine slowly, while functions of compact support would do so within their radius.

    An image shows where a surface lies, but not which of its points corresponds to which point of the model: that
    follows from the energies of the fit. So a sample determines the map along the surface's normal, and hardly within
    the surface (kriging with a nugget for each direction). Then it is matched with the nearest point of the surface,
    and the map is computed again.
    """

    def __init__(
        self,
        source: Mapping[str, BSplineSurface],
        target: Mapping[str, BSplineSurface],
        *,
        landmarks: np.ndarray | None = None,
        places: np.ndarray | None = None,
        nugget: float = _NORMAL,
    ) -> None:
        organs = [_Organ(source[name], surface) for name, surface in target.items()]
        marks, there = (np.zeros((0, 3)) if given is None else np.asarray(given) for given in (landmarks, places))
        self._centers = np.concatenate([*(organ.start for organ in organs), marks])
        held = np.broadcast_to(_LANDMARK * np.eye(3), (len(marks), 3, 3))
        matched = [organ.as_fitted for organ in organs]
        for number in range(_ROUNDS):
            if number:
                matched = [organ.nearest(self(organ.start)) for organ in organs]
            to = np.concatenate([*(points for points, _ in matched), there])
            nuggets = np.concatenate([*(_nuggets(normals, nugget) for _, normals in matched), held])
            self._weights, self._linear = self._solved(to - self._centers, nuggets)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Map points of the model, (n, 3) RAS mm, to the image."""
        points = np.asarray(points, dtype=float)
        return points - cdist(points, self._centers) @ self._weights + self._affine(points) @ self._linear

    def _solved(self, displacements: np.ndarray, nuggets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the centres and coefficients of the affine part, for displacements (n, 3), nuggets (n, 3, 3)."""
        n = len(self._centers)
        kernel = np.kron(-cdist(self._centers, self._centers), np.eye(3)).reshape(n, 3, n, 3)
        kernel[np.arange(n), :, np.arange(n)] += nuggets
        affine = np.kron(self._affine(self._centers), np.eye(3))
        system = np.block([[kernel.reshape(3 * n, 3 * n), affine], [affine.T, np.zeros((12, 12))]])
        found = np.linalg.solve(system, np.append(displacements.ravel(), np.zeros(12))).reshape(-1, 3)
        return found[:n], found[n:]

    def _affine(self, points: np.ndarray) -> np.ndarray:
        """Return the terms of the affine part, (n, 4), scaled to the spread of the centres."""
        middle, size = self._centers.mean(axis=0), self._centers.std()
        return np.column_stack([np.ones(len(points)), (points - middle) / size])

    def determinants(self, points: np.ndarray) -> np.ndarray:
        """Jacobian determinants of the map at points (n, 3), (n,): negative where space is folded."""
        points = np.asarray(points, dtype=float)
        steps = _STEP_MM * np.eye(3)
        ends = np.concatenate([points + sign * step for step in steps for sign in (1.0, -1.0)])
        ends = self(ends).reshape(3, 2, len(points), 3)
        return np.linalg.det(np.moveaxis(ends[:, 0] - ends[:, 1], 0, 1) / (2.0 * _STEP_MM))


class _Organ:
    """Samples of an organ of the model, and the fitted surface."""

    def __init__(self, source: BSplineSurface, target: BSplineSurface) -> None:
        parameters = source.midpoints(*_SAMPLES)
        self.start = source.points(*parameters)
        self.as_fitted = target.points(*parameters), target.normals(*parameters)
        self._target = target

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the fitted surface that are nearest to given ones, (n, 3), and the normals there."""
        found = closest_points(self._target, points)
        return found.points, self._target.normals(*found.parameters.T)


def _nuggets(normals: np.ndarray, nugget: float) -> np.ndarray:
    """Covariances of samples, (n, 3, 3), from normals (n, 3) and the variance along them."""
    along = normals[:, :, None] * normals[:, None, :]
    return _TANGENTIAL * np.eye(3) + (nugget - _TANGENTIAL) * along
