"""Finer control nets than the first one: tried where the image promises more shape, kept where noise cannot explain it.

Each one has a knot more in every span, and starts from the surface of the net before, which the region then catches
again. What it gains is judged half-way between the lines on which it was fitted: what it made of noise is not there.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from .nets import grid_shape, net_of
from .options import FitOptions
from .plan import Plan, machinery
from .sample_grid import SampleGrid
from .stages import Step, cost_of, last_step, promise

# The finest net is tried where it promises more than so many times what more freedom takes off noise. The demo's organs
# promise 0.7 to 1.6 times that: the bladder would gain by it, vagina and rectum lose; see the benchmark of nets.
_PROMISING = 4.0
# How often the spans are halved: 9x7 control points become 17x11 and 33x19. Once more takes 10 s, and slices do not
# show that much.
_MOST_HALVINGS = 2


def fit_finer(plan: Plan, found: Step, options: FitOptions, anchor: float) -> Generator[Step, None, tuple[Step, str]]:
    """Fit again with finer nets, each with its spans halved, as long as they are worth it.

    Parameters
    ----------
    plan : Plan
    found : Step
        Last step of the fit with the first net.
    options : FitOptions
        With all choices for the first net filled in, and that net.
    anchor : float
        Weight against leaving the surface that a stage on the grey levels begins with.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
        That of the finest net that is worth it and gives a valid surface near the region, or `found`.
    why : str
        What each net brought, in plain words.
    """
    why: list[str] = []
    _, fine = plan.grey_level_stages(options, anchor=anchor)
    for halvings in range(1, _MOST_HALVINGS + 1):
        finer = found.surface.refined()
        size = net_of(finer, options.closure)
        net = "{}x{}".format(*size)
        closed, grid = machinery(options.net, options.closure, halvings)
        fewer, _ = machinery(options.net, options.closure, halvings - 1)
        explained = noise_share(closed.n_dof - fewer.n_dof, finer.area() * options.tau, plan.voxel)
        # The first net is too coarse to tell what lies beyond it.
        if halvings > 1:
            promised = promise(fine, closed.at(finer), grid)
            if promised <= _PROMISING * explained:
                why.append(f"{net} promised {promised:.1%}, of which noise explains {explained:.1%}")
                break
        step = replace(found, surface=finer)
        for stage in (plan.region_stages(options)[1], *plan.grey_level_stages(options, anchor=anchor)):
            step = yield from last_step(replace(stage, name=f"{stage.name}, {net}"), closed.at(step.surface), grid)
        between = SampleGrid.on(finer, grid_shape(size), between=True)
        judge = fine.correlation(closed.at(step.surface), between)
        gained = 1.0 - cost_of(step.surface, judge) / cost_of(finer, judge)
        change = "fell" if gained >= 0.0 else "rose"
        why.append(f"with {net} the cost {change} by {abs(gained):.1%}, of which noise explains {explained:.1%}")
        lost = plan.astray(step.surface) if gained > explained else ""
        if lost:
            why.append(f"but {lost}")
        if lost or gained <= explained:
            found = replace(found, stage="coarser net kept", iteration=1, displacement=0.0)
            yield found
            break
        found = step
    return found, ", ".join(why)


def noise_share(n_dof: int, volume: float, voxel: np.ndarray) -> float:
    """Share of the cost that so much more freedom takes off pure noise.

    Parameters
    ----------
    n_dof : int
        Degrees of freedom that are new; a third of them moves the surface along its normal.
    volume : float
        Of the band around the surface that is compared with the image, mm^3.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.

    Returns
    -------
    float
        Least squares: each one takes the part of one independent number off, and every voxel is one.
    """
    return n_dof / 3.0 * abs(np.linalg.det(voxel)) / volume
