"""What a fit chooses by what the image shows across a surface that lies near the edge, and why.

- *tau* is the width of the edge in the image.
- *smoothness* follows the noise: what the image differs from the profile by, noise and uneven tissue alike, and in how
  many voxels that was seen.
- *anchor*, the weight against leaving the surface where a stage begins, follows it too.
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

# Smoothness for a mean squared residual of 1 seen in one voxel. It shrinks with the square root of the number of
# voxels: noise averages out as fast as that number grows, uneven tissue does not. More takes the wrinkles out of a net
# that is finer than the organ, and then its folds. Tried 0.6 to 2.4 on phantoms and real bladders; and 120 without the
# root, with which two of five seeds in a real bladder (p5) gave a surface that went beyond the drift limit.
_SMOOTHNESS = 1.2
# So many times smoother with several stacks: each line counts mostly in the stack that shows its edge sharply, so that
# the cost is low, and the voxels that determine it are few of all. Tried on the demo's organs in three stacks: a mean
# error of 0.043 mm with 1, 0.040 with 4, 0.037 with 16, where the bladder's grows. With 1, fine nets ripple at poles:
# there the rectum's normals are off by up to 7.9 degrees, with 6 by up to 5.1.
_SEVERAL = 6.0
# Weight against leaving the separated region for a mean squared residual of 1: the less the image looks like an edge,
# the more the region counts. It grows with the square of that residual: the larger that is, the less exactly the image
# shows the edge, and the more likely it shows something else. Tried 400 to 600, and 10 to 100 without the square, on
# phantoms and real bladders: less lets the surface stop short of thin grey rims, more cuts corners and lets the
# terraces.
_ANCHOR = 600.0
# No image is taken for clearer than this mean squared residual: where the volume cuts an organ, nothing else holds it.
# Without this, surfaces of clear images that are cut in the middle reach 1.7 mm beyond the volume's end.
_CLEAREST = 1.0 / 60.0


@dataclass(frozen=True)
class Choice:
    """An option that was chosen, or given by the user.

    Parameters
    ----------
    option, value : str
    reasons : tuple of Diagnostic
        Why it is that.
    """

    option: str
    value: str
    reasons: tuple[Diagnostic, ...]


def choose_beside(
    surface: BSplineSurface, schedule: Schedule, asked: FitOptions
) -> tuple[Schedule, tuple[Choice, ...]]:
    """Choose tau by a surface that is there already; smoothness is that to start with.

    Parameters
    ----------
    surface : BSplineSurface
        Near the edge, in the frame of the schedule.
    schedule : Schedule
    asked : FitOptions
        What the user asked for.

    Returns
    -------
    schedule : Schedule
        With the tau.
    choices : tuple of Choice
    """
    tau, why = _tau(surface, schedule, asked)
    smoothness, known = schedule.options.smoothness, asked.smoothness is not None
    reason = Diagnostic("option_given" if known else "smoothness_to_start")
    return schedule.chosen(tau=tau), _choices(tau, why, smoothness, reason)


def choose_by(step: Step, schedule: Schedule, asked: FitOptions) -> tuple[Schedule, tuple[Choice, ...]]:
    """Choose tau, smoothness and anchor by what a first stage on the grey levels has come to.

    Parameters
    ----------
    step : Step
        Its last one.
    schedule : Schedule
    asked : FitOptions
        What the user asked for.

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
    """How many times smoother a surface is with several stacks: the more, the more the others determine it."""
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
    """Width of the profile's ramp, and why it is that."""
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
