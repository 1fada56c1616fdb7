"""What a fit chooses by what the image shows across a surface that lies near the edge, and why.

- *tau* is the width of the edge in the image.
- *smoothness* follows the noise: what the image differs from the profile by, noise and uneven tissue alike, and in how
  many voxels that was seen.
- The hold on where a stage begins follows it too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from ..messages import Diagnostic
from .edge_width import PROFILE_PIXELS, edge_width
from .options import LEAST_TAU_PIXELS, MOST_TAU_PIXELS, TAU_PIXELS, FitOptions
from .plan import crop_around, voxels_along
from .stages import Step

# Smoothness for a mean squared residual of 1 seen in one voxel. It shrinks with the square root of the number of
# voxels: noise averages out as fast as that number grows, uneven tissue does not. More takes the wrinkles out of a net
# that is finer than the organ, and then its folds. Tried 0.6 to 2.4 on phantoms and real bladders; and 120 without the
# root, with which two of five seeds in a real bladder (p5) gave a surface that had to be held.
_STIFFNESS = 1.2
_STIFFNESS_TO_START = 1e-5
# Weight against leaving the separated region for a mean squared residual of 1: the less the image looks like an edge,
# the more the region counts. It grows with the square of that residual, as the image knows the less by it and is the
# likelier to show something else. Tried 400 to 600, and 10 to 100 without the square, on phantoms and real bladders:
# less lets the surface stop short of thin grey rims, more cuts corners and lets the terraces.
_HOLD = 600.0
# No image is taken for clearer than this mean squared residual: where the volume cuts an organ, nothing else holds it.
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


def to_start_with(options: FitOptions, pixel: float) -> FitOptions:
    """Fill in what is not known before anything was seen; `pixel` is the finest voxel spacing, mm."""
    smoothness = _STIFFNESS_TO_START if options.smoothness is None else options.smoothness
    return options.filled_in(tau=options.tau or TAU_PIXELS * pixel, smoothness=smoothness)


def chosen_beside(image: Image, surface: BSplineSurface, options: FitOptions) -> tuple[FitOptions, tuple[Choice, ...]]:
    """Choose tau by a surface that is there already; smoothness is that to start with.

    Parameters
    ----------
    image : Image
    surface : BSplineSurface
        Near the edge, RAS mm.
    options : FitOptions

    Returns
    -------
    options : FitOptions
        With `tau` and `smoothness`.
    choices : tuple of Choice
    """
    pixel = float(min(image.spacing))
    sampler = Sampler(crop_around(image, surface.control_net.reshape(-1, 3), PROFILE_PIXELS[-1] * pixel))
    tau, why = _tau(sampler, surface, image.ijk_to_ras[:3, :3], options)
    small = Diagnostic("smoothness_to_start")
    return _with_choices(options, tau, why, to_start_with(options, pixel).smoothness, small)


def chosen_by(
    caught: Step, sampler: Sampler, voxel: np.ndarray, options: FitOptions
) -> tuple[FitOptions, tuple[Choice, ...]]:
    """Choose tau and smoothness by what a first stage on the grey levels has come to.

    Parameters
    ----------
    caught : Step
        Its last one.
    sampler : Sampler
        The grey levels, in the frame of the surface.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel in that frame, mm.
    options : FitOptions

    Returns
    -------
    options : FitOptions
        With `tau` and `smoothness`.
    choices : tuple of Choice
    """
    tau, why = _tau(sampler, caught.surface, voxel, options)
    voxels = voxels_along(caught.surface, tau, voxel)
    noise = Diagnostic("noise_along_edge", {"share": float(np.sqrt(caught.cost)), "voxels": _rounded(voxels)})
    return _with_choices(options, tau, why, _STIFFNESS * caught.cost / np.sqrt(voxels), noise)


def anchor_for(caught: Step) -> float:
    """Choose the weight against leaving the surface that a stage begins with, by the same."""
    return _HOLD * caught.cost * max(caught.cost, _CLEAREST)


def _rounded(count: float) -> int:
    """Two digits of a number."""
    return int(float(f"{count:.2g}"))


def _with_choices(
    options: FitOptions, tau: float, why_tau: Diagnostic, smoothness: float, why_smoothness: Diagnostic
) -> tuple[FitOptions, tuple[Choice, ...]]:
    """Fill in the smoothness if it is not given, and tau, and tell why."""
    if options.smoothness is not None:
        smoothness, why_smoothness = options.smoothness, Diagnostic("option_given")
    choices = (
        Choice("tau", f"{tau:.2f} mm", (why_tau,)),
        Choice("smoothness", f"{smoothness:.2g}", (why_smoothness,)),
    )
    return options.filled_in(tau=tau, smoothness=smoothness), choices


def _tau(sampler: Sampler, surface: BSplineSurface, voxel: np.ndarray, options: FitOptions) -> tuple[float, Diagnostic]:
    """Width of the profile's ramp, and why it is that."""
    if options.tau is not None:
        return options.tau, Diagnostic("option_given")
    pixel = float(np.linalg.norm(voxel, axis=0).min())
    width = edge_width(sampler, surface, voxel)
    if width is None:
        return TAU_PIXELS * pixel, Diagnostic("no_edge_width", {"pixels": TAU_PIXELS})
    tau = float(np.clip(width, LEAST_TAU_PIXELS * pixel, MOST_TAU_PIXELS * pixel))
    found = {"width_mm": float(width), "pixels": float(width) / pixel}
    if tau == width:
        return tau, Diagnostic("edge_width", found)
    return tau, Diagnostic("edge_width_limited", {**found, "least": LEAST_TAU_PIXELS, "most": MOST_TAU_PIXELS})
