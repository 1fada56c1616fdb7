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
from ..imaging.sampling import Sampler
from ..messages import Diagnostic
from .nets import sampled
from .options import LEAST_TAU_PIXELS, MOST_TAU_PIXELS, TAU_PIXELS, FitOptions
from .schedule import Schedule
from .stages import Step
from .virtual_image import blur_covariance

# Smoothness for a mean squared residual of 1 seen in one voxel. It shrinks with the square root of the number of
# voxels: noise averages out as fast as that number grows, uneven tissue does not. More takes the wrinkles out of a net
# that is finer than the organ, and then its folds. Tried 0.6 to 2.4 on phantoms and real bladders; and 120 without the
# root, with which two of five seeds in a real bladder (p5) gave a surface that went beyond the drift limit.
_SMOOTHNESS = 1.2
# So many times smoother with several stacks: each line counts mostly in the stack that shows its edge sharply, so that
# the cost is low, and the voxels that determine it are few of all. Tried on the demo's organs in three stacks: a mean
# error of 0.043 mm with 1, 0.040 with 4, 0.037 with 16, where the bladder's grows. With 1, fine nets ripple at poles.
_SEVERAL = 6.0
# Weight against leaving the separated region for a mean squared residual of 1: the less the image looks like an edge,
# the more the region counts. It grows with the square of that residual, as the image knows the less by it and is the
# likelier to show something else. Tried 400 to 600, and 10 to 100 without the square, on phantoms and real bladders:
# less lets the surface stop short of thin grey rims, more cuts corners and lets the terraces.
_ANCHOR = 600.0
# No image is taken for clearer than this mean squared residual: where the volume cuts an organ, nothing else holds it.
_CLEAREST = 1.0 / 60.0
# Where the edge's width is measured: these distances from the edge, in pixels; more where the blur is wider.
_PROFILE_PIXELS = np.arange(-6.0, 6.01, 0.25)
_PLATEAU = _PROFILE_PIXELS < -3.0
_BEYOND = (_PROFILE_PIXELS > 2.0) & (_PROFILE_PIXELS < 4.0)
_NEAR = np.abs(_PROFILE_PIXELS) <= 2.5
# Within these an edge is looked for on each line.
_EDGE_PIXELS = 2.0


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


def edge_width(sampler: Sampler, surface: BSplineSurface, voxel: np.ndarray) -> float | None:
    """Measure the width of an organ's edge in the image.

    Parameters
    ----------
    sampler : Sampler
        The grey levels, in the frame of the surface.
    surface : BSplineSurface
        Near the edge.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.

    Returns
    -------
    float or None
        mm; None where there is no edge.

    Notes
    -----
    The mean profile across the surface, mostly from places where it is sharp, that is not across thick slices. The
    width is that of the cosine ramp of equation 3 with the same slope at half height. It is measured twice: the second
    time each line is moved to its own edge, as a surface that misses the edge by turns would make it look wide, and
    stretched by the blur along it as the first width says.
    """
    pixel = float(np.linalg.norm(voxel, axis=0).min())
    u, v = surface.midpoints(32, 20)
    points, normals = surface.points(u, v), surface.normals(u, v)
    offsets, width = np.zeros(len(points)), TAU_PIXELS * pixel
    for _ in range(2):
        covariance = blur_covariance(voxel, width)
        blur = np.sqrt(np.einsum("na,ab,nb->n", normals, covariance, normals) / np.linalg.eigvalsh(covariance)[0])
        depths = offsets[:, None] + pixel * blur[:, None] * _PROFILE_PIXELS
        values, valid = sampler.values(points[:, None] + depths[..., None] * normals[:, None])
        weight, shares = _steps(values)
        weight = valid.all(axis=1) * weight / blur**4
        if not weight.sum() > 0.0:
            return None
        width = _width_of_profile(weight @ shares / weight.sum(), pixel)
        if width is None:
            return None
        # A step from 1 to 0 covers half of an interval about it.
        middle = np.abs(_PROFILE_PIXELS) <= _EDGE_PIXELS
        lack = np.clip(shares[:, middle], 0.0, 1.0).mean(axis=1) - 0.5
        offsets = offsets + np.where(weight > 0.0, 2.0 * _EDGE_PIXELS * pixel * blur * lack, 0.0)
    return width


def _steps(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the step on each line, (n,), 0 where it goes the other way; and how much of it is left, (n, m)."""
    inner = values[:, _PLATEAU].mean(axis=1)
    beyond = values[:, _BEYOND]
    darker = float(np.median(inner - beyond.mean(axis=1))) > 0.0
    outer = beyond.min(axis=1) if darker else beyond.max(axis=1)
    step = inner - outer
    shares = (values - outer[:, None]) / np.where(step == 0.0, 1.0, step)[:, None]
    return np.maximum(step if darker else -step, 0.0), shares


def _width_of_profile(profile: np.ndarray, pixel: float) -> float | None:
    """Width of the cosine ramp that is as high and as steep as a profile from 1 to 0, mm; None where none falls."""
    slope = float(np.max(-np.gradient(profile, pixel * _PROFILE_PIXELS)[_NEAR]))
    height = float(profile[_PLATEAU].mean() - profile[(_PROFILE_PIXELS > 0.0) & (_PROFILE_PIXELS < 4.0)].min())
    return 0.5 * np.pi * height / slope if slope > 0.0 else None
