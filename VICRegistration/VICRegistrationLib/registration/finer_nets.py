"""Finer control nets: tried if the image may show more shape, kept if noise does not explain the lower cost.

Each net has one more knot in every span than the last one, and its fit starts from the last surface, with the stage on
the region. The decrease of the cost is measured half-way between the normal lines of the fit, where a surface that has
followed noise does not gain.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ..geometry.models import DEFAULT_NET
from ..messages import Diagnostic
from .choices import Choice
from .cost import Objective
from .drift_limit import within_drift_limit
from .nets import grid_shape, net_of, net_text, sampled_net
from .sample_grid import SampledSurface, SampleGrid
from .schedule import Schedule
from .stages import Step, expected_decrease, last_step

# The finest net is tried if one step with it is expected to lower the cost by more than this multiple of the decrease
# that noise explains. If it is always tried, fits take a third longer; four more of 20 organs get that net, with errors
# smaller by 0.005 to 0.014 mm, and rougher normals, as for the demo's vagina in the benchmark of nets.
_EXPECTED = 4.0
# Number of times that the spans may be halved: 9x7 control points become 17x11 and 33x19. A third time would take as
# long as all before, and slices do not show that much detail.
MOST_HALVINGS = 2


def fit_finer(
    found: Step, schedule: Schedule, wanted: tuple[int, int] | None
) -> Generator[Step, None, tuple[Step, tuple[Choice, ...]]]:
    """Fit again with finer nets, while they lower the cost enough, or up to the net that was asked for.

    Parameters
    ----------
    found : Step
        Last step of the fit with the first net.
    schedule : Schedule
        With all automatic choices, and the first net.
    wanted : (rows, columns) or None
        The net asked for, which halving the spans of :func:`first_net` reaches; None for an automatic choice.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
        Last step with the net asked for, or with the finest net that lowers the cost enough; `found` if none does.
    choices : tuple of Choice
        The net with the reasons, and the choices of :func:`.drift_limit.within_drift_limit`.
    """
    reasons: list[Diagnostic] = []
    limited: list[Choice] = []
    first, closure = schedule.options.net, schedule.options.closure
    halvings = 0
    while net_of(found.surface, closure) != wanted and (wanted is not None or halvings < MOST_HALVINGS):
        halvings += 1
        template, fewer = (sampled_net(first, closure, count) for count in (halvings, halvings - 1))
        start = replace(found, surface=found.surface.refined())
        explained = noise_share(template.n_dof - fewer.n_dof, schedule.voxels_along(start.surface))
        # The expected decrease from the first net is not reliable, as that net is too coarse.
        if wanted is None and halvings > 1:
            expected = expected_decrease(schedule.fine, template.at(start.surface))
            if expected <= _EXPECTED * explained:
                reasons.append(_reason("finer_net_not_tried", start, closure, explained, expected=expected))
                break
        step, choices = yield from _fit_from(start, schedule, template)
        limited += choices
        if wanted is None:
            gained = _gain(schedule, template, start, step)
            code = "finer_net_lowered_cost" if gained >= 0.0 else "finer_net_raised_cost"
            reasons.append(_reason(code, start, closure, explained, change=abs(gained)))
            if gained <= explained:
                found = replace(found, stage="coarser net kept", iteration=1, displacement=0.0)
                yield found
                break
        found = step
    net = net_text(net_of(found.surface, closure))
    return found, (Choice("net", net, tuple(reasons) or (Diagnostic("option_given"),)), *limited)


def _fit_from(
    start: Step, schedule: Schedule, template: SampledSurface
) -> Generator[Step, None, tuple[Step, tuple[Choice, ...]]]:
    """Run the stages on the region and on the grey levels from a surface with a finer net.

    All three are needed: without that on the region real bladders are off by 0.1 to 0.25 mm more, and without the
    coarse one the demo's organs by 0.01 to 0.02 mm more, in 95 % by 0.03 to 0.1.
    """
    net = net_text(net_of(start.surface, schedule.options.closure))
    steps = [start]
    for stage in (schedule.on_region, schedule.coarse, schedule.fine):
        stage = replace(stage, name=f"{stage.name}, {net}")
        steps.append((yield from last_step(stage, template.at(steps[-1].surface))))
    _, on_region, _, found = steps
    return (
        yield from within_drift_limit(
            found, schedule, template, on_region=on_region, fallback=start, called="surface of the coarser net"
        )
    )


def _gain(schedule: Schedule, template: SampledSurface, start: Step, end: Step) -> float:
    """Relative decrease of the cost by a fit, measured half-way between the normal lines of the fit."""
    shape = grid_shape(net_of(end.surface, schedule.options.closure))
    between = SampleGrid.on(end.surface, shape, between=True)
    objective = Objective(schedule.fine.correlations(SampledSurface(template.parametrization.at(end.surface), between)))
    return 1.0 - objective.cost_of(end.surface) / objective.cost_of(start.surface)


def _reason(code: str, step: Step, closure: str, explained: float, **shares: float) -> Diagnostic:
    """Make a diagnostic with a net's real or expected decrease of the cost, and the decrease that noise explains."""
    shares = {name: float(share) for name, share in shares.items()}
    return Diagnostic(code, {"net": net_text(net_of(step.surface, closure)), **shares, "explained": float(explained)})


def first_net(net: tuple[int, int] | None, closure: str) -> tuple[int, int]:
    """Choose the first net: the default one if halving its spans leads to the net asked for, otherwise that net."""
    if net is None:
        return DEFAULT_NET
    # Cubic splines have three control points more than spans, and around the organ one where they close smoothly.
    more = np.array([1 if closure == "smooth" else 3, 3])
    parts, rest = np.divmod(np.array(net) - more, np.array(DEFAULT_NET) - more)
    leads = not rest.any() and parts[0] == parts[1] and parts[0] in 2 ** np.arange(8)
    return DEFAULT_NET if leads else net


def noise_share(n_dof: int, voxels: float) -> float:
    """Relative decrease of the cost that additional degrees of freedom bring on pure noise.

    Parameters
    ----------
    n_dof : int
        Number of additional degrees of freedom; a third of them moves the surface along its normal.
    voxels : float
        Number of voxels along the surface, see :meth:`.schedule.Schedule.voxels_along`.

    Returns
    -------
    float
        In least squares each parameter lowers the sum of squares by the share of one independent observation, and every
        voxel is one.
    """
    return n_dof / 3.0 / voxels
