"""The organs of a generic model, fitted to an image: placed, deformed as one, and each by itself at last.

1. *Place* all organs by the moments of their regions, see :mod:`.placement`.
2. *Deform* them as one by radial basis functions, see :mod:`.joint`: to the ends of the regions, on the regions, then
   on the grey levels, coarse and fine.
3. *Register* each organ with its own control points, on the grey levels.

Further stacks count from the third step on: each organ is aligned with them by its own surface, and fitted to all that
show it. Before, they complete the region of an organ that the image cuts, if there is one.
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
from ..registration.boundary import checked_boundary_points
from ..registration.choices import Choice, choose_by
from ..registration.drift_limit import within_drift_limit
from ..registration.joint_stacks import JointStacks
from ..registration.nets import net_of, net_text, sampled
from ..registration.options import FitOptions
from ..registration.organ import OrganFit, Outcome, complete_region, completed, mapped, recorded
from ..registration.region_image import RegionImage
from ..registration.schedule import Schedule
from ..registration.stacks import Stack
from ..registration.stages import Step, last_step
from ..segmentation.checks import check_scale
from .joint import CLOSURE, JointSpace, JointStep
from .placement import Placement, SolidMoments, place


@dataclass(frozen=True, eq=False)
class FittedOrgans:
    """Organs of a model in an image.

    Parameters
    ----------
    fits : dict of str to OrganFit
    together : dict of str to BSplineSurface
        The organs as they were deformed as one, before their own control points moved; RAS mm.
    placement : Placement
    """

    fits: dict[str, OrganFit]
    together: dict[str, BSplineSurface]
    placement: Placement


@dataclass(frozen=True, eq=False)
class _Organ:
    """One organ while it is fitted; its whole region goes beyond the image where stacks have completed it."""

    region: Region
    whole: Region
    asked: FitOptions
    schedule: Schedule
    history: list[Step]
    stacks: tuple[Stack, ...]
    choices: tuple[Choice, ...] = ()


def fit_organs(
    image: Image,
    parents: Mapping[str, BSplineSurface],
    regions: Mapping[str, Region],
    options: Mapping[str, FitOptions],
    stacks: Mapping[str, Sequence[Stack]],
) -> Generator[JointStep, None, FittedOrgans]:
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
        Of each of these; net, closure and generic model are those of the parents.
    stacks : mapping of str to sequence of Stack
        Further stacks of each of these, with images that are read.

    Yields
    ------
    JointStep
        One for every iteration.

    Returns
    -------
    FittedOrgans

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
    clouds = {name: _boundary(organ.schedule.region) for name, organ in organs.items()}
    surfaces = yield from _in_histories(space.towards(surfaces, clouds), organs)
    organs, together = yield from _deformed_as_one(space, organs, surfaces)
    fits, surfaces = {}, together
    for name, organ in organs.items():
        steps = _by_itself(image, organ, placed[name], start=start)
        fits[name] = yield from _beside_others(steps, name, surfaces)
        surfaces = {**surfaces, name: fits[name].surface}
    return FittedOrgans(fits, together, placement)


def _planned(
    image: Image, name: str, region: Region, asked: FitOptions, parent: BSplineSurface, stacks: tuple[Stack, ...]
) -> Generator[JointStep, None, _Organ]:
    """Plan the fit of an organ in RAS mm, the frame that all of them share; stacks complete a region that is cut."""
    history: list[Step] = []
    whole = region
    if stacks and region.touches_border:
        steps = complete_region(image, region, asked, stacks, history)
        whole, stacks = yield from _beside_others(steps, name, {})
    pose = replace(moments(whole), center=np.zeros(3), axes=np.eye(3))
    options = asked.filled_in(threshold=region.threshold, net=net_of(parent, CLOSURE), closure=CLOSURE)
    return _Organ(region, whole, asked, Schedule.of_region(image, whole, pose, options), history, stacks)


def _boundary(region: RegionImage) -> np.ndarray:
    """Points of a region's boundary, (n, 3) RAS mm: voxels of its distance image that are near, moved there."""
    distance = region.distance
    k, j, i = np.nonzero(np.abs(distance.array) < 0.5 * distance.spacing.min())
    points = distance.to_ras(np.column_stack([i, j, k]))
    values, gradients, _ = region.sampler.values_and_gradients(points)
    squared = np.maximum(np.sum(gradients**2, axis=1), 0.25)
    return points - (values / squared)[:, None] * gradients


def _deformed_as_one(
    space: JointSpace, organs: dict[str, _Organ], surfaces: dict[str, BSplineSurface]
) -> Generator[JointStep, None, tuple[dict[str, _Organ], dict[str, BSplineSurface]]]:
    """Deform all organs as one; between coarse and fine, what follows the image is chosen for each of them."""
    for stage in ("on_region", "coarse", "fine"):
        stages = {name: getattr(organ.schedule, stage) for name, organ in organs.items()}
        surfaces, costs = yield from _in_histories(space.run(stages, surfaces), organs)
        if stage == "coarse":
            organs = {name: _chosen(organ, costs[name]) for name, organ in organs.items()}
    return organs, surfaces


def _in_histories(steps, organs: Mapping[str, _Organ]):
    """Add steps of all organs to the history of each; returns what the steps return."""

    def record(step: JointStep) -> JointStep:
        for name, organ in organs.items():
            organ.history.append(step.of(name))
        return step

    return mapped(steps, record)


def _beside_others(steps, name: str, surfaces: Mapping[str, BSplineSurface]):
    """Show steps of one organ beside the others, which stay; returns what the steps return."""

    def beside(step: Step) -> JointStep:
        shown, stage = {**surfaces, name: step.surface}, f"{name}, {step.stage}"
        return JointStep(stage, step.iteration, step.cost, step.displacement, shown, step.stopped_by)

    return mapped(steps, beside)


def _chosen(organ: _Organ, cost: float) -> _Organ:
    """Choose tau, smoothness and anchor of an organ by the last step and the cost of the coarse stage."""
    schedule, choices = choose_by(replace(organ.history[-1], cost=cost), organ.schedule, organ.asked)
    return replace(organ, schedule=schedule, choices=choices)


def _by_itself(image: Image, organ: _Organ, placed: BSplineSurface, *, start: float) -> Generator[Step, None, OrganFit]:
    """Register an organ with its own control points, from the surface that all of them together have led to."""
    outcome = yield from recorded(_register(organ, placed), organ.history)
    points = checked_boundary_points(None)
    fit = yield from completed(image, organ.history, outcome, points, region=organ.region, start=start)
    return fit if organ.whole is organ.region else replace(fit, whole_region=organ.whole)


def _register(organ: _Organ, placed: BSplineSurface) -> Generator[Step, None, Outcome]:
    """Register an organ on the grey levels of all stacks, without those that contradict the image."""
    together, stacks = organ.history[-1], JointStacks(organ.stacks, np.eye(4))
    while True:
        outcome = yield from _on_grey_levels(organ, together, placed, stacks)
        if not stacks.leave_out_contradicting():
            return outcome


def _on_grey_levels(
    organ: _Organ, together: Step, placed: BSplineSurface, stacks: JointStacks
) -> Generator[Step, None, Outcome]:
    space, choices = sampled(together.surface, CLOSURE), organ.choices
    schedule, coarse = yield from stacks.joined(organ.schedule, together, space)
    if schedule.views:
        schedule, choices = choose_by(coarse, schedule, organ.asked)
    found = yield from last_step(replace(schedule.fine, name="own control points"), space.at(coarse.surface))
    if schedule.views:
        schedule, surface = stacks.realigned(schedule, found.surface)
        again = replace(schedule.fine, name="own control points, motion found again")
        found = yield from last_step(again, space.at(surface))
    found, limited = yield from within_drift_limit(
        found, schedule, space, on_region=together, fallback=together, called="surface of the generic model"
    )
    cost = schedule.fine.cost_of(space.at(found.surface), placed)
    net = Choice("net", net_text(schedule.options.net), (Diagnostic("net_of_model"),))
    return Outcome(schedule.options, (net, *choices, *limited), cost, stacks.uses(found.surface))
