"""A first fit, from the generic model to the finest net that the image is worth, in the organ's frame.

All is fitted with 9x7 control points, then again with finer nets while the image is worth them, or up to the one asked
for, see :mod:`.finer_nets`. A surface that folds or goes far away from the region is fitted again, held tighter to it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.parametrization import affine
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..messages import Diagnostic
from .choosing import Choice, anchor_for, chosen_by, to_start_with
from .finer_nets import fit_finer
from .nets import net_of, net_text, sampled_net
from .options import FitOptions
from .plan import Plan
from .region_surface import closed_surface
from .sample_grid import SampledSurface
from .stages import Stage, Step, last_step
from .tighter_hold import Held, hold


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a fit has chosen, beside the surface of its last step.

    Parameters
    ----------
    options : FitOptions
        With everything filled in.
    choices : tuple of Choice
    cost_initial : float
        Cost of the generic model, or of the surface that is fitted again, seen with the levels of the last stage.
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
    space = sampled_net(first, options.closure)
    scaling, region = plan.region_stages(options)
    scaled = yield from last_step(
        scaling, SampledSurface(affine(model, free="scaling", center=np.zeros(3)), space.grid)
    )
    near = yield from last_step(region, space.at(scaled.surface))
    coarse, _ = plan.grey_level_stages(to_start_with(options, plan.pixel))
    caught = yield from last_step(coarse, space.at(near.surface))
    chosen, choices = chosen_by(caught, plan.sampler, plan.voxel, options)
    chosen = chosen.filled_in(net=first)
    anchor = anchor_for(caught)
    _, fine = plan.grey_level_stages(chosen, anchor=anchor)
    found = yield from last_step(fine, space.at(caught.surface))
    held = []
    lost = plan.astray(found.surface)
    if lost:
        spare = ("scaled model", scaled)
        found, how = yield from hold(plan, near, spare, space, chosen, anchor, lost)
        held.append(how)
    found, why, later = yield from fit_finer(plan, found, chosen, anchor, options.net)
    if check_surface(found.surface):
        found, how = _last_resort(plan, found, fine, space, chosen)
        later.append(how)
        yield found
    net = net_of(found.surface, options.closure)
    choices = (
        Choice("net", net_text(net), why or (Diagnostic("option_given"),)),
        *choices,
        *(Choice("hold", part.how, part.reasons) for part in (*held, *later)),
    )
    halvings = 0
    while net_of(model, options.closure) != net:
        model, halvings = model.refined(), halvings + 1
    space = sampled_net(first, options.closure, halvings)
    cost = fine.correlation(space.at(found.surface)).cost_of(model)
    return Outcome(chosen.filled_in(net=net), choices, cost)


def _last_resort(plan: Plan, found: Step, fine: Stage, space: SampledSurface, options: FitOptions) -> tuple[Step, Held]:
    """Take the region's own surface in place of one that is no valid solid."""
    problem = Diagnostic("no_valid_solid", {"kind": check_surface(found.surface)[0].kind})
    surface = closed_surface(plan.target.distance, options.net, options.closure)
    cost = fine.correlation(space.at(surface)).cost_of(surface)
    step = Step("closed surface of the region kept", 1, cost, 0.0, surface, "displacement")
    kept = Diagnostic("surface_kept", {"net": net_text(options.net), "kept": "closed surface of the region"})
    return step, Held("closed surface of the region kept", (problem, kept))


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
