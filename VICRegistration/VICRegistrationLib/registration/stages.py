"""A stage of a registration: one image or several, weights, a solver and stop rules; run as a generator of steps."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler
from .cost import Correlation, Objective
from .region_boundary import BoundaryCost
from .sample_grid import Frame, SampledSurface
from .solvers import SOLVERS, Iterate
from .virtual_image import VirtualImage

STOP_RULES = ("displacement", "parameters")
# A solver that expected to lower the cost by a larger share than this, and lowered it by far less, has not converged.
_STUCK = 0.05


@dataclass(frozen=True, eq=False)
class FurtherImage:
    """A further image with which a stage compares its surface.

    Parameters
    ----------
    sampler : Sampler
        The image, in the frame of the surface.
    virtual : VirtualImage
        With this image's levels, width of the edge and voxel.
    voxel_weight : float
        Weight of a voxel, relative to a voxel of the first image.
    """

    sampler: Sampler
    virtual: VirtualImage
    voxel_weight: float = 1.0


def line_shares(images: Sequence[FurtherImage], frame: Frame, reach: float) -> np.ndarray:
    """Divide the weight of each normal line among several images of one surface.

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
        Sums to 1 on every line, so that the total weight of the images relative to the energies is that of one image.

    Notes
    -----
    An image's part is proportional to its number of voxels per area of the surface, and to the inverse square of a
    voxel's length along the normal, because a sharper edge determines the surface better. An image has no part of a
    line that leaves it.
    """
    weights = []
    for image in images:
        virtual = image.virtual
        ends = virtual.profile.depths(reach, 3)
        inside = image.sampler.values(frame.along_normals(ends))[1].mean(axis=1)
        length = np.linalg.norm(frame.normals @ virtual.voxel, axis=1)
        weights.append(image.voxel_weight * inside / (abs(np.linalg.det(virtual.voxel)) * length**2))
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
        The virtual image of this stage.
    reach : float
        Samples lie within this distance from the middle of the ramp, in widths of the ramp.
    n_depths : int
        Number of samples along each normal.
    bending, sliding, anchor : float
        Dimensionless weights of three energies of the displacement since the stage began, with the ramp's width as unit
        of length. Bending: thin-plate energy (1 for one wave around the organ with the ramp's width as amplitude).
        Sliding: mean square within the surface, which the image does not determine. Anchor: mean square along the
        normal.
    loss : {"squares", "huber"}
        With "huber", samples with large residuals have less weight, see :func:`.cost.huber_shares`.
    solver : {"gauss-newton", "gradient-descent"}
    stop_rule : {"displacement", "parameters"}
        Stop when no control point moved by more than `tolerance` (mm), or no degree of freedom changed by more than
        `tolerance`: the paper's rules for local and for global registration.
    tolerance : float
    cost_tolerance : float
        Stop also when an iteration lowered the cost by less than this fraction; 0 switches this rule off.
    max_iterations : int
    largest_step : float
        Largest displacement of a control point in one iteration, mm.
    further : tuple of FurtherImage
        Further images of the same surface.
    boundary : (m, 3) and (m,) ndarray, optional
        Points of a region's boundary, mm in the frame of the surface, and their areas: their mean squared distance
        from the surface is added to the cost, in units of the difference of the levels.
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
    boundary: tuple[np.ndarray, np.ndarray] | None = None

    def correlation(self, surface: SampledSurface, *, share: np.ndarray | None = None) -> Correlation:
        """Make the correlation of a surface with the first image; `share` are factors of the lines' weights."""
        depths = self.virtual.profile.depths(self.reach, self.n_depths)
        return Correlation(self.sampler, self.virtual, surface, depths=depths, loss=self.loss, share=share)

    def correlations(self, surface: SampledSurface, *, share: np.ndarray | None = None) -> tuple[Correlation, ...]:
        """Make the correlations with all images; their parts of the lines' weights are multiplied by `share`."""
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
        """Make the objective of this stage for the degrees of freedom of a surface."""
        first, *others = correlations = self.correlations(surface)
        energies = first.energies(bending=self.bending, sliding=self.sliding, anchor=self.anchor, others=others)
        if self.boundary is None:
            return Objective(correlations, stiffness=energies)
        unit = self.virtual.profile.outside - self.virtual.profile.inside
        # Half a voxel of the distance image. With a whole one, the error of a bladder with two tumours is 1.01 in place
        # of 0.98 mm; with 0, the demo's rectum keeps a coarser net and is off by 0.07 in place of 0.05 mm.
        accuracy = 0.5 * float(self.sampler.image.spacing.min())
        boundary = BoundaryCost(*self.boundary, surface, unit=unit, accuracy=accuracy)
        return Objective((*correlations, boundary), stiffness=energies)

    def cost_of(self, surface: SampledSurface, other: BSplineSurface) -> float:
        """Cost of another surface that the degrees of freedom reach, in all images, with the levels of `surface`."""
        return Objective(self.correlations(surface)).cost_of(other)


@dataclass(frozen=True, eq=False)
class Step:
    """State of a fit after one iteration.

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
        The surface after this iteration.
    stopped_by : str
        Empty before the end of the stage; then why it ended: "displacement" or "parameters" (its stop rule), "cost"
        (the cost fell by less than the tolerance), "no better point" (the solver found no lower cost, although it
        expected one), "iterations" (the limit was reached).
    """

    stage: str
    iteration: int
    cost: float
    displacement: float
    surface: BSplineSurface
    stopped_by: str = ""

    @property
    def converged(self) -> bool:
        """Whether the stage has ended by one of its tolerances."""
        return self.stopped_by in (*STOP_RULES, "cost")


def run_stage(stage: Stage, surface: SampledSurface) -> Generator[Step, None, np.ndarray]:
    """Run one stage from a surface (q = 0).

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
    """Predict the share by which one Gauss-Newton step from a surface lowers the value of a stage's objective.

    Near the edge, a whole fit lowers it by about twice as much.
    """
    iterate, _ = next(iterate_stage(replace(stage, solver="gauss-newton"), stage.objective(surface)))
    return iterate.expected


def _stopped_by(stage: Stage, iterate: Iterate) -> str:
    """Return why a stage ends with this iterate, as in :class:`Step`; empty if it goes on."""
    moved = iterate.displacement if stage.stop_rule == "displacement" else iterate.change
    if moved >= stage.tolerance and iterate.decrease >= stage.cost_tolerance:
        return ""
    if iterate.expected > _STUCK and iterate.expected > 10.0 * iterate.decrease:
        return "no better point"
    return stage.stop_rule if moved < stage.tolerance else "cost"
