"""A start that boundary points contradict: the organ's shape is looked for again, through the points.

Points that lie far off show that the organ was not separated well: by a threshold that was given, or in an image that
shows two shapes. The star-shaped surface of least cost that passes the points needs no threshold and nothing of the
surface before. A fit to its region takes the place of the first one if it comes near the points, although they do not
pull it, is no other organ, and differs little where there are none. Then the points correct it, see :mod:`.correction`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.region import Region
from ..messages import Diagnostic
from ..segmentation.star_region import shaped_region

# A start may have failed where a point lies farther off than this, mm.
_FAR_MM = 10.0
# It has if the fit to another one leaves at most this share of the largest distance. Bladders whose start failed 0.25
# at most, one found well of which an expert leaves out tumours 0.75 and more.
_LEFT = 0.5
# And that fit differs little where no point is within so many times its distance: all but 5 % of it by less than this
# share of the largest distance. Bladders whose start failed 0.19 at most, a bent organ with cut ends 0.64.
_DISTANCES, _ELSEWHERE = 3.0, 0.35
# And one of the two surfaces holds this share of the other one, to within so many mm: another organ is not meant. Where
# a start failed, 0.98 and more; where a point beside a right one led to its neighbour, 0.67 at most.
_HELD, _WITHIN_MM = 0.85, 2.0
# Samples (u, v) of a surface by which that is judged.
_SAMPLES = (32, 20)


def contradicted(away: np.ndarray) -> bool:
    """Whether boundary points at distances (n,), mm, are so far from a surface that its start may have failed."""
    return bool(away.max() > _FAR_MM)


def region_through(image: Image, surface: BSplineSurface, points: np.ndarray, away: np.ndarray) -> Region | None:
    """Separate an organ by its shape alone: the star-shaped surface of least cost that passes boundary points.

    Parameters
    ----------
    image : Image
    surface : BSplineSurface
        Whose start has failed, RAS mm.
    points : (n, 3) ndarray
        RAS mm.
    away : (n,) ndarray
        Their distances from the surface, mm.

    Returns
    -------
    Region or None
        None where there is no such surface in the image.
    """
    center = surface.control_net.mean(axis=(0, 1))
    inside = image.to_ras(np.clip(image.to_ijk(center[None]), 0.0, image.size - 1.0))[0]
    found = shaped_region(image, inside, points)
    if found is None:
        return None
    region, _ = found
    contradiction = Diagnostic("start_contradicted", {"away_mm": float(away.max())})
    return replace(region, diagnostics=(*region.diagnostics, contradiction))


def explains(found: BSplineSurface, before: BSplineSurface, points: np.ndarray, away: np.ndarray) -> bool:
    """Whether a surface that boundary points have not pulled is the better one by them.

    Parameters
    ----------
    found, before : BSplineSurface
        Fitted to another start, and to the one that the points contradict, RAS mm.
    points : (n, 3) ndarray
        RAS mm.
    away : (n,) ndarray
        Their distances from the surface before, mm.

    Returns
    -------
    bool
        True where it is nearer to the points, holds the one before or is held by it, and is like it where there are no
        points.
    """
    left = np.abs(closest_points(found, points).distances)
    if left.max() > _LEFT * away.max():
        return False
    if max(_held(before, found), _held(found, before)) < _HELD:
        return False
    places = found.points(*found.midpoints(*_SAMPLES))
    beyond = (cdist(places, points) > _DISTANCES * away).all(axis=1)
    moved = np.abs(closest_points(before, places[beyond]).distances) if beyond.any() else np.zeros(1)
    return bool(np.percentile(moved, 95) < _ELSEWHERE * away.max())


def _held(surface: BSplineSurface, other: BSplineSurface) -> float:
    """Share of the places of a surface that lie inside of another one, or little beside it."""
    places = surface.points(*surface.midpoints(*_SAMPLES))
    return float((closest_points(other, places).distances < _WITHIN_MM).mean())
