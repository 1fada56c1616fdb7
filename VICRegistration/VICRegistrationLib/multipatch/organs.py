"""The organs of a generic model, fitted to an image: placed, deformed as one, and each by itself at last.

1. *Place* all organs by the moments of their regions, see :mod:`.placement`.
2. *Deform* them jointly by radial basis functions, see :mod:`.joint`, on the regions, then on the grey levels, coarse
   and fine. In between, points slide on their surfaces to where space bends least.
3. *Register* each organ with its own control points, again on its region and on the grey levels: these fit sharp ends
   that the radial basis functions cannot, and whose edges the grey levels do not show to a surface far from them.

Further stacks complete the region of an organ that the image cuts. After the joint deformation on the image alone, the
stacks are aligned with each organ's surface. Then the joint deformation goes on with the sum over all organs and all
stacks that show them, and each organ's own control points are fitted to these too. If a stack contradicts the image at
the end, it is left out for that organ, and the steps from the alignment on are done again.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.moments import moments
from ..imaging.region import Region
from ..messages import Diagnostic
from ..registration.boundary_points import checked_boundary_points
from ..registration.choices import Choice, choose_by
from ..registration.drift_limit import within_drift_limit
from ..registration.joint_stacks import JointStacks
from ..registration.nets import net_of, net_text, sampled
from ..registration.options import FitOptions
from ..registration.organ import Outcome, complete_region, with_boundary_points
from ..registration.organ_fit import OrganFit
from ..registration.schedule import Schedule
from ..registration.stacks import Stack
from ..registration.stages import Step, last_step
from ..registration.steps import mapped, recorded
from ..segmentation.checks import check_scale
from .joint import CLOSURE, JointSpace, JointStep
from .placement import Placement, SolidMoments, place

# Weight against sliding within the surface of an organ's own control points: five times that of single fits, as all
# organs together have found where points belong. Attachments slide by up to 0.8 mm on seven known maps; with half of it
# by 1.0, with twice by 0.5 mm, where organs are off by the same. With that of single fits they slide by 1.2 mm.
_SLIDING = 0.1


@dataclass(frozen=True, eq=False)
class _Organ:
    """One organ during the fit. The whole region reaches beyond the image if stacks have completed it."""

    region: Region
    whole: Region
    asked: FitOptions
    schedule: Schedule
    history: list[Step]
    stacks: JointStacks
    choices: tuple[Choice, ...] = ()


def fit_organs(
    image: Image,
    parents: Mapping[str, BSplineSurface],
    regions: Mapping[str, Region],
    options: Mapping[str, FitOptions],
    stacks: Mapping[str, Sequence[Stack]],
) -> Generator[JointStep, None, tuple[dict[str, OrganFit], dict[str, BSplineSurface], Placement]]:
    """Fit the closed organs of a model to an image, step by step.

    Parameters
    ----------
    image : Image
        The grey levels.
    parents : mapping of str to BSplineSurface
        Closed surfaces of the model's organs, RAS mm.
    regions : mapping of str to Region
        Separated organs on the image's grid, at least two of them.
    options : mapping of str to FitOptions
        Options of each of these; net, closure and generic model are those of the parents.
    stacks : mapping of str to sequence of Stack
        Further stacks of each of these, whose images are in memory.

    Yields
    ------
    JointStep
        One for every iteration.

    Returns
    -------
    fits : dict of str to OrganFit
    together : dict of str to BSplineSurface
        The organs after the joint deformation, before their own control points moved; RAS mm.
    placement : Placement

    Raises
    ------
    ValueError
        If the volume is not given in mm, a region is too thin for a surface or does not lie on the image's grid, or
        the model cannot be placed.
    """
    start = time.perf_counter()
    check_scale(image)
    organs = {}
    for name, region in regions.items():
        organs[name] = yield from _planned(image, name, region, options[name], parents[name], tuple(stacks[name]))
    placement = place(parents, {name: SolidMoments.of_region(organ.whole) for name, organ in organs.items()})
    placed = {name: parents[name].transformed(placement.matrix) for name in organs}
    space = JointSpace(placed)
    maps = placement.maps
    surfaces = space.nearest({name: surface.transformed(maps[name]).control_net for name, surface in placed.items()})
    organs, alone = yield from _deformed_as_one(space, organs, surfaces, ("on_region", "coarse", "fine"))
    while True:
        planned, together = yield from _on_all_stacks(space, organs, alone)
        outcomes = yield from _each_registered(planned, placed, together)
        # A sum, not any(): every organ leaves out what contradicts it before all are fitted again.
        if not sum(organ.stacks.leave_out_contradicting() for organ in organs.values()):
            break
    fits, shown = {}, {name: organ.history[-1].surface for name, organ in planned.items()}
    for name, organ in planned.items():
        steps = _completed(image, organ, outcomes[name], start=start)
        fits[name] = yield from _beside_others(steps, name, shown)
    return fits, together, placement


def _planned(
    image: Image, name: str, region: Region, asked: FitOptions, parent: BSplineSurface, stacks: tuple[Stack, ...]
) -> Generator[JointStep, None, _Organ]:
    """Plan the fit of an organ in the common frame, RAS mm; further stacks complete a region that is cut."""
    history: list[Step] = []
    whole = region
    if stacks and region.touches_border:
        steps = complete_region(image, region, asked, stacks, history)
        whole, stacks = yield from _beside_others(steps, name, {})
    pose = replace(moments(whole), center=np.zeros(3), axes=np.eye(3))
    options = asked.filled_in(threshold=region.threshold, net=net_of(parent, CLOSURE), closure=CLOSURE)
    schedule = Schedule.of_region(image, whole, pose, options)
    return _Organ(region, whole, asked, schedule, history, JointStacks(stacks, np.eye(4)))


def _deformed_as_one(
    space: JointSpace,
    organs: dict[str, _Organ],
    surfaces: dict[str, BSplineSurface],
    keys: Sequence[str],
    suffix: str = "",
) -> Generator[JointStep, None, tuple[dict[str, _Organ], dict[str, BSplineSurface]]]:
    """Deform all organs jointly; after the coarse stage, automatic options are chosen, and points slide."""
    for key in keys:
        stages = {}
        for name, organ in organs.items():
            stage = getattr(organ.schedule, key)
            stages[name] = replace(stage, name=stage.name + suffix)
        surfaces, costs = yield from _in_histories(space.run(stages, surfaces), organs)
        if key == "coarse":
            organs = {name: _chosen(organ, costs[name]) for name, organ in organs.items()}
            surfaces = space.with_slid_points(surfaces)
    return organs, surfaces


def _on_all_stacks(
    space: JointSpace, organs: dict[str, _Organ], surfaces: dict[str, BSplineSurface]
) -> Generator[JointStep, None, tuple[dict[str, _Organ], dict[str, BSplineSurface]]]:
    """Align the further stacks with each organ, and deform all jointly on those that show them, if any do."""
    schedules = {name: organ.stacks.beside(organ.schedule, surfaces[name]) for name, organ in organs.items()}
    organs = {name: replace(organ, schedule=schedules[name]) for name, organ in organs.items()}
    if not any(schedule.views for schedule in schedules.values()):
        return organs, surfaces
    return (yield from _deformed_as_one(space, organs, surfaces, ("coarse", "fine"), ", all stacks"))


def _in_histories(steps, organs: Mapping[str, _Organ]):
    """Add steps of all organs to the history of each; returns what the steps return."""

    def record(step: JointStep) -> JointStep:
        for name, organ in organs.items():
            organ.history.append(step.of(name))
        return step

    return mapped(steps, record)


def _beside_others(steps, name: str, surfaces: Mapping[str, BSplineSurface]):
    """Turn steps of one organ into joint steps with the other surfaces as they are; returns what the steps return."""

    def beside(step: Step) -> JointStep:
        shown, stage = {**surfaces, name: step.surface}, f"{name}, {step.stage}"
        return JointStep(stage, step.iteration, step.cost, step.displacement, shown, step.stopped_by)

    return mapped(steps, beside)


def _chosen(organ: _Organ, cost: float) -> _Organ:
    """Choose tau, smoothness and anchor of an organ by the last step and the cost of the coarse stage."""
    schedule, choices = choose_by(replace(organ.history[-1], cost=cost), organ.schedule, organ.asked)
    return replace(organ, schedule=schedule, choices=choices)


def _each_registered(
    organs: Mapping[str, _Organ], placed: Mapping[str, BSplineSurface], together: dict[str, BSplineSurface]
) -> Generator[JointStep, None, dict[str, Outcome]]:
    """Register each organ with its own control points, starting at the surfaces of the joint deformation."""
    outcomes, surfaces = {}, together
    for name, organ in organs.items():
        steps = recorded(_registered(organ, placed[name], together[name]), organ.history)
        outcomes[name] = yield from _beside_others(steps, name, surfaces)
        surfaces = {**surfaces, name: organ.history[-1].surface}
    return outcomes


def _registered(organ: _Organ, placed: BSplineSurface, together: BSplineSurface) -> Generator[Step, None, Outcome]:
    """Register an organ on its region, then on the grey levels of all stacks that show it."""
    start = replace(organ.history[-1], surface=together)
    space = sampled(together, CLOSURE)
    schedule = organ.stacks.realigned(organ.schedule, together)
    steps = [start]
    for stage in (schedule.on_region, schedule.coarse, schedule.fine):
        stage = replace(stage, name=f"own control points, {stage.name}", sliding=_SLIDING)
        steps.append((yield from last_step(stage, space.at(steps[-1].surface))))
    _, on_region, _, found = steps
    if schedule.views:
        schedule = organ.stacks.realigned(schedule, found.surface)
        again = replace(schedule.fine, name="own control points, motion found again", sliding=_SLIDING)
        found = yield from last_step(again, space.at(found.surface))
    found, limited = yield from within_drift_limit(
        found, schedule, space, on_region=on_region, fallback=start, called="surface of the generic model"
    )
    cost = schedule.fine.cost_of(space.at(found.surface), placed)
    net = Choice("net", net_text(schedule.options.net), (Diagnostic("net_of_model"),))
    return Outcome(schedule.options, (net, *organ.choices, *limited), cost, organ.stacks.uses(schedule, found.surface))


def _completed(image: Image, organ: _Organ, outcome: Outcome, *, start: float) -> Generator[Step, None, OrganFit]:
    points = checked_boundary_points(None)
    fit = yield from with_boundary_points(
        image, organ.history, outcome, points, asked=organ.asked, region=organ.region, start=start
    )
    return fit if organ.whole is organ.region else replace(fit, whole_region=organ.whole)
