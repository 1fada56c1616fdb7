"""Further stacks during a fit: aligned with the surface, in turn with it, and left out where they do not agree."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..messages import Diagnostic
from .alignment import LARGEST_SHIFT_MM, LARGEST_TURN_DEGREES, Alignment, align, is_found, judged, refined, surroundings
from .nets import net_of, sampled_net
from .sample_grid import SampledSurface
from .schedule import Schedule, View
from .stacks import Stack, StackUse, rotation_degrees
from .stages import Step, last_step

# A stack with a smaller share of the surface's area does not determine a motion.
_LEAST_SEEN = 0.15
# A stack that shows less of an edge along the surface, or differs more from one, does not show the organ as it is.
_LEAST_EDGE, _LARGEST_COST = 0.5, 0.2
# No image is taken for clearer than this mean squared residual.
_CLEAREST = 1.0 / 60.0


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
        self._own = None

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
        schedule = self.beside(schedule, step.surface)
        if not schedule.views:
            return schedule, step
        stage = replace(schedule.coarse, name="grey levels, coarse, all stacks")
        step = yield from last_step(stage, space.at(step.surface))
        schedule, surface = self.realigned(schedule, step.surface)
        return schedule, replace(step, surface=surface)

    def beside(self, schedule: Schedule, surface: BSplineSurface) -> Schedule:
        """Align all stacks with a surface, and give those that show it to a schedule."""
        if not self.stacks:
            return schedule
        self._aligned(schedule, surface, search=True)
        return self._with_views(schedule)

    def realigned(self, schedule: Schedule, surface: BSplineSurface) -> tuple[Schedule, BSplineSurface]:
        """Align a surface that was fitted to all stacks with the first one, and the others with it.

        Where the surface lies is for the first stack alone to say, for the others move with it; and what it says is
        little where another one is sharper. Steps of the surface alone would take many turns to find it.
        """
        if not schedule.views:
            return schedule, surface
        placed = refined(schedule.sampler, surface, np.eye(4))
        if is_found(placed):
            surface = surface.transformed(placed.motion)
        self._aligned(schedule, surface, search=False)
        return self._with_views(schedule), surface

    def settled(self, schedule: Schedule, found: Step) -> Generator[Step, None, tuple[Schedule, Step]]:
        """Align once more at the end, and fit the surface to it."""
        if not schedule.views:
            return schedule, found
        schedule, surface = self.realigned(schedule, found.surface)
        if not schedule.views:
            return schedule, found
        closure, first = schedule.options.closure, schedule.options.net
        halvings = 0
        while net_of(sampled_net(first, closure, halvings).parametrization.surface, closure) != net_of(
            found.surface, closure
        ):
            halvings += 1
        stage = replace(schedule.fine, name="grey levels, fine, motion found again")
        found = yield from last_step(stage, sampled_net(first, closure, halvings).at(surface))
        return schedule, found

    def uses(self, surface: BSplineSurface) -> tuple[StackUse, ...]:
        """Tell what became of each stack, by the surface in the end, in the frame of the fit."""
        center = self._center(surface)
        return tuple(
            StackUse(
                name=stack.name,
                image=stack.image,
                used=reason is None,
                reason=reason,
                motion=self._motion(stack, found),
                center=center,
                seen=found.seen,
                cost=found.cost,
            )
            for stack, reason, found in zip(self.stacks, self._reasons, self._found)
        )

    # ------------------------------------------------------------------ one stack

    def _aligned(self, schedule: Schedule, surface: BSplineSurface, *, search: bool) -> None:
        """Find where each stack shows a surface, and which ones do not."""
        self._own = judged(schedule.sampler, surface, np.eye(4))
        for number, stack in enumerate(self.stacks):
            if self._reasons[number] is not None:
                continue
            before = self._found[number]
            start = np.eye(4) if before is None else before.motion
            here = self._local(stack, start)
            found = align(here, surface, search=search)
            found = replace(found, motion=start @ found.motion)
            self._found[number] = found
            self._reasons[number] = self._why_not(stack, found, surface)

    def _local(self, stack: Stack, motion: np.ndarray) -> Image:
        """Take a stack to the frame of the fit, where a motion (4, 4) in that frame has it."""
        to_frame = np.linalg.inv(motion) @ np.linalg.inv(self.frame) @ np.linalg.inv(stack.motion)
        return Image(stack.image.array, to_frame @ stack.image.ijk_to_ras)

    def _motion(self, stack: Stack, found: Alignment) -> np.ndarray:
        """Whole motion of a stack, RAS mm."""
        return stack.motion @ self.frame @ found.motion @ np.linalg.inv(self.frame)

    def _center(self, surface: BSplineSurface) -> np.ndarray:
        """Centre of a surface, (3,) RAS mm."""
        return surface.transformed(self.frame).control_net.reshape(-1, 3).mean(axis=0)

    def _why_not(self, stack: Stack, found: Alignment, surface: BSplineSurface) -> Diagnostic | None:
        """Why a stack is not used, or None."""
        if found.view is None or found.seen < _LEAST_SEEN:
            return Diagnostic("stack_shows_little", {"share": float(found.seen)})
        if found.edge < _LEAST_EDGE or found.cost > _LARGEST_COST:
            return Diagnostic("stack_shows_no_edge", {"cost": float(found.cost)})
        motion, center = self._motion(stack, found), self._center(surface)
        away = float(np.linalg.norm(motion[:3, :3] @ center + motion[:3, 3] - center))
        turn = rotation_degrees(motion)
        if away > LARGEST_SHIFT_MM or turn > LARGEST_TURN_DEGREES:
            return Diagnostic("stack_moved_far", {"shift_mm": away, "turn_degrees": turn})
        return None

    def _with_views(self, schedule: Schedule) -> Schedule:
        """Give the stacks that are used to a schedule."""
        views = [trusted(found, self._own) for found, reason in zip(self._found, self._reasons) if reason is None]
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
    own = judged(schedule.sampler, surface, np.eye(4))
    views = []
    for stack in used:
        moved = Image(stack.image.array, stack.to_first @ stack.image.ijk_to_ras)
        found = judged(surroundings(moved, surface, points=points), surface, np.eye(4))
        if found.view is not None:
            views.append(trusted(found, own))
    return replace(schedule, views=tuple(views))


def trusted(found: Alignment, own: Alignment) -> View:
    """View of a stack that counts the less, the more it differs from an edge; `own` is that of the first image."""
    return replace(found.view, trust=max(own.cost, _CLEAREST) / max(found.cost, _CLEAREST))
