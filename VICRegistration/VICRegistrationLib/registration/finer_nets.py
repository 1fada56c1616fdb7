"""Finer control nets than the first one: tried where the image promises more shape, kept where noise cannot explain it.

Each one has a knot more in every span, and starts from the surface of the net before, which the region then catches
again. What it gains is judged half-way between the lines on which it was fitted: what it made of noise is not there.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ..geometry import models
from ..messages import Diagnostic
from .nets import grid_shape, net_of, net_text, sampled_net
from .options import FitOptions
from .plan import Plan, voxels_along
from .sample_grid import SampledSurface, SampleGrid
from .stages import Step, expected_decrease, last_step
from .tighter_hold import Held, hold

# The finest net is tried where it promises more than so many times what more freedom takes off noise. The demo's organs
# promise 0.7 to 1.6 times that: the bladder would gain by it, the vagina lose; see the benchmark of nets.
_PROMISING = 4.0
# How often the spans are halved: 9x7 control points become 17x11 and 33x19. Once more takes 10 s, and slices do not
# show that much.
_MOST_HALVINGS = 2


def fit_finer(
    plan: Plan, found: Step, options: FitOptions, anchor: float, wanted: tuple[int, int] | None
) -> Generator[Step, None, tuple[Step, tuple[Diagnostic, ...], list[Held]]]:
    """Fit again with finer nets, each with its spans halved, as long as they are worth it or up to one asked for.

    Parameters
    ----------
    plan : Plan
    found : Step
        Last step of the fit with the first net.
    options : FitOptions
        With all choices for the first net filled in, and that net.
    anchor : float
        Weight against leaving the surface that a stage on the grey levels begins with.
    wanted : (rows, columns) or None
        The net asked for, to which :func:`first_net` leads, or None to choose.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
        That of the net asked for, or of the finest one that is worth it; `found` if none is.
    why : tuple of Diagnostic
        What each net brought; none if one was asked for.
    held : list of Held
        For each net with which the surface went astray at first.
    """
    why: list[Diagnostic] = []
    held: list[Held] = []
    _, fine = plan.grey_level_stages(options, anchor=anchor)
    halvings = 0
    while net_of(found.surface, options.closure) != wanted and (wanted is not None or halvings < _MOST_HALVINGS):
        halvings += 1
        finer = found.surface.refined()
        size = net_of(finer, options.closure)
        net = net_text(size)
        space = sampled_net(options.net, options.closure, halvings)
        fewer = sampled_net(options.net, options.closure, halvings - 1)
        explained = noise_share(space.n_dof - fewer.n_dof, voxels_along(finer, options.tau, plan.voxel))
        # The first net is too coarse to tell what lies beyond it.
        if wanted is None and halvings > 1:
            promised = expected_decrease(fine, space.at(finer))
            if promised <= _PROMISING * explained:
                shares = {"promised": float(promised), "explained": float(explained)}
                why.append(Diagnostic("finer_net_not_tried", {"net": net, **shares}))
                break
        step, how = yield from _fit_halved(plan, replace(found, surface=finer), space, options, anchor)
        held += how
        if wanted is None:
            between = SampleGrid.on(finer, grid_shape(size), between=True)
            judge = fine.correlation(SampledSurface(space.parametrization.at(step.surface), between))
            gained = 1.0 - judge.cost_of(step.surface) / judge.cost_of(finer)
            code = "finer_net_lowered_cost" if gained >= 0.0 else "finer_net_raised_cost"
            shares = {"change": abs(float(gained)), "explained": float(explained)}
            why.append(Diagnostic(code, {"net": net, **shares}))
            if gained <= explained:
                found = replace(found, stage="coarser net kept", iteration=1, displacement=0.0)
                yield found
                break
        found = step
    return found, tuple(why), held


def _fit_halved(
    plan: Plan, found: Step, space: SampledSurface, options: FitOptions, anchor: float
) -> Generator[Step, None, tuple[Step, list[Held]]]:
    """Run the stages on the region and on the grey levels from a surface, held tighter if it goes astray."""
    net = net_text(net_of(found.surface, options.closure))
    steps = [found]
    for stage in (plan.region_stages(options)[1], *plan.grey_level_stages(options, anchor=anchor)):
        stage = replace(stage, name=f"{stage.name}, {net}")
        steps.append((yield from last_step(stage, space.at(steps[-1].surface))))
    lost = plan.astray(steps[-1].surface)
    if not lost:
        return steps[-1], []
    spare = ("surface of the coarser net", found)
    step, held = yield from hold(plan, steps[1], spare, space, options, anchor, lost)
    return step, [held]


def first_net(net: tuple[int, int] | None, closure: str) -> tuple[int, int]:
    """Tell with which net to begin: the usual one, if halving its spans leads to that asked for, otherwise that."""
    if net is None:
        return models.DEFAULT_NET
    # Cubic splines have three control points more than spans, and around the organ one where they close smoothly.
    more = np.array([1 if closure == "smooth" else 3, 3])
    parts, rest = np.divmod(np.array(net) - more, np.array(models.DEFAULT_NET) - more)
    leads = not rest.any() and parts[0] == parts[1] and parts[0] in 2 ** np.arange(8)
    return models.DEFAULT_NET if leads else net


def noise_share(n_dof: int, voxels: float) -> float:
    """Share of the cost that so much more freedom takes off pure noise.

    Parameters
    ----------
    n_dof : int
        Degrees of freedom that are new; a third of them moves the surface along its normal.
    voxels : float
        How many are compared with the virtual image, see :func:`.plan.voxels_along`.

    Returns
    -------
    float
        Least squares: each one takes the part of one independent number off, and every voxel is one.
    """
    return n_dof / 3.0 / voxels
