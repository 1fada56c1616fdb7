"""Generic models: the closed organ and the paper's bell."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from . import bspline
from .parametrization import CLOSURES
from .parametrization import closed_organ as closed_organ_parametrization
from .surface import BSplineSurface

DEFAULT_NET = (9, 7)


def closed_organ(
    net: tuple[int, int] = DEFAULT_NET,
    *,
    degrees: tuple[int, int] = (3, 3),
    closure: str = "smooth",
    axes: np.ndarray | None = None,
    center: np.ndarray = (0.0, 0.0, 0.0),
) -> BSplineSurface:
    """Make a closed surface close to a sphere or ellipsoid: the start of every organ.

    Parameters
    ----------
    net : (rows, columns)
        Size in the paper's counting: the last row around the tube is the first one again, the first and the last
        column are the poles. 9 x 7 has 8 different rows and 5 columns between the poles.
    degrees : (p, q)
        Degrees around the tube (u) and from pole to pole (v).
    closure : {"smooth", "paper"}
        "smooth": periodic around the tube, stored with clamped knots (``rows - 1 + p`` rows in the control net).
        "paper": ``rows`` rows on clamped uniform knots, closed by midpoints.
    axes : (3, 3) array_like, optional
        Rows are the semi-axes of the ellipsoid, RAS mm, right-handed; the poles lie at both ends of the last one.
        The unit sphere if not given.
    center : (3,) array_like
        Centre, RAS mm.

    Returns
    -------
    BSplineSurface
        With outward normals.

    Raises
    ------
    ValueError
        If the net is too small for the degrees, the closure is unknown, or the axes are not right-handed.
    """
    axes = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    if axes.shape != (3, 3) or not np.isfinite(axes).all() or not np.linalg.det(axes) > 0.0:
        msg = "The semi-axes are not three right-handed vectors; a mirrored or flat organ is not a valid start."
        raise ValueError(msg)
    rows, columns = (int(size) for size in net)
    p, q = (int(degree) for degree in degrees)
    unit = _unit_sphere(rows, columns, (p, q), closure)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes.T, center
    return unit.transformed(matrix)


@lru_cache(maxsize=16)
def _unit_sphere(rows: int, columns: int, degrees: tuple[int, int], closure: str) -> BSplineSurface:
    """Make the generic model that comes closest to the unit sphere."""
    _check_net(rows, columns, degrees, closure)
    knots_v = bspline.uniform_clamped_knots(degrees[1], columns)
    if closure == "smooth":
        knots_u, around = bspline.periodic_to_clamped(degrees[0], np.linspace(0.0, 1.0, rows))
        angle = around @ _solved_circle(degrees[0], np.linspace(0.0, 1.0, rows))
    else:
        knots_u = bspline.uniform_clamped_knots(degrees[0], rows)
        theta = 2.0 * np.pi * np.arange(rows) / (rows - 1)
        angle = np.column_stack([np.cos(theta), np.sin(theta)])
        angle[[0, -1]] = (angle[1] + angle[-2]) / 2.0
    latitude = np.pi * bspline.greville_abscissae(degrees[1], knots_v)
    radius = np.sin(latitude)
    radius[[0, -1]] = 0.0
    height = -np.cos(latitude)
    height[[1, -2]] = height[[0, -1]]
    ring = angle[:, None, :] * radius[:, None]
    heights = np.broadcast_to(height[:, None], (len(angle), columns, 1))
    start = BSplineSurface(degrees, knots_u, knots_v, np.concatenate([ring, heights], axis=2))
    return _closest_to_sphere(start, closure)


def _check_net(rows: int, columns: int, degrees: tuple[int, int], closure: str) -> None:
    if closure not in CLOSURES:
        msg = f"The closure {closure!r} was asked for; choose one of {', '.join(CLOSURES)}."
        raise ValueError(msg)
    # With fewer rows the seam's midpoints fall onto the axis of the tube.
    needed_rows = max(degrees[0] + 2, 4) if closure == "smooth" else max(degrees[0] + 1, 6)
    needed_columns = max(degrees[1] + 1, 4 if closure == "smooth" else 5)
    if rows < needed_rows or columns < needed_columns:
        msg = (
            f"A net of {rows}x{columns} was asked for; degrees {degrees[0]} and {degrees[1]} with the {closure} "
            f"closure need at least {needed_rows}x{needed_columns}."
        )
        raise ValueError(msg)


def _solved_circle(degree: int, breaks: np.ndarray) -> np.ndarray:
    """Distinct control points (n, 2) of the periodic spline closest to the unit circle."""
    knots, around = bspline.periodic_to_clamped(degree, breaks)
    u, _ = bspline.gauss_points(degree, knots, degree + 1)
    basis = (bspline.collocation(degree, knots, u) @ around).toarray()
    circle = np.column_stack([np.cos(2.0 * np.pi * u), np.sin(2.0 * np.pi * u)])
    return np.linalg.lstsq(basis, circle, rcond=None)[0]


def _closest_to_sphere(start: BSplineSurface, closure: str) -> BSplineSurface:
    """Least-squares fit of the closed organ's degrees of freedom to the unit sphere."""
    parametrization = closed_organ_parametrization(start, closure=closure)
    u, _ = bspline.gauss_points(start.degrees[0], start.knots_u, 4)
    v, _ = bspline.gauss_points(start.degrees[1], start.knots_v, 4)
    basis_u = bspline.collocation(start.degrees[0], start.knots_u, u)
    basis_v = bspline.collocation(start.degrees[1], start.knots_v, v)
    basis = sparse.kron(basis_u, basis_v).tocsr()
    u, v = 2.0 * np.pi * np.repeat(u, len(v)), np.pi * np.tile(v, len(u))
    sphere = np.column_stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), -np.cos(v)])
    # Parametrized by angle, a sphere wants equal steps of latitude; the knots at the poles give others. What counts is
    # the shape, so the target is the point of the sphere above the current surface, a few times over.
    matrix = (basis @ parametrization.matrices[0]).tocsc()
    normal_equations = sparse_linalg.splu((matrix.T @ matrix).tocsc())
    for _ in range(20):
        offset = sphere - basis @ start.control_net.reshape(-1, 3)
        q = normal_equations.solve(matrix.T @ offset).T.ravel()
        points = basis @ parametrization.control_net(q).reshape(-1, 3)
        sphere = points / np.linalg.norm(points, axis=1, keepdims=True)
    return parametrization.deform(q)


def bell(size: float = 1.0, *, center: np.ndarray = (0.0, 0.0, 0.0)) -> BSplineSurface:
    """Make the open, bell-like surface of the paper's prototypical test, 9 x 4 control points.

    Parameters
    ----------
    size : float
        Edge of the control net's bounding box, mm.
    center : (3,) array_like
        Centre of that box, RAS mm.

    Returns
    -------
    BSplineSurface
        Cubic, seam in u, a pole at the top (v = 1), open at the bottom, normals outward.

    Notes
    -----
    Equations 8 and 9 and figure 7 of Jiang et al. (Strain 2019).
    """
    theta = np.arange(9) * np.pi / 4.0
    x = 0.5 * np.sign(np.round(np.cos(theta), 12))
    y = 0.5 * np.sign(np.round(np.sin(theta), 12))
    net = np.zeros((9, 4, 3))
    net[:, :3, 0], net[:, :3, 1] = x[:, None], y[:, None]
    net[:, :, 2] = [-0.5, 0.0, 0.5, 0.5]
    knots_u, knots_v = bspline.uniform_clamped_knots(3, 9), bspline.uniform_clamped_knots(3, 4)
    return BSplineSurface((3, 3), knots_u, knots_v, np.asarray(center, dtype=float) + size * net)
