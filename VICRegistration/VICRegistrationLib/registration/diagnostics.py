"""Warnings about a region or a fitted surface, as codes with values."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image, patient_side
from ..imaging.moments import ball_radius
from ..imaging.morphology import boundary_voxels
from ..imaging.region import Region
from ..messages import Diagnostic
from .boundary_points import LARGEST_LEFT_MM
from .organ_fit import OrganFit

# Cost above which the image shows no clear edge.
_POOR_COST = 0.5
# Smallest share of the area without an edge that is reported; smaller shares come from noise.
_LEAST_WITHOUT_EDGE = 0.02
# Largest relative difference of volume between region and surface; the voxels at the surface alone make a few per cent.
_LARGEST_CHANGE = 0.2
# Largest distance of the region beyond the surface, in radii of a ball of the surface's volume. Good fits have 0.1.
_LARGEST_REACH = 0.2
# Number of samples of the surface in u and v for that distance.
_SAMPLES = (64, 48)


def fit_diagnostics(image: Image, fit: OrganFit) -> list[Diagnostic]:
    """Collect the warnings about a fit and its region.

    Parameters
    ----------
    image : Image
        The image that was fitted.
    fit : OrganFit

    Returns
    -------
    list of Diagnostic
    """
    edges = [*_without_edge(fit), *_points_without_edge(fit), *_points_left(fit)]
    return [*_invalid(fit), *_unconverged(fit), *_region(image, fit), *edges, *_unlike_region(fit), *_stacks(fit)]


def _stacks(fit: OrganFit) -> list[Diagnostic]:
    """Further stacks that were left out."""
    return [
        Diagnostic("stack_left_out", {"stack": stack.name, "reason": stack.reason})
        for stack in fit.stacks
        if not stack.used
    ]


def region_diagnostics(image: Image, region: Region) -> list[Diagnostic]:
    """Collect the warnings about a separated region, before a surface is fitted to it.

    Parameters
    ----------
    image : Image
        The image in which the organ was separated.
    region : Region

    Returns
    -------
    list of Diagnostic
    """
    sides = border_sides(image, region)
    return [*([Diagnostic("region_at_border", {"sides": sides})] if sides else []), *region.diagnostics]


def border_sides(image: Image, region: Region) -> list[str]:
    """Sides of the patient at which a region touches the border of its image.

    Parameters
    ----------
    image : Image
    region : Region

    Returns
    -------
    list of str
        Out of "left", "right", "posterior", "anterior", "inferior" and "superior".
    """
    return list(dict.fromkeys(_side(image, face) for face in region.touches_border))


def _side(image: Image, face: str) -> str:
    """Side of the patient at which a face of the volume, such as "k-", lies."""
    axis, sign = "ijk".index(face[0]), -1.0 if face[1] == "-" else 1.0
    outward = sign * image.ijk_to_ras[:3, axis]
    return patient_side(outward)


def _region(image: Image, fit: OrganFit) -> list[Diagnostic]:
    """Warnings about the region of a fit, and the share of the surface at the image's border."""
    region = fit.whole_region or fit.region
    if region is None:
        return []
    sides, share = border_sides(image, region), region.border_area / fit.surface.area()
    at_border = [Diagnostic("reaches_border", {"sides": sides, "share": share})] if sides else []
    return [*at_border, *region.diagnostics]


def _invalid(fit: OrganFit) -> list[Diagnostic]:
    """Reasons why the surface is no valid solid."""
    return [Diagnostic("invalid_surface", {"problem": problem.diagnostic}) for problem in fit.problems]


def _unconverged(fit: OrganFit) -> list[Diagnostic]:
    """Warn of a stage that did not converge."""
    if fit.converged:
        return []
    last = next(step for step in reversed(fit.history) if step.stopped_by and not step.converged)
    # A step "coarser net kept" repeats the surface of an earlier stage, which is the one that did not converge.
    last = next(step for step in fit.history if step.surface is last.surface)
    values = {"iterations": last.iteration, "stage": last.stage}
    if last.stopped_by == "no better point":
        return [Diagnostic("no_further_step", values)]
    return [Diagnostic("still_moving", {**values, "displacement_mm": float(last.displacement)})]


def _without_edge(fit: OrganFit) -> list[Diagnostic]:
    """Warn of an image that shows no edge, or none along a part of the surface."""
    found = []
    if fit.cost_final >= _POOR_COST:
        found.append(Diagnostic("no_clear_edge", {"cost": float(fit.cost_final)}))
    share, side = float(fit.confidence.unsupported_share), fit.confidence.unsupported_side
    if share >= _LEAST_WITHOUT_EDGE and side:
        found.append(Diagnostic("no_edge_at_side", {"share": share, "side": side}))
    elif share >= _LEAST_WITHOUT_EDGE:
        found.append(Diagnostic("no_edge_in_places", {"share": share}))
    return found


def _points_without_edge(fit: OrganFit) -> list[Diagnostic]:
    """Warn of boundary points at which the image shows no edge, for example because they lie on another organ."""
    points = len(fit.boundary_points)
    if not points:
        return []
    followed = fit.confidence.follows_edge(closest_points(fit.surface, fit.boundary_points).parameters)
    count = points - int(np.count_nonzero(followed))
    return [Diagnostic("points_without_edge", {"count": count, "points": points})] if count else []


def _points_left(fit: OrganFit) -> list[Diagnostic]:
    """Warn of boundary points that the surface misses by more than their weight explains."""
    if not len(fit.boundary_points):
        return []
    away = np.abs(closest_points(fit.surface, fit.boundary_points).distances)
    count = int(np.count_nonzero(away * min(fit.options.boundary_weight, 1.0) > LARGEST_LEFT_MM))
    values = {"count": count, "points": len(away), "left_mm": float(away.max())}
    return [Diagnostic("points_left", values)] if count else []


def _unlike_region(fit: OrganFit) -> list[Diagnostic]:
    """Warn of another volume than the region's, and of thin parts left out, which change the volume by little."""
    if fit.region is None:
        return []
    found = []
    volume, separated = float(fit.surface.volume()) / 1000.0, float((fit.whole_region or fit.region).volume_ml)
    if abs(volume - separated) > _LARGEST_CHANGE * separated:
        found.append(Diagnostic("volume_differs", {"surface_ml": volume, "region_ml": separated}))
    reach, side = _left_out(fit.surface, fit.whole_region or fit.region)
    if reach > _LARGEST_REACH * ball_radius(fit.surface.volume()):
        found.append(Diagnostic("part_left_out", {"reach_mm": reach, "side": side}))
    return found


def _left_out(surface: BSplineSurface, region: Region) -> tuple[float, str]:
    """Largest distance, mm, by which a region reaches beyond a surface, and the side of the organ where it does."""
    u, v = surface.midpoints(*_SAMPLES)
    points, normals = surface.points(u, v), surface.normals(u, v)
    voxels = region.image.to_ras(boundary_voxels(region.mask)[:, ::-1])
    distances, nearest = cKDTree(points).query(voxels)
    outside = np.einsum("nk,nk->n", voxels - points[nearest], normals[nearest]) > 0.0
    reach = np.where(outside, distances, 0.0)
    farthest = int(reach.argmax())
    return float(reach[farthest]), patient_side(voxels[farthest] - voxels.mean(axis=0))
