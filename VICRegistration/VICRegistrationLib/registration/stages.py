"""A multi-scale plan: stages that run one after the other, each a generator of steps."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler
from .cost import Correlation, Objective
from .sample_grid import Frame, SampledSurface
from .solvers import SOLVERS, Iterate
from .virtual_image import VirtualImage

STOP_RULES = ("displacement", "parameters")
# A solver that expected a larger share of the cost than this to go, and got almost nothing, is stuck, not at rest.
_STUCK = 0.05


@dataclass(frozen=True, eq=False)
class FurtherImage:
    """A further image that a stage compares its surface with.

    Parameters
    ----------
    sampler : Sampler
        The image, in the frame of the surface.
    virtual : VirtualImage
        With the image's own levels, width of the edge and voxel.
    trust : float
        How much a voxel of it counts beside one of the first image.
    """

    sampler: Sampler
    virtual: VirtualImage
    trust: float = 1.0


def line_shares(images: Sequence[FurtherImage], frame: Frame, reach: float) -> np.ndarray:
    """Divide each normal line's weight among several images of one surface.

    Parameters
    ----------
    images : sequence of FurtherImage
    frame : Frame
        Of the surface at n samples.
    reach : float
        Of the samples along a line, in widths of the ramp.

    Returns
    -------
    (len(images), n) ndarray
        Sums to 1 on every line: a line has the weight that it has with one image, so that the energies keep theirs.

    Notes
    -----
    An image counts by the voxels that it has for a piece of the surface, and by the inverse square of a voxel's length
    along the normal: the steeper the edge, the better its place is known. Where a line leaves an image, that has no
    part of it.
    """
    weights = []
    for image in images:
        virtual = image.virtual
        ends = virtual.profile.depths(reach, 3)
        seen = image.sampler.values(frame.along_normals(ends))[1].mean(axis=1)
        length = np.linalg.norm(frame.normals @ virtual.voxel, axis=1)
        weights.append(image.trust * seen / (abs(np.linalg.det(virtual.voxel)) * length**2))
    total = np.sum(weights, axis=0)
    return np.where(total > 0.0, np.array(weights) / np.where(total > 0.0, total, 1.0), 1.0 / len(images))


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of a registration.

    Parameters
    ----------
    name : str
        Shown with progress and in the convergence table.
    sampler : Sampler
        The image of this stage.
    virtual : VirtualImage
        What it is compared with.
    reach : float
        Samples lie between -reach and +reach widths from the surface (from the middle of the ramp).
    n_depths : int
        Number of samples along each normal.
    bending, sliding, anchor : float
        Weights of energies of the displacement since the stage began, in units of the ramp's width; dimensionless.
        Bending is the thin-plate energy (1 for one wave around the organ as high as the ramp is wide), sliding the mean
        square within the surface, which the image does not determine, anchor the mean square along the normal.
    loss : {"squares", "huber"}
        With "huber", samples with large residuals have less weight, see :func:`.cost.huber_shares`.
    solver : {"gauss-newton", "gradient-descent"}
    stop_rule : {"displacement", "parameters"}
        Stop when no control point moved by more than `tolerance` (mm), or no degree of freedom changed by more than
        `tolerance`: the paper's rules for local and for global registration.
    tolerance : float
    cost_tolerance : float
        Stop as well when an iteration lowered the cost by less than this fraction; 0 leaves only the paper's rules.
    max_iterations : int
    largest_step : float
        Largest displacement of a control point in one iteration, mm.
    further : tuple of FurtherImage
        More images that show the same surface.
    """

    name: str
    sampler: Sampler
    virtual: VirtualImage
    reach: float = 1.0
    n_depths: int = 9
    bending: float = 0.0
    sliding: float = 0.0
    anchor: float = 0.0
    loss: str = "squares"
    solver: str = "gauss-newton"
    stop_rule: str = "displacement"
    tolerance: float = 0.01
    cost_tolerance: float = 0.0
    max_iterations: int = 50
    largest_step: float = 10.0
    further: tuple[FurtherImage, ...] = ()

    def correlation(self, surface: SampledSurface, *, share: np.ndarray | None = None) -> Correlation:
        """Make the correlation of a surface with the image of this stage, with shares of the lines' weights."""
        depths = self.virtual.profile.depths(self.reach, self.n_depths)
        return Correlation(self.sampler, self.virtual, surface, depths=depths, loss=self.loss, share=share)

    def correlations(self, surface: SampledSurface, *, share: np.ndarray | None = None) -> tuple[Correlation, ...]:
        """Make the correlations of a surface with all images, each with its part of the lines' weights."""
        if not self.further:
            return (self.correlation(surface, share=share),)
        images = (FurtherImage(self.sampler, self.virtual), *self.further)
        parts = line_shares(images, surface.frame(np.zeros(surface.n_dof)), self.reach)
        stages = (replace(self, sampler=image.sampler, virtual=image.virtual) for image in images)
        return tuple(
            stage.correlation(surface, share=part if share is None else share * part)
            for stage, part in zip(stages, parts)
        )

    def objective(self, surface: SampledSurface) -> Objective:
        """Make what this stage minimises over the degrees of freedom of a surface."""
        first, *others = correlations = self.correlations(surface)
        energies = first.energies(bending=self.bending, sliding=self.sliding, anchor=self.anchor, others=others)
        return Objective(correlations, stiffness=energies)

    def cost_of(self, surface: SampledSurface, other: BSplineSurface) -> float:
        """Cost in all images of another surface that the degrees of freedom reach, with the levels along this one."""
        return Objective(self.correlations(surface)).cost_of(other)


@dataclass(frozen=True, eq=False)
class Step:
    """What is known after one iteration.

    Parameters
    ----------
    stage : str
        Name of the stage.
    iteration : int
        Number of the iteration in this stage, from 1.
    cost : float
        Mean squared residual in units of the contrast.
    displacement : float
        Largest displacement of a control point, mm.
    surface : BSplineSurface
        The surface now.
    stopped_by : str
        Why the stage ends here: "displacement" or "parameters" (its stop rule), "cost" (the cost fell by less than the
        tolerance), "no better point" (the solver is stuck), "iterations" (as many as allowed); empty before its end.
    """

    stage: str
    iteration: int
    cost: float
    displacement: float
    surface: BSplineSurface
    stopped_by: str = ""

    @property
    def converged(self) -> bool:
        """Whether the stage came to rest by its rules."""
        return self.stopped_by in (*STOP_RULES, "cost")


def run_stage(stage: Stage, surface: SampledSurface) -> Generator[Step, None, np.ndarray]:
    """Run one stage from a surface on (q = 0).

    Parameters
    ----------
    stage : Stage
    surface : SampledSurface

    Yields
    ------
    Step
        One for every iteration.

    Returns
    -------
    (n_dof,) ndarray
        The degrees of freedom at the end.
    """
    q = np.zeros(surface.n_dof)
    for iteration, (iterate, stopped_by) in enumerate(iterate_stage(stage, stage.objective(surface)), start=1):
        q = iterate.q
        reached = surface.parametrization.deform(q)
        yield Step(stage.name, iteration, iterate.cost, iterate.displacement, reached, stopped_by)
    return q


def last_step(stage: Stage, surface: SampledSurface) -> Generator[Step, None, Step]:
    """Run a stage as :func:`run_stage` does, and return its last step."""
    step = None
    for step in run_stage(stage, surface):
        yield step
    return step


def iterate_stage(stage: Stage, objective: Objective) -> Iterator[tuple[Iterate, str]]:
    """Minimise an objective by a stage's solver and stop rules, from q = 0.

    Parameters
    ----------
    stage : Stage
    objective : Objective

    Yields
    ------
    iterate : Iterate
    stopped_by : str
        Why the stage ends here, see :class:`Step`; empty before its end.
    """
    q = np.zeros(objective.n_dof)
    iterates = SOLVERS[stage.solver](objective, q, largest_step=stage.largest_step)
    for iteration in range(1, stage.max_iterations + 1):
        iterate = next(iterates)
        stopped_by = _stopped_by(stage, iterate) or ("iterations" if iteration == stage.max_iterations else "")
        yield iterate, stopped_by
        if stopped_by:
            return


def expected_decrease(stage: Stage, surface: SampledSurface) -> float:
    """Share of its cost and energies that a stage expects of one Gauss-Newton step from a surface.

    What a whole fit brings is about twice as much, where the surface already lies near the edge.
    """
    iterate, _ = next(iterate_stage(replace(stage, solver="gauss-newton"), stage.objective(surface)))
    return iterate.expected


def _stopped_by(stage: Stage, iterate: Iterate) -> str:
    """Why a stage ends with this iterate, or nothing."""
    moved = iterate.displacement if stage.stop_rule == "displacement" else iterate.change
    if moved >= stage.tolerance and iterate.decrease >= stage.cost_tolerance:
        return ""
    if iterate.expected > _STUCK and iterate.expected > 10.0 * iterate.decrease:
        return "no better point"
    return stage.stop_rule if moved < stage.tolerance else "cost"
