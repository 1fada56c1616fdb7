"""What a fit chooses by itself: the width of the edge, the stiffness, and the control net.

- *tau* is the width of the edge in the image, measured across the surface after the first stage on the grey levels.
- *smoothness* follows the noise: what the image differs from the profile by, noise and uneven tissue alike, and in how
  many voxels that was seen.
- *net*: all is fitted with 9x7 control points, then again with finer nets while the image is worth them, or up to the
  one asked for, see :mod:`.finer_nets`.
- A surface that folds or goes far away from the region is fitted again, held tighter to it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.parametrization import affine
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .edge_width import PROFILE_PIXELS, edge_width
from .finer_nets import fit_finer
from .holding import hold
from .nets import net_of, net_text
from .options import LEAST_TAU_PIXELS, MOST_TAU_PIXELS, TAU_PIXELS, FitOptions
from .plan import Plan, crop_around, machinery
from .stages import Step, cost_of, last_step

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
_GIVEN = "as asked for"


@dataclass(frozen=True)
class Choice:
    """An option that was chosen, or given by the user.

    Parameters
    ----------
    option, value : str
    reason : str
        In plain words.
    """

    option: str
    value: str
    reason: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a fit has chosen, beside the surface of its last step.

    Parameters
    ----------
    options : FitOptions
        With everything filled in.
    choices : tuple of Choice
    cost_initial : float
        Cost of the generic model, seen with the levels of the last stage.
    """

    options: FitOptions
    choices: tuple[Choice, ...]
    cost_initial: float


def fit_in_frame(plan: Plan, model: BSplineSurface, options: FitOptions) -> Generator[Step, None, Outcome]:
    """Fit a generic model to an organ, step by step, in the organ's frame.

    Parameters
    ----------
    plan : Plan
    model : BSplineSurface
        With the net to begin with, see :func:`.finer_nets.first_net`.
    options : FitOptions

    Yields
    ------
    Step

    Returns
    -------
    Outcome
    """
    first = net_of(model, options.closure)
    closed, grid = machinery(first, options.closure)
    scaling, region = plan.region_stages(options)
    scaled = yield from last_step(scaling, affine(model, free="scaling", center=np.zeros(3)), grid)
    near = yield from last_step(region, closed.at(scaled.surface), grid)
    coarse, _ = plan.grey_level_stages(_to_start_with(options, plan.pixel))
    caught = yield from last_step(coarse, closed.at(near.surface), grid)
    chosen, choices = _chosen(plan, caught, options)
    chosen = replace(chosen, net=first)
    anchor = _HOLD * caught.cost * max(caught.cost, _CLEAREST)
    _, fine = plan.grey_level_stages(chosen, anchor=anchor)
    found = yield from last_step(fine, closed.at(caught.surface), grid)
    held = []
    lost = plan.astray(found.surface)
    if lost:
        spare = ("the scaled model", scaled)
        found, how = yield from hold(plan, near, spare, (closed, grid), chosen, anchor, lost)
        held.append(how)
    found, why, later = yield from fit_finer(plan, found, chosen, anchor, options.net)
    net = net_of(found.surface, options.closure)
    choices = (
        Choice("net", net_text(net), why or _GIVEN),
        *choices,
        *(Choice("hold on the region", f"{part.how}, with {net_text(part.net)}", part.why) for part in (*held, *later)),
    )
    halvings = 0
    while net_of(model, options.closure) != net:
        model, halvings = model.refined(), halvings + 1
    closed, grid = machinery(first, options.closure, halvings)
    cost = cost_of(model, fine.correlation(closed.at(found.surface), grid))
    return Outcome(replace(chosen, net=net), choices, cost)


def _to_start_with(options: FitOptions, pixel: float) -> FitOptions:
    """Fill in what is not known before anything was seen."""
    smoothness = _STIFFNESS_TO_START if options.smoothness is None else options.smoothness
    return replace(options, tau=options.tau or TAU_PIXELS * pixel, smoothness=smoothness)


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
    return _with_choices(options, tau, why, _to_start_with(options, pixel).smoothness, "small, as to start with")


def _chosen(plan: Plan, caught: Step, options: FitOptions) -> tuple[FitOptions, tuple[Choice, ...]]:
    """Choose tau and smoothness by what the image shows across a surface that lies near the edge."""
    tau, why = _tau(plan.sampler, caught.surface, plan.voxel, options)
    share = np.sqrt(caught.cost)
    voxels = plan.voxels_along(caught.surface, tau)
    noise = (
        f"the image differs from an even edge by {share:.0%} of the contrast, noise and uneven tissue alike, "
        f"in {_rounded(voxels)} voxels along it"
    )
    return _with_choices(options, tau, why, _STIFFNESS * caught.cost / np.sqrt(voxels), noise)


def _rounded(count: float) -> str:
    """Two digits of a number, with separators between thousands."""
    return f"{int(float(f'{count:.2g}')):,}"


def _with_choices(
    options: FitOptions, tau: float, why_tau: str, smoothness: float, why_smoothness: str
) -> tuple[FitOptions, tuple[Choice, ...]]:
    """Fill in the smoothness if it is not given, and tau, and tell why."""
    if options.smoothness is not None:
        smoothness, why_smoothness = options.smoothness, _GIVEN
    choices = (Choice("tau", f"{tau:.2f} mm", why_tau), Choice("smoothness", f"{smoothness:.2g}", why_smoothness))
    return replace(options, tau=tau, smoothness=smoothness), choices


def _tau(sampler: Sampler, surface: BSplineSurface, voxel: np.ndarray, options: FitOptions) -> tuple[float, str]:
    """Width of the profile's ramp, and why it is that."""
    if options.tau is not None:
        return options.tau, _GIVEN
    pixel = float(np.linalg.norm(voxel, axis=0).min())
    width = edge_width(sampler, surface, voxel)
    if width is None:
        return TAU_PIXELS * pixel, f"{TAU_PIXELS:g} pixels, as the image shows no clear edge"
    tau = float(np.clip(width, LEAST_TAU_PIXELS * pixel, MOST_TAU_PIXELS * pixel))
    held = "" if tau == width else f", held within {LEAST_TAU_PIXELS:g} to {MOST_TAU_PIXELS:g}"
    return tau, f"the edge in the image is {width:.2f} mm wide, {width / pixel:.1f} pixels{held}"


def placed(
    steps: Generator[Step, None, Outcome], place: Callable[[BSplineSurface], BSplineSurface], history: list[Step]
):
    """Take the surfaces of all steps to another frame, and remember the steps; returns what the steps return."""
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value
        history.append(replace(step, surface=place(step.surface)))
        yield history[-1]
