"""Further stacks during a fit: their motions are found in turn with the surface; contradicting stacks are left out."""

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
    known_lines,
    measured,
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

# Smallest share of the surface's area that must lie in a stack to determine a motion.
_LEAST_SEEN = 0.15
# Smallest `edge` and largest `cost` of a stack that shows the organ. The second limit of the cost holds before the
# surface is fitted to the stack.
_LEAST_EDGE, _LARGEST_COST, _LARGEST_COST_TO_START = 0.5, 0.2, 0.35
# Largest distance between the edges of two stacks, root mean square and mean, mm and pixels. Observed in pixels of 0.59
# mm: up to 0.08 and 0.02 mm for the demo's organs, and from 0.15 and 0.13 mm (vagina), 0.33 and 0.32 mm (rectum), 0.75
# mm (bladder) after a growth of 3 %; up to 0.20 and 0.17 mm for a real bladder. Another filling of the organ changes
# the mean most.
_LARGEST_APART_MM, _LARGEST_APART_PIXELS = 0.35, 0.55
_LARGEST_GROWTH_MM, _LARGEST_GROWTH_PIXELS = 0.2, 0.27
# If the first stack shows more than this share of a surface away from its border, all others are aligned at once, and
# otherwise one after the other. With all at once in any case, the error of the demo's vagina in three stacks that cut
# it is 0.12 mm in place of 0.04 mm; one after the other in any case, that of the bladder's motions is 0.15 in place of
# 0.11 mm.
_MOSTLY_KNOWN = 0.95
# Largest number of comparisons between the edges of the stacks, and the displacement at which they end, mm.
_TURNS, _AT_REST_MM = 8, 0.1
# A stack is cropped again when the surface has moved in it by more than this, mm.
_KEPT_MM = 2.0
# Lower limit of the mean squared residual in the ratio of `voxel_weight_of`: half and ten times of it give the demo's
# organs the same distances. With 1 / 60, a second stack with five times the noise made them worse by 0.02 mm.
_CLEAREST = 1e-4


class JointStacks:
    """The further stacks of a fit, with their motions.

    Parameters
    ----------
    stacks : sequence of Stack
    frame : (4, 4) ndarray
        Rigid: takes the frame of the fit to the first image's RAS mm.

    Attributes
    ----------
    stacks, frame
    """

    def __init__(self, stacks: Sequence[Stack], frame: np.ndarray):
        self.stacks, self.frame = tuple(stacks), frame
        self._reasons: list[Diagnostic | None] = [None] * len(self.stacks)
        self._alignments: list[Alignment | None] = [None] * len(self.stacks)
        self._deviations = np.full((len(self.stacks), 2), np.nan)
        self._first = None
        self._fitted: set[int] = set()
        self._kept: dict[int, tuple[np.ndarray, Sampler, PartialVolumes]] = {}

    def joined(
        self, schedule: Schedule, step: Step, template: SampledSurface
    ) -> Generator[Step, None, tuple[Schedule, Step]]:
        """Align all stacks with a surface from the first one, and fit the surface to those that are used.

        Parameters
        ----------
        schedule : Schedule
        step : Step
            Last step of the coarse stage.
        template : SampledSurface
            Degrees of freedom and samples for its net.

        Yields
        ------
        Step

        Returns
        -------
        schedule : Schedule
            With the used stacks.
        step : Step
            Last step of the coarse stage with all of them.
        """
        if not self.stacks:
            return schedule, step
        self._fitted.clear()
        known = known_lines(schedule.sampler, step.surface)
        together = float(known.mean()) > _MOSTLY_KNOWN
        # If the first stack cuts the surface, each further stack makes more of it known for the next one.
        groups = [range(len(self.stacks))] if together else [[number] for number in range(len(self.stacks))]
        for group in groups:
            self._align(schedule, step.surface, group)
            schedule = self._with_motions(schedule, step.surface)
            if not any(self._used(number) for number in group):
                continue
            name = "all stacks" if together else f"{len(schedule.views) + 1} stacks"
            stage = replace(schedule.coarse, name=f"grey levels, coarse, {name}")
            step = yield from last_step(stage, template.at(step.surface))
            self._fitted.update(group)
        return schedule, step

    def beside(self, schedule: Schedule, surface: BSplineSurface) -> Schedule:
        """Align all stacks with a surface, and add those that are used to a schedule."""
        if not self.stacks:
            return schedule
        self._align(schedule, surface, range(len(self.stacks)))
        return self._with_motions(schedule, surface)

    def realigned(self, schedule: Schedule, surface: BSplineSurface) -> Schedule:
        """Find the motions of the used stacks again, with a surface that was fitted to all of them."""
        self._fitted.update(self._all_used)
        return self._with_motions(schedule, surface, measure=True)

    def _with_motions(self, schedule: Schedule, surface: BSplineSurface, *, measure: bool = False) -> Schedule:
        """Find the motions of the used stacks by the distances between their edges; `measure` as in `_measure`."""
        if self._all_used:
            self._measure_first(schedule, surface)
        for turn in range(_TURNS):
            for number in self._all_used:
                self._measure(schedule, surface, number, measure=measure and turn == 0)
            used = self._all_used
            if not used:
                break
            found = [self._alignments[number] for number in used]
            voxel_weights = [1.0, *(voxel_weight_of(each, self._first) for each in found)]
            relative = relative_motions(surface, [self._first, *found], voxel_weights)
            for number, motion, deviations in zip(used, relative.motions, relative.deviations):
                self._alignments[number] = self._alignments[number].at(motion)
                self._deviations[number] = deviations
            if relative.moved < _AT_REST_MM:
                break
        return self._with_views(schedule)

    def settled(self, schedule: Schedule, found: Step) -> Generator[Step, None, tuple[Schedule, Step]]:
        """Find the motions once more at the end, and fit the surface again.

        Without it the motions of the demo's bladder in two further stacks are off by 0.13 in place of 0.09 mm, and by
        0.30 in place of 0.08 mm where the first stack cuts it.
        """
        if not schedule.views:
            return schedule, found
        schedule, surface = self.realigned(schedule, found.surface), found.surface
        if not schedule.views:
            return schedule, found
        net, closure = schedule.options.net, schedule.options.closure
        template = sampled_net(net, closure, halvings_to(surface, net, closure))
        stage = replace(schedule.fine, name="grey levels, fine, motion found again")
        found = yield from last_step(stage, template.at(surface))
        return schedule, found

    def leave_out_contradicting(self) -> bool:
        """Leave out the stack that contradicts the first one most, if any does; returns whether one was left out.

        Call it after the last fit: with a coarser surface, the edges of all stacks are far from the surface.
        """
        excess = [
            0.0 if reason is not None else self._excess(stack, found)
            for stack, reason, found in zip(self.stacks, self._reasons, self._alignments)
        ]
        if not excess or max(excess) <= 1.0:
            return False
        worst = int(np.argmax(excess))
        apart, _ = self._alignments[worst].disagreement(self._first)
        self._reasons[worst] = Diagnostic("stack_shows_another_shape", {"apart_mm": apart})
        return True

    def uses(self, schedule: Schedule, surface: BSplineSurface) -> tuple[StackUse, ...]:
        """Report motion and use of each stack, for the final surface in the frame of the fit."""
        if self._all_used:
            self._measure_first(schedule, surface)
        for number in self._all_used:
            self._measure(schedule, surface, number)
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
            for stack, reason, found, (turn, shift) in zip(
                self.stacks, self._reasons, self._alignments, self._deviations
            )
        )

    # ------------------------------------------------------------------ one stack

    def _excess(self, stack: Stack, found: Alignment) -> float:
        """How much a stack contradicts the first one; it is left out above 1."""
        apart, wider = found.disagreement(self._first)
        pixel = float(min(stack.image.spacing))
        return max(
            apart / max(_LARGEST_APART_MM, _LARGEST_APART_PIXELS * pixel),
            abs(wider) / max(_LARGEST_GROWTH_MM, _LARGEST_GROWTH_PIXELS * pixel),
            found.cost / _LARGEST_COST,
        )

    def _used(self, number: int) -> bool:
        return self._alignments[number] is not None and self._reasons[number] is None

    @property
    def _all_used(self) -> list[int]:
        return [number for number in range(len(self.stacks)) if self._used(number)]

    def _known(self, schedule: Schedule, surface: BSplineSurface, number: int) -> np.ndarray:
        """Weights of the lines by all other stacks to which the surface was fitted, (n,); see `known_lines`."""
        others = [other for other in self._fitted if other != number and self._used(other)]
        samplers = [schedule.sampler, *(self._alignments[other].view.sampler for other in others)]
        return np.maximum.reduce([known_lines(sampler, surface) for sampler in samplers])

    def _align(self, schedule: Schedule, surface: BSplineSurface, numbers: Sequence[int]) -> None:
        """Align some of the stacks with a surface, and note which ones do not show it."""
        for number in numbers:
            if self._reasons[number] is not None:
                continue
            stack, before = self.stacks[number], self._alignments[number]
            start = np.eye(4) if before is None else before.motion
            known = self._known(schedule, surface, number)
            found = align(self._local(stack), surface, start, known=known)
            self._alignments[number] = found
            self._reasons[number] = self._reason_against(stack, found, surface)

    def _measure_first(self, schedule: Schedule, surface: BSplineSurface) -> None:
        """Compare a surface with the first stack."""
        known = known_lines(schedule.sampler, surface)
        self._first = measured(schedule.sampler, surface, np.eye(4), known=known, volumes=schedule.volumes)

    def _measure(self, schedule: Schedule, surface: BSplineSurface, number: int, *, measure: bool = False) -> None:
        """Compare a surface with a stack after the stack's motion.

        With `measure`, the width of the stack's edge is measured again, which takes as long as the rest; otherwise it
        is kept.
        """
        stack, before, known = self.stacks[number], self._alignments[number], self._known(schedule, surface, number)
        sampler, volumes = self._surroundings(number, surface.transformed(before.motion))
        tau = None if measure else before.view.tau
        found = self._alignments[number] = measured(
            sampler, surface, before.motion, known=known, volumes=volumes, tau=tau
        )
        if found.view is None:
            self._reasons[number] = Diagnostic("stack_shows_little", {"share": float(found.common)})
        else:
            self._reasons[number] = self._implausible_motion(stack, found, surface)

    def _surroundings(self, number: int, moved: BSplineSurface) -> tuple[Sampler, PartialVolumes]:
        """Crop a stack around a surface in it, with partial volumes; cached while the surface moves little."""
        kept = self._kept.get(number)
        net = moved.control_net.reshape(-1, 3)
        # The lower corner is negated, so that numbers increase where the bounding box grows.
        box = np.append(-net.min(axis=0), net.max(axis=0))
        if kept is None or (box - kept[0]).max() > _KEPT_MM:
            sampler = surroundings(self._local(self.stacks[number]), moved, margin=_KEPT_MM)
            kept = self._kept[number] = box, sampler, PartialVolumes(sampler.image)
        return kept[1:]

    def _local(self, stack: Stack) -> Image:
        """Move a stack to the frame of the fit by its initial motion."""
        to_frame = np.linalg.inv(self.frame) @ np.linalg.inv(stack.motion)
        return Image(stack.image.array, to_frame @ stack.image.ijk_to_ras)

    def _motion(self, stack: Stack, found: Alignment) -> np.ndarray:
        """Motion of a stack, with its initial motion, RAS mm."""
        return stack.motion @ self.frame @ found.motion @ np.linalg.inv(self.frame)

    def _center(self, surface: BSplineSurface) -> np.ndarray:
        """Centre of a surface, (3,) RAS mm."""
        return surface.transformed(self.frame).control_net.reshape(-1, 3).mean(axis=0)

    def _reason_against(self, stack: Stack, found: Alignment, surface: BSplineSurface) -> Diagnostic | None:
        """Reason for not using a stack, or None."""
        if found.view is None or found.common < _LEAST_SEEN:
            return Diagnostic("stack_shows_little", {"share": float(found.common)})
        if found.edge < _LEAST_EDGE or found.cost > _LARGEST_COST_TO_START:
            return Diagnostic("stack_shows_no_edge", {"cost": float(found.cost)})
        return self._implausible_motion(stack, found, surface)

    def _implausible_motion(self, stack: Stack, found: Alignment, surface: BSplineSurface) -> Diagnostic | None:
        """Reason against a stack with a motion that is larger than a patient's, or None."""
        motion = self._motion(stack, found)
        away = float(np.linalg.norm(shift_of(motion, self._center(surface))))
        turn = rotation_degrees(motion)
        if away > LARGEST_SHIFT_MM or turn > LARGEST_TURN_DEGREES:
            return Diagnostic("stack_moved_far", {"shift_mm": away, "turn_degrees": turn})
        return None

    def _with_views(self, schedule: Schedule) -> Schedule:
        """Add the used stacks to a schedule."""
        views = (weighted_view(self._alignments[number], self._first) for number in self._all_used)
        return replace(schedule, views=tuple(views))


def with_stacks(
    schedule: Schedule, surface: BSplineSurface, stacks: Sequence[StackUse], *, points: np.ndarray | None = None
) -> Schedule:
    """Add the stacks that a fit has used to a schedule, with the motions that it has found.

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
    own = measured(schedule.sampler, surface, np.eye(4), volumes=schedule.volumes)
    views = []
    for stack in used:
        moved = Image(stack.image.array, stack.to_first @ stack.image.ijk_to_ras)
        sampler = surroundings(moved, surface, points=points)
        found = measured(sampler, surface, np.eye(4), volumes=PartialVolumes(sampler.image))
        if found.view is not None:
            views.append(weighted_view(found, own))
    return replace(schedule, views=tuple(views))


def weighted_view(found: Alignment, own: Alignment) -> View:
    """View of a stack with the weight of its voxels, see :func:`voxel_weight_of`."""
    return replace(found.view, voxel_weight=voxel_weight_of(found, own))


def voxel_weight_of(found: Alignment, own: Alignment) -> float:
    """Weight of a stack's voxel relative to the first image's: inversely proportional to the cost."""
    return max(own.cost, _CLEAREST) / max(found.cost, _CLEAREST)
