"""The outer surface of a wall: a B-spline surface at a distance along the exact normals."""

from __future__ import annotations

import numpy as np
from scipy.sparse import linalg as sparse_linalg

from ..geometry import bspline
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from .sizes import curvatures

# The wall is as thick as wanted within this fraction, or this length in mm, whichever is more.
_RELATIVE, _ABSOLUTE = 0.01, 0.01
# A net with more columns or rows than this is too much for any mesher.
_LARGEST_NET = 140


def offset_surface(surface: BSplineSurface, distance: float, *, name: str = "the organ") -> BSplineSurface:
    """Make the surface at a distance outside of a closed one.

    Parameters
    ----------
    surface : BSplineSurface
        Closed, valid, normals outward; RAS mm.
    distance : float
        mm.
    name : str
        What it is called in messages.

    Returns
    -------
    BSplineSurface
        Interpolates S + distance n with as many knots as keep the thickness within 1 % or 0.01 mm.

    Raises
    ------
    ValueError
        If the wall would pass through itself, with the place; or if the surface has an edge on which a wall cannot
        stand.
    """
    _check_hollows(surface, distance, name)
    tolerance = max(_RELATIVE * distance, _ABSOLUTE)
    refined = surface
    while max(refined.control_net.shape[:2]) <= _LARGEST_NET:
        outer = _interpolated(surface, refined, distance)
        worst, place = _thickness_error(surface, outer, distance)
        if worst <= tolerance:
            _check_outer(surface, outer, distance, name)
            return outer
        refined = refined.refined()
    msg = (
        f"The wall of {name} cannot be made {distance:g} mm thick at {_at(place)}, where the surface has an edge; "
        "fit the organ with the smooth closure."
    )
    raise ValueError(msg)


def _check_hollows(surface: BSplineSurface, distance: float, name: str) -> None:
    """Refuse a wall that is thicker than the radius of a hollow of the surface."""
    u, v = (surface.span_steps(axis, per_span=8, middles=True) for axis in (0, 1))
    hollow = -curvatures(surface, u, v)[..., 0]
    i, j = np.unravel_index(np.argmax(hollow), hollow.shape)
    if hollow[i, j] * distance >= 1.0:
        place = surface.points([u[i]], [v[j]])[0]
        msg = (
            f"A wall of {distance:g} mm around {name} would pass through itself at {_at(place)}, where the surface "
            f"is hollow with a radius of {1.0 / hollow[i, j]:.2g} mm; choose a thinner wall."
        )
        raise ValueError(msg)


def _check_outer(surface: BSplineSurface, outer: BSplineSurface, distance: float, name: str) -> None:
    problems = check_surface(outer)
    if problems:
        msg = (
            f"A wall of {distance:g} mm around {name} would pass through itself at {_at(problems[0].point)}; "
            "choose a thinner wall."
        )
        raise ValueError(msg)


def _interpolated(surface: BSplineSurface, like: BSplineSurface, distance: float) -> BSplineSurface:
    """Surface with the knots of another one through the offset points at its Greville abscissae."""
    degrees, knots = like.degrees, like.knots
    places = [
        np.clip(bspline.greville_abscissae(degree, ts), *bspline.domain(degree, ts))
        for degree, ts in zip(degrees, knots)
    ]
    net = _offset_points(surface, *places, distance)
    for axis in (0, 1):
        matrix = bspline.collocation(degrees[axis], knots[axis], places[axis]).tocsc()
        rows = np.moveaxis(net, axis, 0)
        solved = sparse_linalg.splu(matrix).solve(np.ascontiguousarray(rows.reshape(len(rows), -1)))
        net = np.moveaxis(solved.reshape(rows.shape), 0, axis)
    # To the last bit, so that the surface counts as closed.
    net = np.array(net)
    net[-1] = net[0]
    for end, pole in zip((0, -1), surface.poles):
        if pole:
            net[:, end] = net[:, end].mean(axis=0)
    return BSplineSurface(degrees, *knots, net)


def _offset_points(surface: BSplineSurface, u: np.ndarray, v: np.ndarray, distance: float) -> np.ndarray:
    """Points S + distance n on a grid of parameters, (m_u, m_v, 3); one point at each pole and along the seam."""
    normals = surface.grid_normals(u, v)
    if surface.closed_u:
        normals[[0, -1]] = (normals[0] + normals[-1]) / 2.0
    for end, pole in zip((0, -1), surface.poles):
        if pole:
            normals[:, end] = normals[:, end].mean(axis=0)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return surface.grid(u, v) + distance * normals


def _thickness_error(surface: BSplineSurface, outer: BSplineSurface, distance: float):
    """Largest distance from the exact offset points between the knots, and where, RAS mm."""
    u, v = (outer.span_steps(axis, per_span=3, middles=True) for axis in (0, 1))
    exact = surface.grid(u, v) + distance * surface.grid_normals(u, v)
    apart = np.linalg.norm(outer.grid(u, v) - exact, axis=2)
    i, j = np.unravel_index(np.argmax(apart), apart.shape)
    return float(apart[i, j]), surface.points([u[i]], [v[j]])[0]


def _at(place: np.ndarray) -> str:
    return "R {:.1f}, A {:.1f}, S {:.1f} mm".format(*place)
