"""Fit a given surface to the grey levels again, or correct it by boundary points."""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image, as_image
from ..imaging.region import Region
from .boundary_points import checked_boundary_points
from .choices import choose_beside, choose_by
from .joint_stacks import JointStacks
from .nets import closure_of, net_of, sampled
from .options import FitOptions
from .organ import Outcome, used_points, with_boundary_points
from .organ_fit import OrganFit
from .schedule import ANCHOR, Schedule
from .stacks import Stack, stacks_beside
from .stages import Step, last_step
from .steps import recorded

# A surface does not lie at its edge if a stage without strong anchor lowers its cost by more than this share. Fitted
# surfaces gain 0.03 to 0.36 on phantoms and real bladders, those that were moved by 1.5 mm at least 0.65.
_LARGEST_GAIN_AT_EDGE = 0.5


def refit(
    image: Image,
    surface: BSplineSurface,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    region: Region | None = None,
    further: Sequence[Stack | Image] = (),
) -> Generator[Step, None, OrganFit]:
    """Fit a given surface again, step by step.

    Without boundary points, the whole surface is fitted to the grey levels. If it lies at its edge already, it is held
    there. With boundary points, the surface is corrected around the points only, see :mod:`.correction`; corrections by
    earlier points stay. Points more than 10 mm off contradict the surface, see :mod:`.restart`: if the image shows an
    organ through them, that organ is fitted first. To remove a point, start from `OrganFit.uncorrected` with the
    remaining points.

    Parameters
    ----------
    image : Image or path
        The grey levels.
    surface : BSplineSurface
        A closed organ near its edge, RAS mm. It keeps its net and its closure; the net of the options is used only if
        the organ is separated again.
    options : FitOptions, optional
    boundary_points : (n, 3) array_like, optional
        Points on the organ's wall, RAS mm.
    region : Region, optional
        The region of the earlier fit, for the result. It is replaced if the organ is separated again.
    further : sequence of Stack, Image or path
        Further stacks of the patient. `StackUse.stack` of an earlier fit starts with the motion that was found.

    Yields
    ------
    Step

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the surface is no closed organ or lies outside of the volume, or a boundary point is not finite, or more than
        30 mm away from the surface and from any shape through it.
    """
    start, image = time.perf_counter(), as_image(image)
    points = checked_boundary_points(boundary_points)
    stacks = JointStacks(stacks_beside(image, further), np.eye(4))
    closure = closure_of(surface)
    asked = (options or FitOptions()).filled_in(closure=closure)
    options = asked.filled_in(net=net_of(surface, closure))
    if region is not None:
        options = options.filled_in(threshold=region.threshold)
    history: list[Step] = []
    if len(used_points(points, options)):
        outcome = _kept(image, surface, options, stacks)
        given = {"asked": asked, "region": region, "start": start, "surface": surface}
        return (yield from with_boundary_points(image, history, outcome, points, **given))
    while True:
        outcome = yield from recorded(_fit_again(image, surface, options, stacks), history)
        if not stacks.leave_out_contradicting():
            break
    return (yield from with_boundary_points(image, history, outcome, points, asked=asked, region=region, start=start))


def _kept(image: Image, surface: BSplineSurface, options: FitOptions, stacks: JointStacks) -> Outcome:
    """Choose the options by a surface that is not fitted before the correction."""
    schedule, choices = choose_beside(surface, Schedule.around(image, surface, options), options)
    schedule = stacks.beside(schedule, surface)
    cost = schedule.fine.cost_of(sampled(surface, options.closure), surface)
    return Outcome(schedule.options, choices, cost, stacks.uses(schedule, surface))


def _fit_again(
    image: Image, surface: BSplineSurface, options: FitOptions, stacks: JointStacks
) -> Generator[Step, None, Outcome]:
    """Fit a surface to the grey levels again, step by step.

    Smoothness and anchor are chosen by a first coarse stage, whose surface is not kept. If it lowers the cost by much,
    the given surface was not at its edge: a second coarse stage is run, and the fine stage is anchored to its surface.
    Otherwise the fine stage is anchored to the given surface, which then moves little.
    """
    schedule, _ = choose_beside(surface, Schedule.around(image, surface, options), options)
    schedule = stacks.beside(schedule, surface)
    sampled_surface = sampled(surface, options.closure)
    before = schedule.coarse.cost_of(sampled_surface, surface)
    free = yield from last_step(replace(schedule.coarse, name="grey levels, first look"), sampled_surface)
    schedule, choices = choose_by(free, schedule, options)
    reached = surface
    if free.cost < (1.0 - _LARGEST_GAIN_AT_EDGE) * before:
        reached = (yield from last_step(schedule.chosen(anchor=ANCHOR).coarse, sampled_surface)).surface
    schedule = stacks.realigned(schedule, reached)
    reached = (yield from last_step(schedule.fine, sampled_surface.at(reached))).surface
    cost = schedule.fine.cost_of(sampled_surface.at(reached), surface)
    return Outcome(schedule.options, choices, cost, stacks.uses(schedule, reached))
