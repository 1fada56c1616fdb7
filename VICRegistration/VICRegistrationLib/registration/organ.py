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

from ..geometry.surface import BSplineSurface
from ..geometry.validity import Problem, check_surface
from ..imaging.image import Image
from ..imaging.moments import Moments, moments
from ..imaging.separation import Region, separate
from .options import MAX_ITERATIONS, TAU_PIXELS, FitOptions
from .plan import generic_model, machinery, plan
from .stages import Step, run_stage


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
        Cost of the generic model as placed, seen with the levels of the last stage, and of the last step: mean squared
        residual in units of the contrast between inside and outside.
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
        If the region is too thin for a surface or does not lie on the image's grid.
    """
    start = time.perf_counter()
    _check_grid(image, region)
    options = _resolved(options or FitOptions(), image, region)
    pose = moments(region)
    _check_thickness(pose, options)
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
    # The model as the last stage sees it, with the levels found at its end: to be compared with the last step's cost.
    final = stage.correlation(closed.at(surface), grid)
    final.refresh(np.zeros(closed.n_dof))
    model_cost = final.sample(final.parametrization.fit(model.control_net)).cost
    return OrganFit(
        surface=history[-1].surface,
        region=region,
        history=tuple(history),
        converged=history[-1].converged,
        cost_initial=model_cost,
        cost_final=history[-1].cost,
        seconds=time.perf_counter() - start,
        options=options,
    )


def _check_grid(image: Image, region: Region) -> None:
    """Refuse a region that was cut from another image."""
    first = image.to_ras(np.array([region.offset[::-1]], dtype=float))[0]
    fits = np.all(np.asarray(region.offset) + region.mask.shape <= image.array.shape)
    same = np.allclose(first, region.ijk_to_ras[:3, 3], atol=1e-3) and np.allclose(
        image.ijk_to_ras[:3, :3], region.ijk_to_ras[:3, :3], atol=1e-5
    )
    if not (fits and same):
        msg = "The region does not lie on the image's grid; separate the organ in this image, or resample its mask."
        raise ValueError(msg)


def _check_thickness(pose: Moments, options: FitOptions) -> None:
    """Refuse an organ thinner than the edge that is looked for."""
    # Half of the shortest axis of the ellipsoid with the region's moments.
    half_thickness = np.sqrt(5.0) * float(pose.extents.min())
    if half_thickness < options.tau:
        msg = (
            f"The region is about {2.0 * half_thickness:.2g} mm thick; an edge of {options.tau:.2g} mm is sought on "
            "each side. Check the thresholds and the erosion, or take a finer image or a smaller tau."
        )
        raise ValueError(msg)


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

    Raises
    ------
    ValueError
        If the generator was used up before.
    """
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            if end.value is None:
                msg = "The fit had come to its end before; start a new one with fit_organ or fit_region."
                raise ValueError(msg) from None
            return end.value
        if on_step is not None:
            on_step(step)
