"""Typical grey levels on both sides of an organ's boundary."""

from __future__ import annotations

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler
from .options import FitOptions
from .region_image import RegionImage
from .virtual_image import INSIDE_PROBES, OUTSIDE_PROBES, PROBE_DEPTHS

# Number of normal lines in u and v along which grey levels are measured.
_SAMPLES = (24, 16)


def levels_of_region(target: RegionImage, sampler: Sampler, reach: float, options: FitOptions) -> tuple[float, float]:
    """Return typical grey levels just inside and just outside of a region, or those that the user gave.

    Parameters
    ----------
    target : RegionImage
    sampler : Sampler
        The image, in the organ's frame.
    reach : float
        Voxels within this distance from the boundary count, mm.
    options : FitOptions

    Returns
    -------
    inside, outside : float

    Raises
    ------
    ValueError
        If the image shows only one side of the boundary.
    """
    distance = target.distance
    k, j, i = np.nonzero(np.abs(distance.array) <= reach)
    values, valid = sampler.values(distance.to_ras(np.column_stack([i, j, k])))
    away = distance.array[k, j, i]
    inside = values[valid & (away < 0.0)]
    outside = values[valid & (away > 0.0)]
    if not len(inside) or not len(outside):
        msg = (
            "The region fills the volume up to its border; the image must show what lies around the organ. Take a "
            "larger image, or check the threshold."
        )
        raise ValueError(msg)
    if options.levels == "given":
        return options.inside, options.outside
    return float(np.median(inside)), float(np.median(outside))


def measured_levels(surface: BSplineSurface, sampler: Sampler, tau: float) -> tuple[float, float]:
    """Measure typical grey levels just inside and just outside of a surface.

    Parameters
    ----------
    surface : BSplineSurface
    sampler : Sampler
        The image, in the frame of the surface.
    tau : float
        Width of the edge, mm.

    Returns
    -------
    inside, outside : float
        Medians over the surface.

    Raises
    ------
    ValueError
        If the surface lies outside of the volume.
    """
    u, v = surface.midpoints(*_SAMPLES)
    points, normals = surface.points(u, v), surface.normals(u, v)
    medians = []
    for depths in (PROBE_DEPTHS[INSIDE_PROBES], PROBE_DEPTHS[OUTSIDE_PROBES]):
        values, valid = sampler.values(points[:, None] + tau * depths[:, None] * normals[:, None])
        if not valid.any():
            msg = "The surface lies outside of the volume; choose the volume that it was fitted in."
            raise ValueError(msg)
        medians.append(float(np.median(values[valid])))
    return medians[0], medians[1]
