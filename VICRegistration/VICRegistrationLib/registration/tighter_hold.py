"""A surface that has gone astray, fitted again and held tighter to the separated region."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

from ..messages import Diagnostic
from .nets import net_of, net_text
from .options import FitOptions
from .plan import Plan
from .sample_grid import SampledSurface
from .stages import Step, last_step

# How much tighter the region holds a surface that goes astray without.
_TIGHTER = (10.0, 100.0)


@dataclass(frozen=True)
class Held:
    """How a surface was kept from going astray.

    Parameters
    ----------
    how : str
        What was done.
    reasons : tuple of Diagnostic
        The same with the net, and what was wrong with the surface.
    """

    how: str
    reasons: tuple[Diagnostic, ...]


def hold(
    plan: Plan,
    near: Step,
    spare: tuple[str, Step],
    space: SampledSurface,
    options: FitOptions,
    anchor: float,
    lost: Diagnostic,
) -> Generator[Step, None, tuple[Step, Held]]:
    """Fit the grey levels again, held tighter to the region until the surface stays.

    Parameters
    ----------
    plan : Plan
    near : Step
        Surface of the region, from which to fit, and which is kept if the image holds none.
    spare : str and Step
        A surface to keep if not even that of the region is in its place, and what it is called.
    space : SampledSurface
        Of their net.
    options : FitOptions
        With `tau` and `smoothness`.
    anchor : float
        Weight against leaving the surface that a stage begins with, by which it went astray.
    lost : Diagnostic
        What was wrong with it, see :meth:`.plan.Plan.astray`.

    Yields
    ------
    Step

    Returns
    -------
    step : Step
    held : Held
    """
    net = net_of(near.surface, options.closure)
    for factor in _TIGHTER:
        step = near
        tighter = options.filled_in(smoothness=factor * options.smoothness)
        for stage in plan.grey_level_stages(tighter, anchor=factor * anchor):
            # Stages are told apart by their names, and more than one net may have to be held.
            name = f"{stage.name}, {net_text(net)}, held {factor:g} times tighter"
            step = yield from last_step(replace(stage, name=name), space.at(step.surface))
        if not plan.astray(step.surface):
            done = Diagnostic("held_tighter", {"net": net_text(net), "factor": factor})
            return step, Held(f"{factor:g} times tighter", (lost, done))
    what, kept = spare if plan.astray(near.surface) else ("surface of the region", near)
    kept = replace(kept, stage=f"{what} kept, {net_text(net)}", iteration=1, displacement=0.0)
    yield kept
    return kept, Held(f"{what} kept", (lost, Diagnostic("surface_kept", {"net": net_text(net), "kept": what})))
