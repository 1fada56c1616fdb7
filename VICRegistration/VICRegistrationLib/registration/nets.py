"""Control nets of closed organs: their size and closure, their samples, and finer ones for the same surface."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..geometry.models import closed_organ
from ..geometry.parametrization import closed_organ as closed_organ_parametrization
from ..geometry.surface import BSplineSurface
from .options import LARGEST_NET
from .sample_grid import SampledSurface, SampleGrid


def sampled(surface: BSplineSurface, closure: str) -> SampledSurface:
    """Take the degrees of freedom of a closed organ, and the samples for its net."""
    closed = closed_organ_parametrization(surface, closure=closure)
    return SampledSurface(closed, SampleGrid.on(surface, grid_shape(net_of(surface, closure))))


@lru_cache(maxsize=8)
def sampled_net(net: tuple[int, int], closure: str, halvings: int = 0) -> SampledSurface:
    """Make what depends on the net alone: its degrees of freedom and its samples, here of the unit sphere.

    Ellipsoids are affine images of each other, and so are the rings at their poles: one parametrization serves all, and
    one for each time that their spans are halved.
    """
    model = closed_organ(net, closure=closure)
    for _ in range(halvings):
        model = model.refined()
    return sampled(model, closure)


def grid_shape(net: tuple[int, int]) -> tuple[int, int]:
    """Count the samples around the tube and from pole to pole: three to a span, two where there are very many.

    With two everywhere, organs in noise or in thick slices are off by 0.01 to 0.03 mm more, and fits are no faster.
    """
    around, along = net[0] - 1, net[1] - 3
    return max(3 * min(around, 16), 2 * around, 24), max(3 * min(along, 16), 2 * along, 12)


def net_of(surface: BSplineSurface, closure: str) -> tuple[int, int]:
    """Size (rows, columns) of a closed organ's net in the paper's counting."""
    rows, columns, _ = surface.control_net.shape
    return (rows - surface.degrees[0] + 1 if closure == "smooth" else rows), columns


def halvings_to(surface: BSplineSurface, net: tuple[int, int], closure: str) -> int:
    """How often the spans of a net were halved to come to that of a surface."""
    # Cubic splines have three control points more than spans.
    return int(np.log2((net_of(surface, closure)[1] - 3) // (net[1] - 3)))


def net_text(net: tuple[int, int]) -> str:
    """Size of a net in words, such as "9x7"."""
    return f"{net[0]}x{net[1]}"


def closure_of(surface: BSplineSurface) -> str:
    """How a surface is closed.

    Parameters
    ----------
    surface : BSplineSurface

    Returns
    -------
    {"smooth", "paper"}
        "smooth" if its seam and its poles are as smooth as that closure makes them.

    Raises
    ------
    ValueError
        If the surface is no closed organ.
    """
    closed_organ_parametrization(surface, closure="paper")
    try:
        smooth = closed_organ_parametrization(surface, closure="smooth")
    except ValueError:
        return "paper"
    # All smooth nets together are a linear space: is this one of them?
    empty = smooth.at(surface.with_control_net(np.zeros_like(surface.control_net)))
    nearest = empty.control_net(empty.fit(surface.control_net))
    return "smooth" if np.abs(nearest - surface.control_net).max() <= 1e-6 * surface.size else "paper"


def refined(surface: BSplineSurface, span: float, *, closure: str) -> BSplineSurface:
    """Make the net of a surface finer, until its spans are at most so long.

    Parameters
    ----------
    surface : BSplineSurface
    span : float
        mm.
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface
        Spans are halved, all of one direction at once, so that nets stay even and those of later corrections fit into
        each other; no net gets more than 65 rows or columns.
    """
    while True:
        limits = [surface.span_limits(axis) for axis in (0, 1)]
        middles = [(ends[1:] + ends[:-1]) / 2.0 for ends in limits]
        steps = [np.diff(ends) for ends in limits]
        longest = (
            (np.linalg.norm(surface.grid(*middles, du=1), axis=2) * steps[0][:, None]).max(),
            (np.linalg.norm(surface.grid(*middles, dv=1), axis=2) * steps[1]).max(),
        )
        halved = [
            length > span and rows + len(step) <= LARGEST_NET
            for length, rows, step in zip(longest, net_of(surface, closure), steps)
        ]
        if not any(halved):
            return surface
        u, v = (middle if halve else () for middle, halve in zip(middles, halved))
        surface = surface.insert_knots(u=u, v=v)
