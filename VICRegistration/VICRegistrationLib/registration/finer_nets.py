"""Finer control nets than the first one: tried where the image promises more shape, kept where noise cannot explain it.

Each one starts again from the scaled model, with a knot more in every span: points of a coarse net that was fitted have
slid, and a finer one made of it would keep that.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from .nets import net_of
from .options import FitOptions
from .plan import Plan, machinery
from .stages import Step, cost_of, last_step, promise

# A finer net lowers the cost by at least so many times the share that more freedom takes off noise. Phantoms with noise
# of 5 % are promised 0.7 to 1.4 times that share by a net of 33x19, real bladders 18 to 40 times.
_WORTH = 4.0
# How often the spans are halved: 9x7 control points become 17x11 and 33x19. Once more takes 10 s, and slices do not
# show that much.
_MOST_HALVINGS = 2


def fit_finer(
    plan: Plan, scaled: BSplineSurface, found: Step, options: FitOptions, anchor: float
) -> Generator[Step, None, tuple[Step, str]]:
    """Fit again with finer nets, each with its spans halved, as long as they are worth it.

    Parameters
    ----------
    plan : Plan
    scaled : BSplineSurface
        The model before its points were free, to start from.
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
        scaled, finer = scaled.refined(), found.surface.refined()
        net = "{}x{}".format(*net_of(scaled, options.closure))
        closed, grid = machinery(options.net, options.closure, halvings)
        fewer, _ = machinery(options.net, options.closure, halvings - 1)
        explained = noise_share(closed.n_dof - fewer.n_dof, finer.area() * options.tau, plan.voxel)
        # The first net is too coarse to tell what lies beyond it.
        if halvings > 1:
            promised = promise(fine, closed.at(finer), grid)
            if promised <= _WORTH * explained:
                why.append(f"{net} promised {promised:.1%}, of which noise explains {explained:.1%}")
                break
        step = Step("", 0, 0.0, 0.0, scaled)
        for stage in (plan.region_stages(options)[1], *plan.grey_level_stages(options, anchor=anchor)):
            step = yield from last_step(replace(stage, name=f"{stage.name}, {net}"), closed.at(step.surface), grid)
        judge = fine.correlation(closed.at(step.surface), grid)
        gained = 1.0 - cost_of(step.surface, judge) / cost_of(finer, judge)
        why.append(f"with {net} the cost fell by {gained:.1%}, of which noise explains {explained:.1%}")
        lost = plan.astray(step.surface) if gained > _WORTH * explained else ""
        if lost:
            why.append(f"but {lost}")
        if lost or gained <= _WORTH * explained:
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
