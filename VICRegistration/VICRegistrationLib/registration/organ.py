"""The fit of one organ, from the seeds to the result.

1. *Separate* the organ: a region of voxels around the seeds.
2. *Place* a generic model by the region's centre, principal axes and moments.
3. *Scale* the model globally, on the distance image of the region.
4. *Register* it locally: on the region, then on the grey levels, coarse and fine. Between coarse and fine, the width of
   the edge and the noise are measured, and tau and the weights of the energies are chosen.
5. Repeat with *finer nets* while they lower the cost by more than noise explains.
6. *Refuse* a surface that has folded or is too far from the region; it is fitted again, held closer to the region.
7. Correct the surface by *boundary points*. If they are so far from the surface that the separation must have failed,
   the organ is first separated again through the points, and fitted from there.

Steps 2 to 6 run in the frame of the organ's principal axes, so that the result depends neither on the position of the
volume in RAS nor on the order of its axes in memory.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.models import generic_model
from ..geometry.parametrization import affine
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image, as_image
from ..imaging.moments import moments
from ..imaging.region import Region
from ..messages import Diagnostic
from ..segmentation.checks import check_scale
from ..segmentation.separation import separate
from .boundary_points import checked_boundary_points
from .choices import Choice, choose_by
from .completion import completed_region
from .correction import correct
from .drift_limit import valid_at_last, within_drift_limit
from .finer_nets import first_net, fit_finer
from .joint_stacks import JointStacks
from .nets import halvings_to, net_of, net_text, sampled_net
from .options import FitOptions
from .organ_fit import OrganFit
from .restart import contradicted, separated_through
from .sample_grid import SampledSurface
from .schedule import Schedule, frame_of
from .stacks import Stack, StackUse, stacks_beside
from .stages import Step, last_step
from .steps import recorded


def fit_organ(
    image: Image,
    seeds: np.ndarray,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    further: Sequence[Stack | Image] = (),
) -> Generator[Step, None, OrganFit]:
    """Separate an organ and fit a surface to it, step by step.

    Parameters
    ----------
    image : Image or path
    seeds : (n, 3) array_like
        Points inside the organ, RAS mm.
    options : FitOptions, optional
    boundary_points : (n, 3) array_like, optional
    further : sequence of Stack, Image or path
        As in :func:`fit_region`.

    Yields
    ------
    Step
        One for every iteration; the caller may stop between any two.

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the organ cannot be separated, or a boundary point cannot be used.
    """
    image, options = as_image(image), options or FitOptions()
    points, stacks = checked_boundary_points(boundary_points), stacks_beside(image, further)
    region = separate(image, seeds, threshold=options.threshold, erosion=options.erosion, dilation=options.dilation)
    return (yield from fit_region(image, region, options, boundary_points=points, further=stacks))


def fit_region(
    image: Image,
    region: Region,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    further: Sequence[Stack | Image] = (),
) -> Generator[Step, None, OrganFit]:
    """Fit a surface to a separated region and then to the grey levels, step by step.

    Parameters
    ----------
    image : Image or path
        The grey levels.
    region : Region
        The separated organ, on the image's grid.
    options : FitOptions, optional
    boundary_points : (n, 3) array_like, optional
        Points on the organ's wall, RAS mm. After the fit the surface is corrected around them, see :mod:`.correction`,
        with a finer net if necessary.
    further : sequence of Stack, Image or path
        Further stacks of the patient, to which the surface is fitted as well, see :mod:`.stacks`.

    Yields
    ------
    Step

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the volume is not given in mm, the region is too thin for a surface or does not lie on the image's grid, or a
        boundary point is not finite, or more than 30 mm away from the fitted surface and from any shape through it.
    """
    start, image, options = time.perf_counter(), as_image(image), options or FitOptions()
    check_scale(image)
    points, stacks = checked_boundary_points(boundary_points), stacks_beside(image, further)
    history: list[Step] = []
    whole = region
    if stacks and region.touches_border:
        whole, stacks = yield from complete_region(image, region, options, stacks, history)
    model, schedule, frame = _planned(image, whole, options)
    joint = JointStacks(stacks, frame)
    outcome = yield from recorded(_register(model, schedule, options, joint), history, local_to_ras=frame)
    fit = yield from with_boundary_points(image, history, outcome, points, asked=options, region=region, start=start)
    started_here = fit.region is region
    return replace(fit, whole_region=whole) if started_here and whole is not region else fit


def _planned(image: Image, region: Region, options: FitOptions) -> tuple[BSplineSurface, Schedule, np.ndarray]:
    """Place a generic model and make the schedule of its fit; returns both, and the matrix (4, 4) to RAS mm."""
    pose = moments(region)
    schedule = Schedule.of_region(image, region, pose, options.filled_in(threshold=region.threshold))
    net = first_net(options.net, options.closure)
    model = generic_model(options.model, schedule.region.shape(pose.extents), net, options.closure)
    return model, schedule, frame_of(pose)


def complete_region(
    image: Image, region: Region, options: FitOptions, stacks: tuple[Stack, ...], history: list[Step]
) -> Generator[Step, None, tuple[Region, tuple[Stack, ...]]]:
    """Complete a region that the first stack cuts off, by what further stacks show beyond its border.

    A surface is fitted in the first stack alone, and the motions of the further stacks are found with it. That surface
    ends where the stack does, so both are done again with the completed region: the motions of the demo's vagina and
    rectum are then off by 0.1 to 0.3 mm in place of 0.5 to 2.8 mm. A third time changes nothing.

    Parameters
    ----------
    image : Image
        The first stack.
    region : Region
        Of the organ in it.
    options : FitOptions
    stacks : tuple of Stack
    history : list of Step
        The steps of the fit to the first stack are appended.

    Yields
    ------
    Step

    Returns
    -------
    region : Region
        As of :func:`.completion.completed_region`.
    stacks : tuple of Stack
        With the motions that were found.
    """
    whole = region
    for prefix in ("first stack alone, ", "first stack alone, completed region, "):
        model, schedule, frame = _planned(image, whole, options)
        start = yield from recorded(_started(model, schedule, prefix), history, local_to_ras=frame)
        joint = JointStacks(stacks, frame)
        joint.beside(schedule, start.coarse.surface)
        uses = joint.uses(schedule, start.coarse.surface)
        stacks = tuple(use.stack if use.used else stack for use, stack in zip(uses, stacks))
        whole = completed_region(image, region, [(use.image, use.motion) for use in uses if use.used])
        if whole is region:
            break
    return whole, stacks


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a fit before boundary points, without the surface, which is that of the last step.

    Parameters
    ----------
    options : FitOptions
        With the automatic choices filled in.
    choices : tuple of Choice
    cost_initial : float
        Cost of the surface from which the fit started, with the levels of the last stage.
    stacks : tuple of StackUse
    """

    options: FitOptions
    choices: tuple[Choice, ...]
    cost_initial: float
    stacks: tuple[StackUse, ...] = ()


def _register(
    model: BSplineSurface, schedule: Schedule, options: FitOptions, stacks: JointStacks
) -> Generator[Step, None, Outcome]:
    """Register a generic model in the organ's frame; repeated without a stack that contradicts the first one."""
    start = yield from _started(model, schedule)
    while True:
        outcome = yield from _on_grey_levels(model, start, schedule, options, stacks)
        if not stacks.leave_out_contradicting():
            return outcome


@dataclass(frozen=True)
class _Start:
    """Last steps of three stages in the first stack: scaling, region, and grey levels, coarse."""

    scaled: Step
    on_region: Step
    coarse: Step


def _started(model: BSplineSurface, schedule: Schedule, prefix: str = "") -> Generator[Step, None, _Start]:
    """Run the stages of :class:`_Start` from a generic model; the prefix is put before their names."""
    closure = schedule.options.closure
    template = sampled_net(net_of(model, closure), closure)
    scaling = SampledSurface(affine(model, free="scaling", center=np.zeros(3)), template.grid)
    steps = []
    for stage in (schedule.scaling, schedule.on_region, schedule.coarse):
        stage = replace(stage, name=f"{prefix}{stage.name}")
        steps.append((yield from last_step(stage, template.at(steps[-1].surface) if steps else scaling)))
    return _Start(*steps)


def _on_grey_levels(
    model: BSplineSurface, start: _Start, schedule: Schedule, options: FitOptions, stacks: JointStacks
) -> Generator[Step, None, Outcome]:
    """Register on the grey levels of all stacks, coarse and fine, then with finer nets."""
    scaled, on_region = start.scaled, start.on_region
    first = net_of(model, options.closure)
    template = sampled_net(first, options.closure)
    schedule, coarse = yield from stacks.joined(schedule, start.coarse, template)
    if not schedule.views:
        # If all further stacks were left out, the result must be that of the first stack alone.
        schedule = schedule.without_partial_volumes()
    schedule, choices = choose_by(coarse, schedule.chosen(net=first), options)
    fine = yield from last_step(schedule.fine, template.at(coarse.surface))
    found, limited = yield from within_drift_limit(
        fine, schedule, template, on_region=on_region, fallback=scaled, called="scaled model"
    )
    found, (chosen_net, *more) = yield from fit_finer(found, schedule, options.net)
    schedule, found = yield from stacks.settled(schedule, found)
    found, resort = yield from valid_at_last(found, schedule)
    net = net_of(found.surface, options.closure)
    choices = (replace(chosen_net, value=net_text(net)), *choices, *limited, *more, *resort)
    cost = _cost_of_model(model, found.surface, schedule)
    return Outcome(schedule.options.filled_in(net=net), choices, cost, stacks.uses(schedule, found.surface))


def _cost_of_model(model: BSplineSurface, found: BSplineSurface, schedule: Schedule) -> float:
    """Cost of the generic model, with the levels along the surface that was found."""
    net, closure = schedule.options.net, schedule.options.closure
    halvings = halvings_to(found, net, closure)
    for _ in range(halvings):
        model = model.refined()
    template = sampled_net(net, closure, halvings)
    return schedule.fine.cost_of(template.at(found), model)


def used_points(points: np.ndarray, options: FitOptions) -> np.ndarray:
    """Return the boundary points that are used: none if their weight is 0."""
    return points if options.boundary_weight > 0.0 else points[:0]


def with_boundary_points(
    image: Image,
    history: list[Step],
    outcome: Outcome,
    points: np.ndarray,
    *,
    asked: FitOptions,
    region: Region | None,
    start: float,
    surface: BSplineSurface | None = None,
) -> Generator[Step, None, OrganFit]:
    """Correct the surface by boundary points, and collect the result.

    Parameters
    ----------
    image : Image
    history : list of Step
        Steps so far; those of a second fit through the boundary points are appended.
    outcome : Outcome
    points : (n, 3) ndarray
        Boundary points, RAS mm.
    asked : FitOptions
        As given by the user.
    region : Region or None
    start : float
        Start of the fit, in seconds of :func:`time.perf_counter`.
    surface : BSplineSurface, optional
        The surface before the correction; that of the last step if not given.

    Yields
    ------
    Step

    Returns
    -------
    OrganFit
    """
    uncorrected = pulled = history[-1].surface if surface is None else surface
    points, correction, whole_region = used_points(points, outcome.options), [], None
    again = yield from _restarted(image, uncorrected, points, asked, outcome.stacks, history)
    if again is not None:
        pulled = again.surface
        outcome = Outcome(again.options, again.choices, again.cost_initial, again.stacks)
        region, whole_region = again.region, again.whole_region
    options, choices = outcome.options, outcome.choices
    if len(points):
        yield from recorded(correct(image, pulled, points, options, outcome.stacks), correction)
    steps = (*history, *correction)
    net = net_of(steps[-1].surface, options.closure)
    if net != net_of(pulled, options.closure):
        choices = tuple(_made_finer(choice, net) if choice.option == "net" else choice for choice in choices)
    return OrganFit(
        surface=steps[-1].surface,
        region=region,
        history=steps,
        converged=all(part[-1].converged for part in (history, correction) if part),
        cost_initial=outcome.cost_initial,
        cost_final=steps[-1].cost,
        seconds=time.perf_counter() - start,
        options=options.filled_in(net=net),
        boundary_points=points,
        uncorrected=uncorrected,
        choices=choices,
        image=image,
        stacks=outcome.stacks,
        whole_region=whole_region,
    )


def _restarted(
    image: Image,
    surface: BSplineSurface,
    points: np.ndarray,
    asked: FitOptions,
    stacks: Sequence[StackUse],
    history: list[Step],
) -> Generator[Step, None, OrganFit | None]:
    """Separate an organ again through its boundary points, and fit it, if the points contradict the first fit.

    Returns None if they do not, or if the new fit does not agree with them better.
    """
    if not len(points):
        return None
    away = np.abs(closest_points(surface, points).distances)
    restart = separated_through(image, surface, points, away) if contradicted(away) else None
    if restart is None:
        return None
    further = [Stack(use.image, use.name, use.motion) for use in stacks]
    try:
        steps = fit_region(image, restart.region, asked.filled_in(threshold=None), further=further)
        fit = yield from recorded(steps, history, prefix="through the points, ")
    except ValueError:
        return None
    return fit if restart.replaces(image, fit.surface, surface, points, away) else None


def _made_finer(choice: Choice, net: tuple[int, int]) -> Choice:
    """Add to the choice of the net that boundary points needed a finer one."""
    reason = Diagnostic("made_finer", {"net": choice.value})
    return replace(choice, value=net_text(net), reasons=(*choice.reasons, reason))
