"""The map of space that carries what no image shows: from the placed model's organs to the fitted ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import RBFInterpolator

from ..geometry.surface import BSplineSurface

# Parameters of each organ at which the map is given, around and from pole to pole.
_SAMPLES = (14, 10)
# Smoothing of the samples on organs, mm: from 1e-3 to 0.1 the errors of what is carried are the same to 0.01 mm.
_NUGGET = 1e-2
# And of landmarks, which are placed to 2 mm. Tried 0.01 to 200 on twelve known maps: up to 50 the floor is off by 1.3
# to 1.4 mm, with 200 by 1.6 mm.
_LANDMARK_NUGGET = 4.0
# Half the distance over which the map's derivatives are taken, mm.
_STEP_MM = 0.5


class CarryingMap:
    """Smoothest map of space that takes organs and landmarks of a model to those of an image.

    Parameters
    ----------
    source, target : mapping of str to BSplineSurface
        The same organs with the same nets: of the model, and as fitted; RAS mm.
    landmarks : (m, 3) ndarray, optional
        Of the model, RAS mm.
    places : (m, 3) ndarray, optional
        Where they are in the image, RAS mm.

    Notes
    -----
    Biharmonic radial basis functions (-r in space) with an affine part: of all maps through the samples they bend
    least, and far from these they go on as an affine map, where functions of compact support would fall back to it
    within a radius.
    """

    def __init__(
        self,
        source: Mapping[str, BSplineSurface],
        target: Mapping[str, BSplineSurface],
        *,
        landmarks: np.ndarray | None = None,
        places: np.ndarray | None = None,
    ) -> None:
        start, to = [], []
        for name, surface in target.items():
            parameters = surface.midpoints(*_SAMPLES)
            start.append(source[name].points(*parameters))
            to.append(surface.points(*parameters))
        nugget = np.full(sum(map(len, start)), _NUGGET)
        if landmarks is not None and len(landmarks):
            start.append(landmarks)
            to.append(places)
            nugget = np.append(nugget, np.full(len(landmarks), _LANDMARK_NUGGET))
        start, to = np.concatenate(start), np.concatenate(to)
        self._displacement = RBFInterpolator(start, to - start, kernel="linear", degree=1, smoothing=nugget)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Take points of the model, (n, 3) RAS mm, to the image."""
        points = np.asarray(points, dtype=float)
        return points + self._displacement(points)

    def determinants(self, points: np.ndarray) -> np.ndarray:
        """By how much the map enlarges space around points (n, 3), (n,); negative where it folds it."""
        points = np.asarray(points, dtype=float)
        steps = _STEP_MM * np.eye(3)
        ends = np.concatenate([points + sign * step for step in steps for sign in (1.0, -1.0)])
        ends = self(ends).reshape(3, 2, len(points), 3)
        return np.linalg.det(np.moveaxis(ends[:, 0] - ends[:, 1], 0, 1) / (2.0 * _STEP_MM))
