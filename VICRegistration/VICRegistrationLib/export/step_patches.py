"""A closed surface as B-spline patches with clamped knots, cut exactly at parameters in u."""

from __future__ import annotations

import numpy as np

from ..geometry import bspline
from ..geometry.surface import BSplineSurface


def patches(surface: BSplineSurface, number: int = 1) -> tuple[BSplineSurface, ...]:
    """Cut a surface around its tube into strips from pole to pole.

    Parameters
    ----------
    surface : BSplineSurface
    number : int
        How many strips. Cuts lie at knots where there are enough of them.

    Returns
    -------
    tuple of BSplineSurface
        With clamped knots, side by side: the last row of a control net is the first row of the next one. A single
        strip of a surface with clamped knots is the surface itself, to the last bit.

    Raises
    ------
    ValueError
        If the number is not positive, or the surface is torn apart at a knot.

    Notes
    -----
    Knots are inserted (Boehm's algorithm) until the surface is interpolated along the cuts, so that the strips
    together are the same surface. Only its poles cannot be cut away: a patch of which an edge is one point has no
    equal without.
    """
    if int(number) != number or number < 1:
        msg = f"{number} faces were asked for; give a whole number of at least 1."
        raise ValueError(msg)
    for axis, knots in enumerate((surface.knots_u, surface.knots_v)):
        _check_multiplicities(surface.degrees[axis], knots)
    low_v, high_v = surface.domain[1]
    cuts = _cuts(bspline.span_limits(surface.degrees[0], surface.knots_u), int(number))
    whole = surface.insert_knots(
        u=_missing(surface.degrees[0], surface.knots_u, cuts),
        v=_missing(surface.degrees[1], surface.knots_v, [low_v, high_v]),
    )
    knots_v, columns = _interval(whole.degrees[1], whole.knots_v, low_v, high_v)
    strips = []
    for low, high in zip(cuts[:-1], cuts[1:]):
        knots_u, rows = _interval(whole.degrees[0], whole.knots_u, low, high)
        strips.append(BSplineSurface(whole.degrees, knots_u, knots_v, whole.control_net[rows, columns]))
    return tuple(strips)


def _check_multiplicities(degree: int, knots: np.ndarray) -> None:
    """Refuse knots at which the surface may have two edges."""
    values, counts = np.unique(knots, return_counts=True)
    low, high = bspline.domain(degree, knots)
    torn = values[(counts > degree) & (values > low) & (values < high)]
    if len(torn):
        msg = f"The knot {torn[0]:g} has a multiplicity above the degree {degree}; the surface must hold together."
        raise ValueError(msg)


def _cuts(limits: np.ndarray, number: int) -> np.ndarray:
    """Parameters of the cuts with both ends: spread over the spans, at their limits if there are enough."""
    positions = np.arange(number + 1) * (len(limits) - 1) / number
    if number < len(limits):
        return limits[np.rint(positions).astype(int)]
    return np.interp(positions, np.arange(len(limits)), limits)


def _missing(degree: int, knots: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """Knots to insert so that each of these is there at least as often as the degree."""
    return np.concatenate([np.repeat(cut, max(degree - np.count_nonzero(knots == cut), 0)) for cut in cuts])


def _interval(degree: int, knots: np.ndarray, low: float, high: float) -> tuple[np.ndarray, slice]:
    """Clamped knots and control points of a part of a spline that is interpolated at both ends of the part."""
    first = int(np.searchsorted(knots, low, side="right")) - 1
    last = int(np.searchsorted(knots, high, side="left"))
    clamped = np.concatenate([np.repeat(low, degree + 1), knots[first + 1 : last], np.repeat(high, degree + 1)])
    return clamped, slice(first - degree, last)
