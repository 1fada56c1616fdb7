"""How far a surface may go from the separated region, for images that show no edge; and how far the region from it.

A surface that has folded, or has gone beyond the limit, is refused: it is fitted again, held closer to the region, and
in the end the region's own surface is kept. No fit ends with a surface that is no valid solid.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..imaging.boxes import ball_radius
from ..imaging.image import patient_side
from ..imaging.morphology import boundary_voxels
from ..imaging.region import Region
from ..messages import Diagnostic
from .choices import Choice
from .nets import net_of, net_text, sampled_net
from .region_image import RegionImage
from .region_surface import closed_surface
from .sample_grid import SampledSurface
from .schedule import Schedule
from .stages import Step, last_step

# Largest drift, as a share of the radius of a ball of the region's volume. The demo's organs and seven real bladders
# drift by 0.02 to 0.18 of it, so that half and twice as much change nothing; hippocampi, which show no edge, by up to
# 0.59, where they fold.
_LARGEST_DRIFT = 0.5
_SAMPLES = (32, 20)
# Of the surface, where the region is compared with it.
_DENSE_SAMPLES = (64, 48)
# How many times closer to the region a surface is held that has been refused. Hippocampi stay in their place with it.
# What does not, such as a tube bent by 220 degrees that starts from an ellipsoid, does not with 100 times either.
_CLOSER = 10.0


def drift(surface: BSplineSurface, region: RegionImage) -> Diagnostic | None:
    """Find out whether a surface has folded or has gone too far from the separated region.

    Parameters
    ----------
    surface : BSplineSurface
        In the frame of the region's image.
    region : RegionImage

    Returns
    -------
    Diagnostic or None
        What is wrong with it, if anything is.
    """
    problems = check_surface(surface)
    if problems:
        return Diagnostic("no_valid_solid", {"kind": problems[0].kind})
    values, seen = region.sampler.values(surface.points(*surface.midpoints(*_SAMPLES)))
    if not seen.all():
        return Diagnostic("left_surroundings")
    away = float(np.abs(values).max())
    if away > _LARGEST_DRIFT * ball_radius(region.volume):
        return Diagnostic("far_from_region", {"away_mm": away})
    return None


def within_drift_limit(
    found: Step, schedule: Schedule, space: SampledSurface, *, on_region: Step, fallback: Step, called: str
) -> Generator[Step, None, tuple[Step, tuple[Choice, ...]]]:
    """Keep a surface that is in its place; otherwise fit the grey levels again, held closer to the region.

    Parameters
    ----------
    found : Step
        The surface as it was fitted.
    schedule : Schedule
        By which it was fitted.
    space : SampledSurface
        Of its net.
    on_region : Step
        Surface of the region, from which to fit again, and which is kept if the image holds none.
    fallback : Step
        A surface to keep if not even that of the region is a valid one in its place.
    called : str
        What that is called.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
    choices : tuple of Choice
        What was done, and why; none for a surface in its place.
    """
    reason = drift(found.surface, schedule.region)
    if reason is None:
        return found, ()
    net = net_text(net_of(found.surface, schedule.options.closure))
    step, closer = on_region, schedule.closer(_CLOSER)
    for stage in (closer.coarse, closer.fine):
        # Stages are known by their names, and surfaces of more than one net may be refused.
        name = f"{stage.name}, {net}, held {_CLOSER:g} times closer"
        step = yield from last_step(replace(stage, name=name), space.at(step.surface))
    if drift(step.surface, schedule.region) is None:
        done = Diagnostic("held_closer", {"net": net, "factor": _CLOSER})
        return step, (Choice("drift limit", f"{_CLOSER:g} times closer", (reason, done)),)
    valid = drift(on_region.surface, schedule.region) is None
    what, kept = ("surface of the region", on_region) if valid else (called, fallback)
    kept = replace(kept, stage=f"{what} kept, {net}", iteration=1, displacement=0.0)
    yield kept
    done = Diagnostic("surface_kept", {"net": net, "kept": what})
    return kept, (Choice("drift limit", f"{what} kept", (reason, done)),)


def valid_at_last(found: Step, schedule: Schedule) -> Generator[Step, None, tuple[Step, tuple[Choice, ...]]]:
    """Keep a surface that is a valid solid; otherwise take the region's own closed surface, with the first net.

    Parameters
    ----------
    found : Step
    schedule : Schedule
        By which it was fitted, with the first net.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
    choices : tuple of Choice
        What was done, and why; none for a valid surface.
    """
    problems = check_surface(found.surface)
    if not problems:
        return found, ()
    net, closure = schedule.options.net, schedule.options.closure
    surface = closed_surface(schedule.region.distance, net, closure)
    cost = schedule.fine.cost_of(sampled_net(net, closure).at(surface), surface)
    step = Step("closed surface of the region kept", 1, cost, 0.0, surface, "displacement")
    yield step
    reasons = (
        Diagnostic("no_valid_solid", {"kind": problems[0].kind}),
        Diagnostic("surface_kept", {"net": net_text(net), "kept": "closed surface of the region"}),
    )
    return step, (Choice("drift limit", step.stage, reasons),)


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
    voxels = region.image.to_ras(boundary_voxels(region.mask)[:, ::-1])
    distances, nearest = cKDTree(points).query(voxels)
    outside = np.einsum("nk,nk->n", voxels - points[nearest], normals[nearest]) > 0.0
    reach = np.where(outside, distances, 0.0)
    farthest = int(reach.argmax())
    return float(reach[farthest]), patient_side(voxels[farthest] - voxels.mean(axis=0))
