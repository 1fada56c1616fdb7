"""Automatic choice of tau, smoothness and anchor, from the image along a surface that lies near the edge.

- *tau* is the width of the edge in the image.
- *smoothness* grows with the mean squared residual, which comes from noise and uneven tissue alike, and falls with the
  number of voxels along the surface.
- *anchor*, the weight against leaving the surface with which a stage begins, grows with the residual too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.surface import BSplineSurface
from ..messages import Diagnostic
from .edge_width import edge_width
from .nets import sampled
from .options import LEAST_TAU_PIXELS, MOST_TAU_PIXELS, TAU_PIXELS, FitOptions
from .schedule import Schedule
from .stages import Step

# Smoothness for a mean squared residual of 1 in one voxel. It is divided by the square root of the number of voxels, a
# compromise: the influence of noise falls with that number, that of uneven tissue does not. Larger values remove the
# wrinkles of a net that is finer than the organ, and then the organ's own folds. Tried 0.6 to 2.4 on phantoms and real
# bladders; and 120 divided by the number itself, with which two of five seeds in a real bladder (p5) gave a surface
# beyond the drift limit.
_SMOOTHNESS = 1.2
# Largest factor of the smoothness with several stacks. There each line has most of its weight in the stack that shows
# its edge sharply, so that the cost is low, and fewer voxels than counted determine the line. Tried on the demo's
# organs in three stacks: a mean error of 0.043 mm with 1, 0.040 with 4, 0.037 with 16, where the bladder's grows. With
# 1, fine nets ripple at poles: there the rectum's normals are off by up to 7.9 degrees, with 6 by up to 5.1.
_SEVERAL = 6.0
# Weight against leaving the separated region for a mean squared residual of 1. It is proportional to the square of the
# mean squared residual: the larger that is, the less exactly the image shows the edge, and the more likely the edge is
# that of something else. Tried 400 to 600, and 10 to 100 without the square, on phantoms and real bladders: with less
# the surface stops short of thin grey rims, with more corners are cut off and the terraces of the slices remain.
_ANCHOR = 600.0
# Least value of one of the two residuals that are multiplied for that square. In a clear image the anchor would be
# nearly 0 otherwise, and nothing else holds the surface beyond the end of a volume: surfaces of clear images that are
# cut in the middle reach 1.7 mm beyond it.
_CLEAREST = 1.0 / 60.0


@dataclass(frozen=True)
class Choice:
    """An option that was chosen, or given by the user.

    Parameters
    ----------
    option, value : str
    reasons : tuple of Diagnostic
    """

    option: str
    value: str
    reasons: tuple[Diagnostic, ...]


def choose_beside(
    surface: BSplineSurface, schedule: Schedule, asked: FitOptions
) -> tuple[Schedule, tuple[Choice, ...]]:
    """Choose tau by a given surface; smoothness keeps its initial value.

    Parameters
    ----------
    surface : BSplineSurface
        Near the edge, in the frame of the schedule.
    schedule : Schedule
    asked : FitOptions
        As given by the user.

    Returns
    -------
    schedule : Schedule
        With that tau.
    choices : tuple of Choice
    """
    tau, why = _tau(surface, schedule, asked)
    smoothness, known = schedule.options.smoothness, asked.smoothness is not None
    reason = Diagnostic("option_given" if known else "smoothness_to_start")
    return schedule.chosen(tau=tau), _choices(tau, why, smoothness, reason)


def choose_by(step: Step, schedule: Schedule, asked: FitOptions) -> tuple[Schedule, tuple[Choice, ...]]:
    """Choose tau, smoothness and anchor by the result of a first stage on the grey levels.

    Parameters
    ----------
    step : Step
        Last step of that stage.
    schedule : Schedule
    asked : FitOptions
        As given by the user.

    Returns
    -------
    schedule : Schedule
        With them.
    choices : tuple of Choice
    """
    tau, why = _tau(step.surface, schedule, asked)
    schedule = schedule.chosen(tau=tau, anchor=_ANCHOR * step.cost * max(step.cost, _CLEAREST))
    if asked.smoothness is not None:
        return schedule, _choices(tau, why, asked.smoothness, Diagnostic("option_given"))
    voxels = schedule.voxels_along(step.surface)
    smoothness = _by_stacks(step, schedule) * _SMOOTHNESS * step.cost / np.sqrt(voxels)
    # Two digits of the number of voxels are enough.
    noise = {"share": float(np.sqrt(step.cost)), "voxels": int(float(f"{voxels:.2g}"))}
    return schedule.chosen(smoothness=smoothness), _choices(tau, why, smoothness, Diagnostic("noise_along_edge", noise))


def _by_stacks(step: Step, schedule: Schedule) -> float:
    """Factor of the smoothness with several stacks; it grows with the weight of the further stacks."""
    if not schedule.views:
        return 1.0
    first, *_ = schedule.coarse.correlations(sampled(step.surface, schedule.options.closure))
    area = first.surface.frame(np.zeros(first.surface.n_dof)).area
    return float(_SEVERAL ** min(1.0, 2.0 * (1.0 - area @ first.share)))


def _choices(tau: float, why_tau: Diagnostic, smoothness: float, why_smoothness: Diagnostic) -> tuple[Choice, ...]:
    return (
        Choice("tau", f"{tau:.2f} mm", (why_tau,)),
        Choice("smoothness", f"{smoothness:.2g}", (why_smoothness,)),
    )


def _tau(surface: BSplineSurface, schedule: Schedule, asked: FitOptions) -> tuple[float, Diagnostic]:
    """Return tau and the reason for it."""
    if asked.tau is not None:
        return asked.tau, Diagnostic("option_given")
    pixel = schedule.pixel
    width = edge_width(schedule.sampler, surface, schedule.voxel)
    if width is None:
        return TAU_PIXELS * pixel, Diagnostic("no_edge_width", {"pixels": TAU_PIXELS})
    tau = float(np.clip(width, LEAST_TAU_PIXELS * pixel, MOST_TAU_PIXELS * pixel))
    found = {"width_mm": float(width), "pixels": float(width) / pixel}
    if tau == width:
        return tau, Diagnostic("edge_width", found)
    return tau, Diagnostic("edge_width_limited", {**found, "least": LEAST_TAU_PIXELS, "most": MOST_TAU_PIXELS})
