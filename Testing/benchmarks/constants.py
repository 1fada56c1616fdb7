"""Sensitivity of the separation to its constants: half and twice each of them."""

from __future__ import annotations

from types import ModuleType
from unittest import mock

import numpy as np
from bladders import HARD, NAMES, bladders, drawn_surface
from experts import started
from measuring import table

from VICRegistrationLib.segmentation import (
    growing,
    ray_edges,
    ray_search,
    ray_surface,
    separation,
    shaped_region,
    star_surface,
)

CONSTANTS: tuple[tuple[ModuleType, str], ...] = (
    *((ray_edges, name) for name in ("_STEP_SHARE", "_STEP_NOISE", "_DEPTH_MM", "_WINDOW_MM", "_SURROUNDINGS_MM")),
    *(
        (ray_search, name)
        for name in (
            *("STEP_SHARE", "_SHADING_CHANGE", "_NOISE_CHANGE", "_CROSSED_WEIGHT", "_RISE_WEIGHT", "_SMOOTHNESS"),
            *("_BORDER_WEIGHT", "_SHADING", "_LEAST_STEP", "_SHAPE_SMOOTHNESS", "STEP_MM", "_BLUR_MM"),
            *("_VOXEL_MM", "_CHANGE_MM", "_NEAR_MM", "_WALL_MM"),
        )
    ),
    (ray_surface, "EDGE_STRENGTH"),
    (star_surface, "LEAST_MM"),
    *((shaped_region, name) for name in ("_SHELL_MM", "OPENING_MM")),
    *((separation, name) for name in ("_LESS_WITHOUT_EDGE", "_MORE_WITHOUT_EDGE", "_LEAST_SUPPORT", "_LEAST_CONTRAST")),
    *((growing, name) for name in ("_MOST_TIMES_SPANNED", "FRAGMENT")),
)
LIMIT_MM = 1.5


def report(*, quick: bool) -> str:
    """Fit each bladder from its deepest place with one constant changed."""
    cases = bladders(names=(NAMES + HARD)[:2] if quick else NAMES + HARD)
    drawn = [drawn_surface(bladder) for bladder in cases]
    rows = [["constant", *(bladder.name.rpartition("_")[2] for bladder in cases), f"under {LIMIT_MM:g} mm"]]
    rows.append(_row("as they are", cases, drawn))
    for module, name in CONSTANTS[:2] if quick else CONSTANTS:
        for factor in (0.5, 2.0):
            # The largest edge strength is 1.
            value = min(factor * getattr(module, name), 0.9 if name == "EDGE_STRENGTH" else np.inf)
            with mock.patch.object(module, name, value):
                rows.append(_row(f"{module.__name__.rpartition('.')[2]}.{name} x {factor:g}", cases, drawn))
    return "  Mean distance of the experts' lumen from the fitted surface, mm, from the deepest place.\n\n" + table(
        rows
    )


def _row(title: str, cases: list, drawn: list) -> list[str]:
    means = [started(bladder, there, bladder.seed).mean for bladder, there in zip(cases, drawn)]
    return [title, *(f"{mean:.2f}" for mean in means), f"{np.count_nonzero(np.array(means) < LIMIT_MM)}"]
