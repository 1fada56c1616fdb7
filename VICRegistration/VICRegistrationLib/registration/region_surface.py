"""A closed surface made of a region alone, smoothed until it is a valid solid; taken if every fit has folded."""

from __future__ import annotations

import numpy as np

from ..geometry.models import drawn
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..imaging.image import Image
from ..imaging.sampling import Sampler

# Standard deviations of the Gaussian that smooths the radii, radians, tried until the surface is valid; the last one
# gives a ball.
_WIDTHS = (0.15, 0.3, 0.5, 0.8, np.inf)
# Samples along each ray.
_SAMPLES = 200


def closed_surface(distance: Image, net: tuple[int, int], closure: str) -> BSplineSurface:
    """Make a valid star-shaped surface of a region, with its centre at the place farthest from the boundary.

    Parameters
    ----------
    distance : Image
        Signed distance from the region's boundary, mm, negative inside.
    net : (rows, columns)
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface
        In the frame of the image, with outward normals.
    """
    k, j, i = np.unravel_index(distance.array.argmin(), distance.array.shape)
    center = distance.to_ras(np.array([[i, j, k]], dtype=float))[0]
    surface = None
    for width in _WIDTHS:
        surface = drawn(lambda ball, width=width: _placed(distance, center, ball, width), net, closure=closure)
        if not check_surface(surface):
            break
    return surface


def _placed(distance: Image, center: np.ndarray, ball: np.ndarray, width: float) -> np.ndarray:
    """Map points of the unit sphere (n, 3) to the region's boundary, with radii smoothed by a width in radians."""
    directions = ball / np.linalg.norm(ball, axis=1, keepdims=True)
    longest = np.linalg.norm(distance.spacing * distance.size)
    along = np.linspace(0.0, longest, _SAMPLES)
    values, seen = Sampler(distance).values(center + directions[:, None] * along[:, None])
    radii = along[((values >= 0.0) | ~seen).argmax(axis=1)]
    angles = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))
    weights = np.exp(-0.5 * (angles / width) ** 2)
    return center + directions * (weights @ radii / weights.sum(axis=1))[:, None]
