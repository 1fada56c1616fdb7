"""The drift limit: largest distance of a surface from the separated region, for images that show no edge.

A surface that has folded or exceeds the limit is refused. It is fitted again, held closer to the region; if that fails
too, the surface of an earlier stage is kept. A fit never ends with a surface that is no valid solid.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..imaging.moments import ball_radius
from ..messages import Diagnostic
from .choices import Choice
from .nets import net_of, net_text, sampled_net
from .region_image import RegionImage
from .region_surface import closed_surface
from .sample_grid import SampledSurface
from .schedule import Schedule
from .stages import Step, last_step

# Largest drift, as a share of the radius of a ball with the region's volume. The demo's organs and seven real bladders
# drift by 0.02 to 0.18, so that half and twice of the limit change nothing; hippocampi, which show no edge, drift by up
# to 0.59, where they fold.
_LARGEST_DRIFT = 0.5
# Number of samples of the surface in u and v.
_SAMPLES = (32, 20)
# Factor of the weights of bending and anchor for a surface that was refused. With it hippocampi stay within the limit.
# Surfaces that do not, such as a tube bent by 220 degrees that starts from an ellipsoid, do not with 100 either.
_CLOSER = 10.0


def drift(surface: BSplineSurface, region: RegionImage) -> Diagnostic | None:
    """Find out whether a surface has folded or is too far from the separated region.

    Parameters
    ----------
    surface : BSplineSurface
        In the frame of the region's image.
    region : RegionImage

    Returns
    -------
    Diagnostic or None
        None for a valid surface within the limit.
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
    found: Step, schedule: Schedule, template: SampledSurface, *, on_region: Step, fallback: Step, called: str
) -> Generator[Step, None, tuple[Step, tuple[Choice, ...]]]:
    """Keep a valid surface within the drift limit; otherwise fit to the grey levels again, held closer to the region.

    Parameters
    ----------
    found : Step
        Last step of the fit.
    schedule : Schedule
        Of that fit.
    template : SampledSurface
        Degrees of freedom and samples for its net.
    on_region : Step
        Last step of the stage on the region: the second fit starts from its surface, which is kept if that fit fails.
    fallback : Step
        Its surface is kept if that of the region is not valid either.
    called : str
        Name of the fallback for the user.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
    choices : tuple of Choice
        What was done, with reasons; empty if `found` is kept.
    """
    reason = drift(found.surface, schedule.region)
    if reason is None:
        return found, ()
    net = net_text(net_of(found.surface, schedule.options.closure))
    step, closer = on_region, schedule.closer(_CLOSER)
    for stage in (closer.coarse, closer.fine):
        # Names of stages must differ, and surfaces of more than one net may be refused.
        name = f"{stage.name}, {net}, held {_CLOSER:g} times closer"
        step = yield from last_step(replace(stage, name=name), template.at(step.surface))
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
    """Keep a surface that is a valid solid; otherwise make a closed surface of the region, with the first net.

    Parameters
    ----------
    found : Step
    schedule : Schedule
        Of its fit, with the first net.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
    choices : tuple of Choice
        What was done, with reasons; empty for a valid surface.
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
