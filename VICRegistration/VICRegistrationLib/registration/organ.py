"""The organ recipe: from a separated region to one B-spline surface fitted to the grey levels.

Generic model placed by moments -> global scaling -> local registration on the region -> local registration on the grey
levels. Everything happens in the frame of the organ's principal axes, so that the result depends neither on how the
volume lies in the world nor on the order of its axes in memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry import models
from ..geometry.surface import BSplineSurface
from ..geometry.validity import Problem, check_surface
from ..imaging.image import Image
from ..imaging.moments import moments
from ..imaging.separation import Region, separate
from .levels import LEVEL_MODES
from .plan import generic_model, machinery, plan
from .solvers import SOLVERS
from .stages import Step, run_stage

# The paper: a ramp of 2 to 3 pixels suits the MRI used.
TAU_PIXELS = 2.5
MAX_ITERATIONS = {"gauss-newton": 50, "gradient-descent": 300}


@dataclass(frozen=True)
class FitOptions:
    """Choices for fitting an organ; the defaults need no tuning.

    Parameters
    ----------
    net : (rows, columns)
        Size of the control net in the paper's counting.
    closure : {"smooth", "paper"}
        How the surface is kept closed, see :func:`..geometry.parametrization.closed_organ`.
    threshold : (low, high), optional
        Grey levels of the organ, for separating it; suggested from the seeds if not given.
    erosion : float, optional
        Erosion that cuts bridges to neighbours, mm; the default of :func:`..imaging.separation.separate` if not given.
    solver : {"gauss-newton", "gradient-descent"}
    tau : float, optional
        Width of the intensity profile's ramp in mm; `TAU_PIXELS` times the finest voxel spacing if not given.
    centered : bool
        Whether the surface lies at half height of the ramp, or as published at its inner foot.
    levels : {"local", "organ", "given"}
        Grey levels inside and outside: estimated along the surface, once for the organ, or given.
    inside, outside : float, optional
        Grey levels for ``levels="given"``.
    smoothness : float
        Weight of the thin-plate energy, dimensionless, see :class:`.stages.Stage`; larger is stiffer.
    tolerance : float
        Largest displacement of a control point at which the last stage stops, mm.
    max_iterations : int, optional
        For each stage; 50 for Gauss-Newton and 300 for gradient descent if not given.
    """

    net: tuple[int, int] = models.DEFAULT_NET
    closure: str = "smooth"
    threshold: tuple[float, float] | None = None
    erosion: float | None = None
    solver: str = "gauss-newton"
    tau: float | None = None
    centered: bool = True
    levels: str = "local"
    inside: float | None = None
    outside: float | None = None
    smoothness: float = 1e-5
    tolerance: float = 0.1
    max_iterations: int | None = None

    def __post_init__(self) -> None:
        """Check what can be checked without an image."""
        if self.solver not in SOLVERS:
            msg = f"The solver {self.solver!r} was asked for; choose one of {', '.join(SOLVERS)}."
            raise ValueError(msg)
        if self.levels not in LEVEL_MODES:
            msg = f"The level mode {self.levels!r} was asked for; choose one of {', '.join(LEVEL_MODES)}."
            raise ValueError(msg)
        if self.levels == "given" and (self.inside is None or self.outside is None):
            msg = "Given levels were asked for without them; give the grey levels inside and outside too."
            raise ValueError(msg)
        for name in ("tau", "tolerance", "max_iterations"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                msg = f"The option {name} is {value}; it must be positive."
                raise ValueError(msg)
        if not self.smoothness >= 0:
            msg = f"The option smoothness is {self.smoothness}; it must be zero or positive."
            raise ValueError(msg)


@dataclass(frozen=True, eq=False)
class OrganFit:
    """A fitted organ.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm, outward normals.
    region : Region
        The separated region it started from.
    history : tuple of Step
        All iterations.
    converged : bool
        Whether the last stage met its stop rule.
    cost_initial, cost_final : float
        Cost of the generic model as placed and of the fitted surface, both seen as the last stage sees the surface at
        its end: mean squared residual in units of the contrast between inside and outside.
    seconds : float
        Time from the separated region to the surface.
    options : FitOptions
        As used, with automatic choices filled in.
    """

    surface: BSplineSurface
    region: Region
    history: tuple[Step, ...]
    converged: bool
    cost_initial: float
    cost_final: float
    seconds: float
    options: FitOptions

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """What is wrong with the surface; empty when it is a valid solid."""
        return check_surface(self.surface)

    @property
    def iterations(self) -> int:
        """Number of iterations of all stages."""
        return len(self.history)


def fit_organ(image: Image, seeds: np.ndarray, options: FitOptions | None = None) -> Generator[Step, None, OrganFit]:
    """Separate an organ and fit a surface to it, step by step.

    Parameters
    ----------
    image : Image
    seeds : (n, 3) array_like
        Points inside the organ, RAS mm.
    options : FitOptions, optional

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
        If the organ cannot be separated.
    """
    options = options or FitOptions()
    region = separate(image, seeds, threshold=options.threshold, erosion=options.erosion)
    return (yield from fit_region(image, region, options))


def fit_region(image: Image, region: Region, options: FitOptions | None = None) -> Generator[Step, None, OrganFit]:
    """Fit a surface to a separated region and then to the grey levels, step by step.

    Parameters
    ----------
    image : Image
        The grey levels.
    region : Region
        The separated organ, on the image's grid.
    options : FitOptions, optional

    Yields
    ------
    Step

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the region is too small for a surface.
    """
    start = time.perf_counter()
    options = options or FitOptions()
    options = _resolved(options, image, region)
    pose = moments(region)
    local_to_ras = np.eye(4)
    local_to_ras[:3, :3], local_to_ras[:3, 3] = pose.axes.T, pose.center
    model = surface = generic_model(pose, options)
    closed, grid = machinery(options.net, options.closure)
    history: list[Step] = []
    for stage, parametrize in plan(image, region, local_to_ras, closed, options):
        for step in run_stage(stage, parametrize(surface), grid):
            surface = step.surface
            step = replace(step, surface=surface.transformed(local_to_ras))
            history.append(step)
            yield step
    # Both costs are those of the last stage, with the levels found at its end: they can be compared.
    final = stage.correlation(closed.at(surface), grid)
    final_cost = final.sample(np.zeros(closed.n_dof)).cost
    model_cost = final.sample(final.parametrization.fit(model.control_net)).cost
    return OrganFit(
        surface=history[-1].surface,
        region=region,
        history=tuple(history),
        converged=history[-1].converged,
        cost_initial=model_cost,
        cost_final=final_cost,
        seconds=time.perf_counter() - start,
        options=options,
    )


def _resolved(options: FitOptions, image: Image, region: Region) -> FitOptions:
    """Fill in the automatic choices."""
    return replace(
        options,
        threshold=region.threshold,
        tau=options.tau or TAU_PIXELS * float(min(image.spacing)),
        max_iterations=options.max_iterations or MAX_ITERATIONS[options.solver],
    )


def finish(steps: Iterator[Step], on_step: Callable[[Step], None] | None = None) -> OrganFit:
    """Run a fit to its end.

    Parameters
    ----------
    steps : generator
        From :func:`fit_organ` or :func:`fit_region`.
    on_step : callable, optional
        Called with every :class:`Step`.

    Returns
    -------
    OrganFit
    """
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value
        if on_step is not None:
            on_step(step)
