"""Second separation of an organ, through boundary points that contradict the first fit.

Points far from the surface show that the separation has failed, because of a given threshold, or in an image that shows
two shapes. Then the surface of least cost that passes the points is found, star-shaped or along the organ's axis; it
needs neither a threshold nor the first surface. A fit to its region replaces the first fit if it comes near the points
without being pulled by them, is the same organ, and differs little where there are no points. Then the points correct
it, see :mod:`.correction`.
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
from ..segmentation.axis_surface import find_along_axis
from ..segmentation.ray_surface import RaySurface
from ..segmentation.shaped_region import shaped_region
from ..segmentation.star_surface import find_star

# The organ is separated again if a point lies farther from the surface than this, mm.
_FAR_MM = 10.0
# The second fit must reduce the largest distance to at most this share. Bladders with a failed separation had 0.25 at
# most; a bladder that was found well, but of which an expert leaves out tumours, had 0.75 and more.
_LEFT = 0.5
# Away from the points, by more than so many times each point's distance, 95 % of the second surface must differ from
# the first by less than this share of the largest distance. Bladders with a failed separation had 0.19 at most, a bent
# organ with cut ends 0.64.
_DISTANCES, _ELSEWHERE = 3.0, 0.35
# One of the two surfaces must contain this share of the other, with a tolerance in mm; otherwise they are different
# organs. After a failed separation it was 0.98 and more; where a point beside a correct surface led to the neighbouring
# organ, 0.67 at most.
_HELD, _WITHIN_MM = 0.85, 2.0
# Number of samples of a surface in u and v for these comparisons.
_SAMPLES = (32, 20)


def contradicted(away: np.ndarray) -> bool:
    """Whether boundary points at distances (n,), mm, are so far from a surface that the separation may have failed."""
    return bool(away.max() > _FAR_MM)


def region_through(image: Image, surface: BSplineSurface, points: np.ndarray, away: np.ndarray) -> Region | None:
    """Separate an organ by the surface of least cost that passes boundary points: star-shaped, or along its axis.

    Parameters
    ----------
    image : Image
    surface : BSplineSurface
        The surface that the points contradict, RAS mm.
    points : (n, 3) ndarray
        RAS mm.
    away : (n,) ndarray
        Their distances from the surface, mm.

    Returns
    -------
    Region or None
        None if no such surface is found.
    """
    inside = _in_volume(image, surface.control_net.mean(axis=(0, 1)))
    star = find_star(image, inside, points)
    region = shaped_region(image, star, inside)
    if _misses(star, points):
        # The organ may be long or bent, and both surfaces a part of it. The mean of the control points may be outside.
        middle = _in_volume(image, surface.points(*surface.midpoints(_SAMPLES[0], 1)).mean(axis=0))
        along = find_along_axis(image, find_star(image, middle), points)
        if along is not None and not _misses(along, points) and along.cost < star.cost:
            whole = shaped_region(image, along, middle)
            region = region if whole is None else whole
    if region is None:
        return None
    contradiction = Diagnostic("start_contradicted", {"away_mm": float(away.max())})
    return replace(region, diagnostics=(*region.diagnostics, contradiction))


def replaces(found: BSplineSurface, before: BSplineSurface, points: np.ndarray, away: np.ndarray) -> bool:
    """Whether the second fit replaces the first one.

    Parameters
    ----------
    found, before : BSplineSurface
        Surfaces of the second fit, before its correction by the points, and of the first fit, RAS mm.
    points : (n, 3) ndarray
        RAS mm.
    away : (n,) ndarray
        Their distances from the first surface, mm.

    Returns
    -------
    bool
        True if the second surface is much nearer to the points, contains the first one or is contained by it, and
        differs little from it away from the points.
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


def _misses(surface: RaySurface, points: np.ndarray) -> bool:
    """Whether a surface through boundary points (n, 3), RAS mm, still lies as far from one as a failed separation."""
    return contradicted(np.abs(surface.inward(points)))


def _in_volume(image: Image, point: np.ndarray) -> np.ndarray:
    """Move a point (3,), RAS mm, to the nearest place of the volume along the axes of its grid."""
    return image.to_ras(np.clip(image.to_ijk(point[None]), 0.0, image.size - 1.0))[0]


def _held(surface: BSplineSurface, other: BSplineSurface) -> float:
    """Share of the samples of a surface that lie inside of another one, with a tolerance."""
    places = surface.points(*surface.midpoints(*_SAMPLES))
    return float((closest_points(other, places).distances < _WITHIN_MM).mean())
