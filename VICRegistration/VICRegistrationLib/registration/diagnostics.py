"""What a user should look at before trusting a region or a surface, as codes with their values."""

from __future__ import annotations

import numpy as np

from ..geometry.projection import closest_points
from ..imaging.boxes import ball_radius
from ..imaging.image import Image, patient_side
from ..imaging.region import Region
from ..messages import Diagnostic
from .boundary_points import LARGEST_LEFT_MM
from .organ_fit import OrganFit

# Mean squared difference between the image and an edge, over the squared contrast.
_POOR_COST = 0.5
# Of the area; less is drowned in noise.
_LEAST_WITHOUT_EDGE = 0.02
# Between the separated region and the surface; voxels at the surface alone make a few per cent.
_LARGEST_CHANGE = 0.2
# How far the region may reach beyond the surface, in radii of a ball of its volume. Seen: 0.1 where all is well.
_LARGEST_REACH = 0.2


def fit_diagnostics(image: Image, fit: OrganFit) -> list[Diagnostic]:
    """Find what looks wrong about a fit and its region.

    Parameters
    ----------
    image : Image
        The image that was fitted.
    fit : OrganFit

    Returns
    -------
    list of Diagnostic
        Empty if nothing is known to be wrong.
    """
    shown = [*_without_edge(fit), *_points_without_edge(fit), *_points_left(fit)]
    return [*_invalid(fit), *_unconverged(fit), *_region(image, fit), *shown, *_unlike_region(fit), *_stacks(fit)]


def _stacks(fit: OrganFit) -> list[Diagnostic]:
    """Which further stacks were left out."""
    return [
        Diagnostic("stack_left_out", {"stack": stack.name, "reason": stack.reason})
        for stack in fit.stacks
        if not stack.used
    ]


def region_diagnostics(image: Image, region: Region) -> list[Diagnostic]:
    """Find what looks wrong about a separated region, before a surface is fitted to it.

    Parameters
    ----------
    image : Image
        The image that holds the region.
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
    """Side of the patient that a face of the volume such as "k-" looks to."""
    axis, sign = "ijk".index(face[0]), -1.0 if face[1] == "-" else 1.0
    outward = sign * image.ijk_to_ras[:3, axis]
    return patient_side(outward)


def _region(image: Image, fit: OrganFit) -> list[Diagnostic]:
    """Describe what looks wrong about the region of a fit, and how much of the surface the image's border cuts."""
    region = fit.whole_region or fit.region
    if region is None:
        return []
    sides, share = border_sides(image, region), region.border_area / fit.surface.area()
    at_border = [Diagnostic("reaches_border", {"sides": sides, "share": share})] if sides else []
    return [*at_border, *region.diagnostics]


def _invalid(fit: OrganFit) -> list[Diagnostic]:
    """Why the surface is no valid solid."""
    return [Diagnostic("invalid_surface", {"problem": problem.diagnostic}) for problem in fit.problems]


def _unconverged(fit: OrganFit) -> list[Diagnostic]:
    """How the stage ended that did not converge."""
    if fit.converged:
        return []
    last = next(step for step in reversed(fit.history) if step.stopped_by and not step.converged)
    # Where the surface of a coarser net is kept, the stage that ended with it did not converge.
    last = next(step for step in fit.history if step.surface is last.surface)
    values = {"iterations": last.iteration, "stage": last.stage}
    if last.stopped_by == "no better point":
        return [Diagnostic("no_further_step", values)]
    return [Diagnostic("still_moving", {**values, "displacement_mm": float(last.displacement)})]


def _without_edge(fit: OrganFit) -> list[Diagnostic]:
    """Where the image does not show where the surface is."""
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
    """Boundary points that the image contradicts: a point on another organ takes the surface there too."""
    points = len(fit.boundary_points)
    if not points:
        return []
    followed = fit.confidence.follows_edge(closest_points(fit.surface, fit.boundary_points).parameters)
    count = points - int(np.count_nonzero(followed))
    return [Diagnostic("points_without_edge", {"count": count, "points": points})] if count else []


def _points_left(fit: OrganFit) -> list[Diagnostic]:
    """Boundary points that the surface does not pass, although their weight asks for it."""
    if not len(fit.boundary_points):
        return []
    away = np.abs(closest_points(fit.surface, fit.boundary_points).distances)
    count = int(np.count_nonzero(away * min(fit.options.boundary_weight, 1.0) > LARGEST_LEFT_MM))
    values = {"count": count, "points": len(away), "left_mm": float(away.max())}
    return [Diagnostic("points_left", values)] if count else []


def _unlike_region(fit: OrganFit) -> list[Diagnostic]:
    """Where the surface is not that of the region: thin parts that it leaves out change the volume by little."""
    if fit.region is None:
        return []
    found = []
    volume, separated = float(fit.surface.volume()) / 1000.0, float((fit.whole_region or fit.region).volume_ml)
    if abs(volume - separated) > _LARGEST_CHANGE * separated:
        found.append(Diagnostic("volume_differs", {"surface_ml": volume, "region_ml": separated}))
    reach, side = fit.left_out
    if reach > _LARGEST_REACH * ball_radius(fit.surface.volume()):
        found.append(Diagnostic("part_left_out", {"reach_mm": reach, "side": side}))
    return found
