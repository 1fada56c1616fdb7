"""How far a surface may go from the separated region, for images that show no edge; and how far the region from it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..imaging.boxes import ball_radius
from ..imaging.image import patient_side
from ..imaging.region import Region
from ..imaging.sampling import Sampler
from ..messages import Diagnostic

# Share of the radius of a ball of the region's volume.
_LEASH = 0.5
_SAMPLES = (32, 20)
# Of the surface, where the region is held against it.
_DENSE_SAMPLES = (64, 48)


def astray(surface: BSplineSurface, distance: Sampler, volume: float) -> Diagnostic | None:
    """Tell whether a surface has folded or has gone too far from the separated region.

    Parameters
    ----------
    surface : BSplineSurface
    distance : Sampler
        Signed distance from the region's boundary, mm, in the surface's frame.
    volume : float
        Of the region, mm^3.

    Returns
    -------
    Diagnostic or None
        What is wrong with it, if anything is.
    """
    problems = check_surface(surface)
    if problems:
        return Diagnostic("no_valid_solid", {"kind": problems[0].kind})
    values, seen = distance.values(surface.points(*surface.midpoints(*_SAMPLES)))
    if not seen.all():
        return Diagnostic("left_surroundings")
    away = float(np.abs(values).max())
    if away > _LEASH * ball_radius(volume):
        return Diagnostic("far_from_region", {"away_mm": away})
    return None


def left_out(surface: BSplineSurface, region: Region) -> tuple[float, str]:
    """Find the part of the separated region that reaches farthest beyond a surface.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm, with outward normals.
    region : Region

    Returns
    -------
    reach : float
        mm; 0 if none does.
    side : str
        Side of the organ where that part lies, such as "superior".
    """
    u, v = surface.midpoints(*_DENSE_SAMPLES)
    points, normals = surface.points(u, v), surface.normals(u, v)
    rim = region.mask & ~ndimage.binary_erosion(region.mask)
    voxels = region.image.to_ras(np.argwhere(rim)[:, ::-1])
    distances, nearest = cKDTree(points).query(voxels)
    outside = np.einsum("nk,nk->n", voxels - points[nearest], normals[nearest]) > 0.0
    reach = np.where(outside, distances, 0.0)
    farthest = int(reach.argmax())
    return float(reach[farthest]), patient_side(voxels[farthest] - voxels.mean(axis=0))
