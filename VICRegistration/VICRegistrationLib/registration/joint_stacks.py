"""Further stacks during a fit: aligned with the surface, in turn with it, and left out where they do not agree."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from ..messages import Diagnostic
from .alignment import (
    LARGEST_SHIFT_MM,
    LARGEST_TURN_DEGREES,
    Alignment,
    align,
    judged,
    known_lines,
    surroundings,
)
from .nets import halvings_to, sampled_net
from .partial_volumes import PartialVolumes
from .relative_motions import relative_motions
from .sample_grid import SampledSurface
from .schedule import Schedule
from .stack_view import View
from .stacks import Stack, StackUse, rotation_degrees, shift_of
from .stages import Step, last_step

# A stack with a smaller share of the surface's area does not determine a motion.
_LEAST_SEEN = 0.15
# A stack that shows less of an edge along the surface, or differs more from one, does not show the organ as it is.
# The cost may be more before the surface was fitted to it.
_LEAST_EDGE, _LARGEST_COST, _LARGEST_COST_TO_START = 0.5, 0.2, 0.35
# How far edges of two stacks may be from each other where both show them, root mean square and mean, mm and pixels.
# Seen in pixels of 0.59 mm: up to 0.08 and 0.02 mm for the demo's organs, from 0.15 and 0.13 mm (vagina), 0.33 and
# 0.32 mm (rectum), 0.75 mm (bladder) where they have grown by 3 %; up to 0.20 and 0.17 mm for a real bladder. The mean
# is what another filling changes most.
_LARGEST_APART_MM, _LARGEST_APART_PIXELS = 0.35, 0.55
_LARGEST_GROWTH_MM, _LARGEST_GROWTH_PIXELS = 0.2, 0.27
# Share of a surface that the first stack shows away from its border, from which all others are aligned with it at once.
# Where all are at once in any case, the demo's vagina is 0.12 mm off in three stacks that cut it, in place of 0.04 mm;
# one after the other in any case, the bladder's motions are off by 0.15 mm in place of 0.11 mm.
_MOSTLY_KNOWN = 0.95
# How often the edges of stacks are compared with each other at most, and at which displacement they are at rest, mm.
_TURNS, _AT_REST_MM = 8, 0.1
# How far a surface may move in a stack before that is cut out around it again, mm.
_KEPT_MM = 2.0
# No image is taken for clearer than this mean squared residual: half and ten times of it give the demo's organs the
# same distances. With 1 / 60, a second stack with five times the noise made them worse by 0.02 mm.
_CLEAREST = 1e-4


class JointStacks:
    """The further stacks of a fit, and where each one shows the surface.

    Parameters
    ----------
    stacks : sequence of Stack
    frame : (4, 4) ndarray
        Rigid: takes the frame in which the surface is fitted to the first image's RAS mm.

    Attributes
    ----------
    stacks, frame
    """

    def __init__(self, stacks: Sequence[Stack], frame: np.ndarray):
        self.stacks, self.frame = tuple(stacks), frame
        self._reasons: list[Diagnostic | None] = [None] * len(self.stacks)
        self._found: list[Alignment | None] = [None] * len(self.stacks)
        self._deviations = np.full((len(self.stacks), 2), np.nan)
        self._own = None
        self._fitted: set[int] = set()
        self._kept: dict[int, tuple[np.ndarray, Sampler, PartialVolumes]] = {}

    def joined(
        self, schedule: Schedule, step: Step, space: SampledSurface
    ) -> Generator[Step, None, tuple[Schedule, Step]]:
        """Align all stacks with a surface of the first one, and fit it to those that show it.

        Parameters
        ----------
        schedule : Schedule
        step : Step
            Last step of the coarse stage.
        space : SampledSurface
            Of its net.

        Yields
        ------
        Step

        Returns
        -------
        schedule : Schedule
            With the stacks that are used.
        step : Step
            Last step of the coarse stage with all of them.
        """
        if not self.stacks:
            return schedule, step
        self._fitted.clear()
        known = known_lines(schedule.sampler, step.surface)
        together = float(known.mean()) > _MOSTLY_KNOWN
        # What a stack adds to a surface that the first one cuts, the next one is aligned with.
        groups = [range(len(self.stacks))] if together else [[number] for number in range(len(self.stacks))]
        for group in groups:
            self._aligned(schedule, step.surface, group)
            schedule = self._compared(schedule, step.surface)
            if not any(self._used(number) for number in group):
                continue
            name = "all stacks" if together else f"{len(schedule.views) + 1} stacks"
            stage = replace(schedule.coarse, name=f"grey levels, coarse, {name}")
            step = yield from last_step(stage, space.at(step.surface))
            self._fitted.update(group)
        return schedule, step

    def beside(self, schedule: Schedule, surface: BSplineSurface) -> Schedule:
        """Align all stacks with a surface, and give those that show it to a schedule."""
        if not self.stacks:
            return schedule
        self._aligned(schedule, surface, range(len(self.stacks)))
        return self._compared(schedule, surface)

    def realigned(self, schedule: Schedule, surface: BSplineSurface) -> Schedule:
        """Find the motions of the stacks that are used again, near a surface that was fitted to all of them."""
        self._fitted.update(self._all_used)
        return self._compared(schedule, surface, measure=True)

    def _compared(self, schedule: Schedule, surface: BSplineSurface, *, measure: bool = False) -> Schedule:
        """Find the motions of the stacks that are used by each other's edges near a surface; see :meth:`_judge`."""
        if self._all_used:
            self._judge_own(schedule, surface)
        for turn in range(_TURNS):
            for number in self._all_used:
                self._judge(schedule, surface, number, measure=measure and turn == 0)
            used = self._all_used
            if not used:
                break
            found = [self._found[number] for number in used]
            trusts = [1.0, *(trust_of(each, self._own) for each in found)]
            relative = relative_motions(surface, [self._own, *found], trusts)
            for number, motion, deviations in zip(used, relative.motions, relative.deviations):
                self._found[number] = self._found[number].at(motion)
                self._deviations[number] = deviations
            if relative.moved < _AT_REST_MM:
                break
        return self._with_views(schedule)

    def settled(self, schedule: Schedule, found: Step) -> Generator[Step, None, tuple[Schedule, Step]]:
        """Align once more at the end, and fit the surface to it.

        Without it the motions of the demo's bladder in two further stacks are off by 0.13 in place of 0.09 mm, and by
        0.30 in place of 0.08 mm where the first stack cuts it.
        """
        if not schedule.views:
            return schedule, found
        schedule, surface = self.realigned(schedule, found.surface), found.surface
        if not schedule.views:
            return schedule, found
        net, closure = schedule.options.net, schedule.options.closure
        space = sampled_net(net, closure, halvings_to(surface, net, closure))
        stage = replace(schedule.fine, name="grey levels, fine, motion found again")
        found = yield from last_step(stage, space.at(surface))
        return schedule, found

    def leave_out_contradicting(self) -> bool:
        """Leave out the stack that contradicts the first one most, by a surface that was fitted to both; if one does.

        Before the surface is as fine as the organ, it is off its edge in every stack, and no stack can be judged.
        """
        excess = [
            0.0 if reason is not None else self._excess(stack, found)
            for stack, reason, found in zip(self.stacks, self._reasons, self._found)
        ]
        if not excess or max(excess) <= 1.0:
            return False
        worst = int(np.argmax(excess))
        apart, _ = self._found[worst].disagreement(self._own)
        self._reasons[worst] = Diagnostic("stack_shows_another_shape", {"apart_mm": apart})
        return True

    def uses(self, schedule: Schedule, surface: BSplineSurface) -> tuple[StackUse, ...]:
        """Say what became of each stack, by the surface in the end, in the frame of the fit."""
        if self._all_used:
            self._judge_own(schedule, surface)
        for number in self._all_used:
            self._judge(schedule, surface, number)
        center = self._center(surface)
        return tuple(
            StackUse(
                name=stack.name,
                image=stack.image,
                reason=reason,
                motion=self._motion(stack, found),
                center=center,
                seen=found.seen,
                cost=found.cost,
                rotation_sd_degrees=float(turn),
                translation_sd_mm=float(shift),
            )
            for stack, reason, found, (turn, shift) in zip(self.stacks, self._reasons, self._found, self._deviations)
        )

    # ------------------------------------------------------------------ one stack

    def _excess(self, stack: Stack, found: Alignment) -> float:
        """How much a stack contradicts the first one, in units of what is allowed."""
        apart, wider = found.disagreement(self._own)
        pixel = float(min(stack.image.spacing))
        return max(
            apart / max(_LARGEST_APART_MM, _LARGEST_APART_PIXELS * pixel),
            abs(wider) / max(_LARGEST_GROWTH_MM, _LARGEST_GROWTH_PIXELS * pixel),
            found.cost / _LARGEST_COST,
        )

    def _used(self, number: int) -> bool:
        return self._found[number] is not None and self._reasons[number] is None

    @property
    def _all_used(self) -> list[int]:
        return [number for number in range(len(self.stacks)) if self._used(number)]

    def _known(self, schedule: Schedule, surface: BSplineSurface, number: int) -> np.ndarray:
        """How well the lines of a surface are known from all other stacks that it was fitted to, (n,)."""
        others = [other for other in self._fitted if other != number and self._used(other)]
        samplers = [schedule.sampler, *(self._found[other].view.sampler for other in others)]
        return np.maximum.reduce([known_lines(sampler, surface) for sampler in samplers])

    def _aligned(self, schedule: Schedule, surface: BSplineSurface, numbers: Sequence[int]) -> None:
        """Find where some of the stacks show a surface, and which ones do not."""
        for number in numbers:
            if self._reasons[number] is not None:
                continue
            stack, before = self.stacks[number], self._found[number]
            start = np.eye(4) if before is None else before.motion
            known = self._known(schedule, surface, number)
            found = align(self._local(stack), surface, start, known=known)
            self._found[number] = found
            self._reasons[number] = self._why_not(stack, found, surface)

    def _judge_own(self, schedule: Schedule, surface: BSplineSurface) -> None:
        """Measure what the first stack shows of a surface."""
        known = known_lines(schedule.sampler, surface)
        self._own = judged(schedule.sampler, surface, np.eye(4), known=known, volumes=schedule.volumes)

    def _judge(self, schedule: Schedule, surface: BSplineSurface, number: int, *, measure: bool = False) -> None:
        """Measure what a stack shows of a surface after its motion.

        The width of its edge is measured too if `measure` is true, which takes as long as the rest; otherwise the last
        one is taken.
        """
        stack, before, known = self.stacks[number], self._found[number], self._known(schedule, surface, number)
        sampler, volumes = self._surroundings(number, surface.transformed(before.motion))
        given = {"known": known, "volumes": volumes, "tau": None if measure else before.view.tau}
        found = self._found[number] = judged(sampler, surface, before.motion, **given)
        if found.view is None:
            self._reasons[number] = Diagnostic("stack_shows_little", {"share": float(found.common)})
        else:
            self._reasons[number] = self._moved_far(stack, found, surface)

    def _surroundings(self, number: int, moved: BSplineSurface) -> tuple[Sampler, PartialVolumes]:
        """Cut out a stack around a surface in it, with its partial volumes; kept while the surface hardly moves."""
        kept = self._kept.get(number)
        net = moved.control_net.reshape(-1, 3)
        # Both ends of the box count upwards.
        box = np.append(-net.min(axis=0), net.max(axis=0))
        if kept is None or (box - kept[0]).max() > _KEPT_MM:
            sampler = surroundings(self._local(self.stacks[number]), moved, margin=_KEPT_MM)
            kept = self._kept[number] = box, sampler, PartialVolumes(sampler.image)
        return kept[1:]

    def _local(self, stack: Stack) -> Image:
        """Take a stack to the frame of the fit."""
        to_frame = np.linalg.inv(self.frame) @ np.linalg.inv(stack.motion)
        return Image(stack.image.array, to_frame @ stack.image.ijk_to_ras)

    def _motion(self, stack: Stack, found: Alignment) -> np.ndarray:
        """Whole motion of a stack, RAS mm."""
        return stack.motion @ self.frame @ found.motion @ np.linalg.inv(self.frame)

    def _center(self, surface: BSplineSurface) -> np.ndarray:
        """Centre of a surface, (3,) RAS mm."""
        return surface.transformed(self.frame).control_net.reshape(-1, 3).mean(axis=0)

    def _why_not(self, stack: Stack, found: Alignment, surface: BSplineSurface) -> Diagnostic | None:
        """Why a stack is not used, or None."""
        if found.view is None or found.common < _LEAST_SEEN:
            return Diagnostic("stack_shows_little", {"share": float(found.common)})
        if found.edge < _LEAST_EDGE or found.cost > _LARGEST_COST_TO_START:
            return Diagnostic("stack_shows_no_edge", {"cost": float(found.cost)})
        return self._moved_far(stack, found, surface)

    def _moved_far(self, stack: Stack, found: Alignment, surface: BSplineSurface) -> Diagnostic | None:
        """Why a stack is farther away than a patient moves, or None."""
        motion = self._motion(stack, found)
        away = float(np.linalg.norm(shift_of(motion, self._center(surface))))
        turn = rotation_degrees(motion)
        if away > LARGEST_SHIFT_MM or turn > LARGEST_TURN_DEGREES:
            return Diagnostic("stack_moved_far", {"shift_mm": away, "turn_degrees": turn})
        return None

    def _with_views(self, schedule: Schedule) -> Schedule:
        """Give the stacks that are used to a schedule."""
        views = [trusted(found, self._own) for number, found in enumerate(self._found) if self._used(number)]
        return replace(schedule, views=tuple(views))


def with_stacks(
    schedule: Schedule, surface: BSplineSurface, stacks: Sequence[StackUse], *, points: np.ndarray | None = None
) -> Schedule:
    """Give the stacks that a fit has used to a schedule, where the fit has found them.

    Parameters
    ----------
    schedule : Schedule
        In RAS mm.
    surface : BSplineSurface
        RAS mm.
    stacks : sequence of StackUse
    points : (n, 3) ndarray, optional
        Boundary points, RAS mm.

    Returns
    -------
    Schedule
    """
    used = [stack for stack in stacks if stack.used]
    if not used:
        return schedule
    own = judged(schedule.sampler, surface, np.eye(4), volumes=schedule.volumes)
    views = []
    for stack in used:
        moved = Image(stack.image.array, stack.to_first @ stack.image.ijk_to_ras)
        sampler = surroundings(moved, surface, points=points)
        found = judged(sampler, surface, np.eye(4), volumes=PartialVolumes(sampler.image))
        if found.view is not None:
            views.append(trusted(found, own))
    return replace(schedule, views=tuple(views))


def trusted(found: Alignment, own: Alignment) -> View:
    """View of a stack with its trust, see :func:`trust_of`."""
    return replace(found.view, trust=trust_of(found, own))


def trust_of(found: Alignment, own: Alignment) -> float:
    """How much a voxel of a stack counts: the less, the more it differs from an edge than the first image, `own`."""
    return max(own.cost, _CLEAREST) / max(found.cost, _CLEAREST)
