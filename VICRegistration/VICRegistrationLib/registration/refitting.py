"""A surface that is there already, fitted to the grey levels again, and held where it lies if that is its edge."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from .automatic import Outcome
from .choosing import anchor_for, chosen_beside, chosen_by
from .nets import sampled
from .options import FitOptions
from .plan import surface_stages
from .stages import Step, last_step

# A surface whose cost falls by more than this share as soon as it is let go does not lie at its edge. Those that were
# fitted gain 0.03 to 0.36 on phantoms and real bladders, those that were moved by 1.5 mm at least 0.65.
_BESIDE = 0.5
_NO_POINTS = np.empty((0, 3))


def looked_at(image: Image, surface: BSplineSurface, options: FitOptions) -> Outcome:
    """Tell what is chosen beside a surface that stays as it is.

    Parameters
    ----------
    image : Image
    surface : BSplineSurface
        A closed organ near its edge, RAS mm.
    options : FitOptions
        With the surface's net and closure.

    Returns
    -------
    Outcome

    Raises
    ------
    ValueError
        If the surface lies outside of the volume.
    """
    options, choices = chosen_beside(image, surface, options)
    space = sampled(surface, options.closure)
    _, fine, _ = surface_stages(image, surface, _NO_POINTS, options)
    return Outcome(options, choices, fine.correlation(space).cost_of(surface))


def fit_again(image: Image, surface: BSplineSurface, options: FitOptions) -> Generator[Step, None, Outcome]:
    """Fit a surface to the grey levels again, step by step.

    Parameters
    ----------
    image : Image
    surface : BSplineSurface
        A closed organ near its edge, RAS mm.
    options : FitOptions
        With the surface's net and closure.

    Yields
    ------
    Step

    Returns
    -------
    Outcome

    Raises
    ------
    ValueError
        If the surface lies outside of the volume.

    Notes
    -----
    A first look lets the surface go, and is not kept: by what it comes to, smoothness and hold are chosen as in a first
    fit. If it gains much, the surface lay beside its edge, and is held only where the coarse stage has brought it.
    Otherwise it is held where it lies, as the region held it when it was fitted: fitted again, it moves little.
    """
    started, _ = chosen_beside(image, surface, options)
    space = sampled(surface, options.closure)
    look, _, _ = surface_stages(image, surface, _NO_POINTS, started)
    before = look.correlation(space).cost_of(surface)
    caught = yield from last_step(replace(look, name="grey levels, first look"), space)
    chosen, choices = chosen_by(caught, look.sampler, image.ijk_to_ras[:3, :3], options)
    coarse, _, _ = surface_stages(image, surface, _NO_POINTS, chosen)
    _, fine, _ = surface_stages(image, surface, _NO_POINTS, chosen, anchor=anchor_for(caught))
    reached = surface
    if caught.cost < (1.0 - _BESIDE) * before:
        reached = (yield from last_step(coarse, space)).surface
    reached = (yield from last_step(fine, space.at(reached))).surface
    return Outcome(chosen, choices, fine.correlation(space.at(reached)).cost_of(surface))
