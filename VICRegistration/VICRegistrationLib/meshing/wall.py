"""The outer surface of a wall: a B-spline surface at a constant distance from that of the lumen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import linalg as sparse_linalg

from ..geometry import bspline
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from .sizes import curvatures

# Allowed error of the thickness, as a share of it or in mm, whichever is more.
_RELATIVE, _ABSOLUTE = 0.01, 0.01
# Most columns or rows of the net; meshers cannot handle more.
_LARGEST_NET = 140
# Thinner walls that are tried for the message, as shares of the thickness, if one is not possible.
_THINNER = (0.75, 0.5, 0.25)
# Relative singular value below which a ring of control points lies in one plane.
_PLANE = 1e-6


def offset_surface(surface: BSplineSurface, distance: float, *, name: str = "the organ") -> BSplineSurface:
    """Make the surface at a constant distance outside of a closed one.

    Parameters
    ----------
    surface : BSplineSurface
        Closed, valid, normals outward; RAS mm.
    distance : float
        mm.
    name : str
        Name of the organ in messages.

    Returns
    -------
    BSplineSurface
        RAS mm. It interpolates S + distance n, with the fewest knots that keep its distance from S within 1 % or 0.01
        mm. At a pole, S has a tangent plane but may have shallow creases, whose exact offset is folded. Then the ring
        of control points around the pole is an affine image of that of S.

    Raises
    ------
    ValueError
        If the wall would pass through itself, or the surface has a sharp edge; the message has the place.
    """
    outer, fault = _outer(surface, distance)
    if outer is not None:
        return outer
    if fault.edge:
        msg = (
            f"The wall of {name} cannot be made {distance:g} mm thick at {_at(fault.place)}, where the surface has an "
            "edge; fit the organ with the smooth closure."
        )
        raise ValueError(msg)
    thinner = (fraction * distance for fraction in _THINNER)
    possible = next((each for each in thinner if _outer(surface, each)[0] is not None), None)
    remedy = "no thinner one was found either" if possible is None else f"{possible:.3g} mm is possible"
    msg = (
        f"A wall of {distance:g} mm around {name} would pass through itself at {_at(fault.place)}{fault.cause}; "
        f"{remedy}."
    )
    raise ValueError(msg)


@dataclass(frozen=True)
class _Fault:
    """Why a wall is not possible, and at which place, RAS mm."""

    place: np.ndarray
    cause: str = ""
    edge: bool = False


def _outer(surface: BSplineSurface, distance: float) -> tuple[BSplineSurface | None, _Fault | None]:
    """Offset surface with the fewest knots, or the reason why there is none."""
    refined, fault = surface, None
    while max(refined.control_net.shape[:2]) <= _LARGEST_NET:
        exact = _interpolated(surface, refined, distance)
        for outer in (exact, _with_smooth_poles(exact, refined)):
            worst, place = _thickness_error(surface, outer, distance)
            if worst > max(_RELATIVE * distance, _ABSOLUTE):
                continue
            problems = check_surface(outer)
            if not problems:
                return outer, None
            fault = fault or _Fault(np.array(problems[0].point))
        refined = refined.refined()
    return None, _hollow(surface, distance) or fault or _Fault(place, edge=True)


def _hollow(surface: BSplineSurface, distance: float) -> _Fault | None:
    """Find the concave place with the smallest radius of curvature, if that is less than the thickness."""
    u, v = (surface.span_steps(axis, per_span=8, middles=True) for axis in (0, 1))
    hollow = -curvatures(surface, u, v)[..., 0]
    i, j = np.unravel_index(np.argmax(hollow), hollow.shape)
    if hollow[i, j] * distance < 1.0:
        return None
    cause = f", where the surface is hollow with a radius of {1.0 / hollow[i, j]:.2g} mm"
    return _Fault(surface.points([u[i]], [v[j]])[0], cause)


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
    # Bit for bit, so that the surface is closed.
    net = np.array(net)
    net[-1] = net[0]
    for end, pole in zip((0, -1), surface.poles):
        if pole:
            net[:, end] = net[:, end].mean(axis=0)
    return BSplineSurface(degrees, *knots, net)


def _with_smooth_poles(outer: BSplineSurface, like: BSplineSurface) -> BSplineSurface:
    """Make the ring of control points around each pole an affine image of another surface's."""
    net = np.array(outer.control_net)
    for end, ring, pole in zip((0, -1), (1, -2), outer.poles):
        if pole:
            own, wanted = (each[:, ring] - each[0, end] for each in (like.control_net, net))
            net[:, ring] = net[0, end] + own @ np.linalg.lstsq(own, wanted, rcond=_PLANE)[0]
    return outer.with_control_net(net)


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
    """Largest error of the wall's thickness between the knots, mm, and the place, RAS mm."""
    u, v = (outer.span_steps(axis, per_span=3, middles=True) for axis in (0, 1))
    points = outer.grid(u, v)
    # The exact offset points bound the error, and are quick to compute.
    exact = surface.grid(u, v) + distance * surface.grid_normals(u, v)
    apart = np.linalg.norm(points - exact, axis=2)
    doubtful = apart > max(_RELATIVE * distance, _ABSOLUTE)
    if doubtful.any():
        apart[doubtful] = np.abs(closest_points(surface, points[doubtful]).distances - distance)
    i, j = np.unravel_index(np.argmax(apart), apart.shape)
    return float(apart[i, j]), points[i, j]


def _at(place: np.ndarray) -> str:
    return "R {:.1f}, A {:.1f}, S {:.1f} mm".format(*place)
