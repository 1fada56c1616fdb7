"""Second separation of an organ, through boundary points that contradict the first fit.

Points far from the surface show that the separation has failed, because of a given threshold, or in an image that shows
two shapes. Then the surface of least cost that passes the points is found, star-shaped or along the organ's axis; it
needs neither a threshold nor the first surface. The organ is separated automatically from the middle of it. If the
points contradict that too, the region is that of the surface. A fit to the region replaces the first fit if it comes
near the points without being pulled by them, and has edges as clear as those of the first one. Then the points correct
it, see :mod:`.correction`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.morphology import boundary_voxels
from ..imaging.region import Region
from ..messages import Diagnostic
from ..segmentation.axis_surface import find_along_axis
from ..segmentation.edge_support import APART_MM, strengths_across
from ..segmentation.ray_surface import RaySurface
from ..segmentation.separation import separate
from ..segmentation.shaped_region import shaped_region
from ..segmentation.star_surface import find_star

# The organ is separated again if a point lies farther from the surface than this, mm.
_FAR_MM = 10.0
# The second fit must reduce the largest distance to at most this share. After a failed separation it was 0.46 at most,
# though an expert's contour differs from the grey levels at some points. Where a point beside a correct surface led to
# nearly the same surface, it was 0.5 to 1, and the second surface was better or worse by 0.4 mm at most.
_LEFT = 0.75
# Where the two surfaces are apart, the mean edge strength along the second one may be less than along the first one by
# at most this. After a failed separation it was larger by 0.1 to 0.75, and once the same, also with half and twice of
# `APART_MM`. Where a point beside a correct surface led to another one, it was smaller by 0.11 to 0.91, and once the
# same, because the point lay at another clear edge.
_LESS = 0.05
# Number of samples of a surface in u and v for this comparison.
_SAMPLES = (64, 48)


def contradicted(away: np.ndarray) -> bool:
    """Whether boundary points at distances (n,), mm, are so far from a surface that the separation may have failed."""
    return bool(away.max() > _FAR_MM)


@dataclass(frozen=True, eq=False)
class Restart:
    """An organ that was separated again through boundary points.

    Parameters
    ----------
    region : Region
        With a diagnostic `start_contradicted`.
    through : RaySurface
        The surface of least cost that passes the points.
    """

    region: Region
    through: RaySurface

    def replaces(
        self, image: Image, found: BSplineSurface, before: BSplineSurface, points: np.ndarray, away: np.ndarray
    ) -> bool:
        """Whether a fit to the region replaces the first fit.

        Parameters
        ----------
        image : Image
        found, before : BSplineSurface
            Surfaces of the fit to the region, before its correction by the points, and of the first fit, RAS mm.
        points : (n, 3) ndarray
            RAS mm.
        away : (n,) ndarray
            Their distances from the first surface, mm.

        Returns
        -------
        bool
            True if the second surface is nearer to the points by a quarter of the distance at least, and its edges are
            as clear as those of the first one where the two are apart.
        """
        left = np.abs(closest_points(found, points).distances)
        if left.max() > _LEFT * away.max():
            return False
        return self._strength(image, found, before) >= self._strength(image, before, found) - _LESS

    def _strength(self, image: Image, surface: BSplineSurface, other: BSplineSurface) -> float:
        """Mean edge strength along the part of a surface that is apart from another one; 1 if no part is."""
        u, v = surface.midpoints(*_SAMPLES)
        places = surface.points(u, v)
        apart = np.abs(closest_points(other, places).distances) > APART_MM
        strengths = strengths_across(image, places, surface.normals(u, v), self.through)[apart]
        inside = np.isfinite(strengths)
        return float(strengths[inside].mean()) if inside.any() else 1.0


def separated_through(image: Image, surface: BSplineSurface, points: np.ndarray, away: np.ndarray) -> Restart | None:
    """Separate an organ again, through boundary points.

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
    Restart or None
        None if no surface through the points encloses an organ.
    """
    inside = _in_volume(image, surface.control_net.mean(axis=(0, 1)))
    through = find_star(image, inside, points)
    region = shaped_region(image, through, inside)
    if _misses(through, points):
        # The organ may be long or bent, and both surfaces a part of it. The mean of the control points may be outside.
        middle = _in_volume(image, surface.points(*surface.midpoints(_SAMPLES[0], 1)).mean(axis=0))
        along = find_along_axis(image, find_star(image, middle), points)
        if along is not None and not _misses(along, points) and along.cost < through.cost:
            whole = shaped_region(image, along, middle)
            if whole is not None:
                region, through = whole, along
    if region is None:
        return None
    region = _automatic(image, through, points) or region
    contradiction = Diagnostic("start_contradicted", {"away_mm": float(away.max())})
    return Restart(replace(region, diagnostics=(*region.diagnostics, contradiction)), through)


def _automatic(image: Image, through: RaySurface, points: np.ndarray) -> Region | None:
    """Separate the organ from the middle of a surface through points; None if the points contradict the region."""
    # The rays are sorted along the axis, if there is one.
    middle = through.origins[len(through.origins) // 2]
    try:
        region = separate(image, middle)
    except ValueError:
        return None
    boundary = region.image.to_ras(boundary_voxels(region.mask)[:, ::-1].astype(float))
    return None if contradicted(cKDTree(boundary).query(points)[0]) else region


def _misses(surface: RaySurface, points: np.ndarray) -> bool:
    """Whether a surface through boundary points (n, 3), RAS mm, still lies as far from one as a failed separation."""
    return contradicted(np.abs(surface.inward(points)))


def _in_volume(image: Image, point: np.ndarray) -> np.ndarray:
    """Move a point (3,), RAS mm, to the nearest place of the volume along the axes of its grid."""
    return image.to_ras(np.clip(image.to_ijk(point[None]), 0.0, image.size - 1.0))[0]
