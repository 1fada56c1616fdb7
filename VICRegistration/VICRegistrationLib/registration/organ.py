"""The organ recipe: from a separated region to one B-spline surface fitted to the grey levels.

Generic model placed by moments -> global scaling -> local registration on the region -> local registration on the grey
levels. Last, boundary points pull it where a doctor knows better.

Everything but that happens in the frame of the organ's principal axes, so that the result depends neither on how the
volume lies in the world nor on the order of its axes in memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry.models import generic_model
from ..geometry.surface import BSplineSurface
from ..geometry.validity import Problem, check_surface
from ..imaging.image import Image, as_image
from ..imaging.moments import Moments, moments
from ..imaging.region import Region
from ..messages import Diagnostic
from ..segmentation.checks import check_scale
from ..segmentation.separation import separate
from .automatic import fit_in_frame, placed
from .boundary import checked_boundary_points
from .choosing import Choice
from .confidence import Confidence, confidence_of
from .correction import correct
from .drift_limit import left_out
from .finer_nets import first_net
from .nets import closure_of, net_of, net_text
from .options import MAX_ITERATIONS, TAU_PIXELS, FitOptions
from .plan import Plan, surface_stages
from .refitting import fit_again, looked_at
from .stages import Step

# Least width of an edge that is looked for, in voxels.
_LEAST_TAU = 0.1


@dataclass(frozen=True, eq=False)
class OrganFit:
    """A fitted organ.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm, outward normals.
    region : Region or None
        The separated region it started from; None after :func:`refit` without one.
    history : tuple of Step
        All iterations.
    converged : bool
        Whether the last stage on the grey levels met its stop rule, and that of the boundary points if there were any.
    cost_initial, cost_final : float
        Cost of the generic model as placed (of the given surface after :func:`refit`), seen with the levels of the last
        stage on the grey levels, and of the last step: mean squared residual in units of the contrast between inside
        and outside.
    seconds : float
        Time from the separated region or the given surface to the surface.
    options : FitOptions
        As used, with automatic choices filled in. ``net`` is that of `surface`: finer than asked for where boundary
        points needed it.
    boundary_points : (n, 3) ndarray
        The points that pulled the surface, RAS mm; none without points or with weight 0.
    uncorrected : BSplineSurface
        The surface before the boundary points pulled it: to start from when one of them is taken back.
    choices : tuple of Choice
        What was chosen for the net, tau and the smoothness, and why.
    image : Image
        The grey levels that it was fitted to.

    Examples
    --------
    >>> import numpy as np
    >>> import VICRegistrationLib as vic
    >>> distance = 2.0 * np.linalg.norm(np.indices((24, 24, 24)) - 11.5, axis=0)
    >>> image = vic.Image.from_array(100.0 * np.clip((17.0 - distance) / 2.0, 0.0, 1.0), np.diag([2, 2, 2, 1]))
    >>> fit = vic.fit(image, [[23, 23, 23]], net=(9, 7))
    >>> print(f"{fit.surface.volume() / 1000.0:.1f} ml")
    17.2 ml
    >>> fit.problems
    ()
    >>> bool(fit.confidence.volume_sd_ml < 1.0)
    True
    """

    surface: BSplineSurface
    region: Region | None
    history: tuple[Step, ...]
    converged: bool
    cost_initial: float
    cost_final: float
    seconds: float
    options: FitOptions
    boundary_points: np.ndarray
    uncorrected: BSplineSurface
    choices: tuple[Choice, ...]
    image: Image

    def __repr__(self) -> str:
        """Tell the result in one line."""
        end = "converged" if self.converged else "not converged"
        return (
            f"OrganFit({self.surface.volume() / 1000.0:.3g} ml, net {net_text(self.options.net)}, {end} after "
            f"{self.iterations} iterations, cost {self.cost_final:.3g}, {self.seconds:.2g} s)"
        )

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """What is wrong with the surface; empty when it is a valid solid."""
        return check_surface(self.surface)

    @cached_property
    def confidence(self) -> Confidence:
        """How sure the surface is, point by point."""
        return confidence_of(self.image, self.surface, self.options)

    @cached_property
    def left_out(self) -> tuple[float, str]:
        """How far the region reaches beyond the surface, mm, and at which side; see :func:`.drift_limit.left_out`."""
        return (0.0, "") if self.region is None else left_out(self.surface, self.region)

    @property
    def iterations(self) -> int:
        """Number of iterations of all stages."""
        return len(self.history)


def fit_organ(
    image: Image, seeds: np.ndarray, options: FitOptions | None = None, *, boundary_points: np.ndarray | None = None
) -> Generator[Step, None, OrganFit]:
    """Separate an organ and fit a surface to it, step by step.

    Parameters
    ----------
    image : Image or path
    seeds : (n, 3) array_like
        Points inside the organ, RAS mm.
    options : FitOptions, optional
    boundary_points : (n, 3) array_like, optional
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
    points = checked_boundary_points(boundary_points)
    region = separate(image, seeds, threshold=options.threshold, erosion=options.erosion, dilation=options.dilation)
    return (yield from fit_region(image, region, options, boundary_points=points))


def fit_region(
    image: Image, region: Region, options: FitOptions | None = None, *, boundary_points: np.ndarray | None = None
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
        Where the wall is known to be, RAS mm. After the fit they pull the surface in their surroundings, see
        :mod:`.correction`; the net becomes finer for it.

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
        boundary point is not finite or more than 30 mm away from the fitted surface.
    """
    start, image = time.perf_counter(), as_image(image)
    check_scale(image)
    _check_grid(image, region)
    points = checked_boundary_points(boundary_points)
    options = _resolved(options or FitOptions(), region)
    pose = moments(region)
    _check_tau(options.tau, image)
    _check_thickness(pose, options.tau or TAU_PIXELS * float(min(image.spacing)))
    local_to_ras = np.eye(4)
    local_to_ras[:3, :3], local_to_ras[:3, 3] = pose.axes.T, pose.center
    plan = Plan.of(image, region, local_to_ras, options)
    net = first_net(options.net, options.closure)
    model = generic_model(options.model, plan.target.shape(pose.extents), net, options.closure)
    history: list[Step] = []
    steps = fit_in_frame(plan, model, options)
    outcome = yield from placed(steps, lambda surface: surface.transformed(local_to_ras), history)
    uncorrected = history[-1].surface
    corrected = yield from _corrected(image, uncorrected, points, outcome.options)
    return _result(image, uncorrected, history, corrected, points, outcome, region=region, start=start)


def refit(
    image: Image,
    surface: BSplineSurface,
    options: FitOptions | None = None,
    *,
    boundary_points: np.ndarray | None = None,
    region: Region | None = None,
) -> Generator[Step, None, OrganFit]:
    """Fit a surface again that is there already, step by step.

    Without boundary points, the whole surface is fitted to the grey levels, and held where it lies if that is its edge
    already, see :func:`.refitting.fit_again`. With boundary points, they pull the surface in their surroundings, see
    :mod:`.correction`, and everything else stays where it is: what earlier points did too. To take a point back, start
    from `OrganFit.uncorrected` with those that are left.

    Parameters
    ----------
    image : Image or path
        The grey levels.
    surface : BSplineSurface
        A closed organ near its edge, RAS mm. Its net and its closure count, not those of the options.
    options : FitOptions, optional
    boundary_points : (n, 3) array_like, optional
        Where the wall is known to be, RAS mm.
    region : Region, optional
        What the surface was fitted to before; it is only handed on.

    Yields
    ------
    Step

    Returns
    -------
    OrganFit

    Raises
    ------
    ValueError
        If the surface is no closed organ or lies outside of the volume, or a boundary point is not finite or more than
        30 mm away from the surface.
    """
    start, image = time.perf_counter(), as_image(image)
    points = checked_boundary_points(boundary_points)
    closure = closure_of(surface)
    options = (options or FitOptions()).filled_in(closure=closure, net=net_of(surface, closure))
    options = _resolved(options, region)
    history: list[Step] = []
    if _count(points, options):
        outcome = looked_at(image, surface, options)
    else:
        outcome = yield from placed(fit_again(image, surface, options), lambda found: found, history)
    reached = history[-1].surface if history else surface
    corrected = yield from _corrected(image, reached, points, outcome.options)
    return _result(image, reached, history, corrected, points, outcome, region=region, start=start)


def _count(points: np.ndarray, options: FitOptions) -> bool:
    """Whether there are boundary points that count."""
    return len(points) > 0 and options.boundary_weight > 0.0


def _corrected(
    image: Image, surface: BSplineSurface, points: np.ndarray, options: FitOptions
) -> Generator[Step, None, list[Step]]:
    """Pull a surface to the boundary points, if there are any that count; returns the steps."""
    if not _count(points, options):
        return []
    *_, stage = surface_stages(image, surface, points, options)
    steps = []
    for step in correct(surface, points, stage, closure=options.closure, weight=options.boundary_weight):
        steps.append(step)
        yield step
    return steps


def _result(image, uncorrected, history, correction, points, outcome, *, region, start) -> OrganFit:
    """Put together what came out."""
    options, choices = outcome.options, outcome.choices
    steps = (*history, *correction)
    surface = steps[-1].surface
    net = net_of(surface, options.closure)
    if net != net_of(uncorrected, options.closure):
        size = net_text(net)
        choices = tuple(
            replace(choice, value=size, reasons=(*choice.reasons, Diagnostic("made_finer", {"net": choice.value})))
            if choice.option == "net"
            else choice
            for choice in choices
        )
    return OrganFit(
        surface=surface,
        region=region,
        history=steps,
        converged=all(part[-1].converged for part in (history, correction) if part),
        cost_initial=outcome.cost_initial,
        cost_final=steps[-1].cost,
        seconds=time.perf_counter() - start,
        options=options.filled_in(net=net),
        boundary_points=points if _count(points, options) else points[:0],
        uncorrected=uncorrected,
        choices=choices,
        image=image,
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


def _check_tau(tau: float | None, image: Image) -> None:
    """Refuse an edge that is much sharper than any image."""
    pixel = float(min(image.spacing))
    if tau is not None and tau < _LEAST_TAU * pixel:
        msg = (
            f"A tau of {tau:g} mm was given, and voxels are {pixel:.3g} mm: no image shows an edge as sharp. Give two "
            "to three voxels, or leave it to be chosen."
        )
        raise ValueError(msg)


def _check_thickness(pose: Moments, tau: float) -> None:
    """Refuse an organ thinner than the edge that is looked for."""
    # Half of the shortest axis of the ellipsoid with the region's moments.
    half_thickness = np.sqrt(5.0) * float(pose.extents.min())
    if half_thickness < tau:
        msg = (
            f"The region is about {2.0 * half_thickness:.2g} mm thick; an edge of {tau:.2g} mm is sought on "
            "each side. Check the thresholds and the erosion, or take a finer image or a smaller tau."
        )
        raise ValueError(msg)


def _resolved(options: FitOptions, region: Region | None) -> FitOptions:
    """Fill in the automatic choices that need no look at the image."""
    return options.filled_in(
        threshold=options.threshold if region is None else region.threshold,
        max_iterations=options.max_iterations or MAX_ITERATIONS[options.solver],
    )


def finish(steps: Iterator[Step], on_step: Callable[[Step], None] | None = None) -> OrganFit:
    """Run a fit to its end.

    Parameters
    ----------
    steps : generator
        From :func:`fit_organ`, :func:`fit_region` or :func:`refit`.
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
