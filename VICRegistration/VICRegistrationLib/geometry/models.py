"""Generic models: the surfaces from which fits start.

A generic model is a function of the organ's shape, the size of the control net and the closure. To add one, write that
function, with :func:`drawn` in a few lines, and give it a name in `GENERIC_MODELS`; fits take it by that name
(``FitOptions(model="ellipsoid")``). This file also has the closed organ close to a sphere, from which models are made,
and the paper's bell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.sparse import linalg as sparse_linalg

from . import bspline
from .centreline import Centreline, centreline
from .parametrization import closed_organ as closed_organ_parametrization
from .surface import BSplineSurface

DEFAULT_NET = (9, 7)
# The automatic model is the tube if two conditions are met. The bend of the centreline is larger than this: tubes bent
# by 60 to 250 degrees have 1.3 to 3.8; up to 1.2 an ellipsoid suits eggs as well or better.
_BENT = 1.2
# And the tube's misfit is less than this share of the ellipsoid's: 0.1 to 0.3 for bent tubes, 1.2 to 2.4 for eggs and
# pears.
_NEARER = 0.7
# Number of samples in u and v for the misfit.
_SAMPLES = (32, 20)


@dataclass(frozen=True, eq=False)
class OrganShape:
    """Shape of a separated organ, in the frame of its principal axes about its centre: the input of a generic model.

    Parameters
    ----------
    extents : (3,) ndarray
        Standard deviations along x, y and z, mm, longest first; a solid ellipsoid's semi-axes are sqrt(5) times these.
    inside : (nk, nj, ni) ndarray of bool
        Mask of the organ on a lattice with equal steps.
    lattice : (4, 4) ndarray
        Takes indices (i, j, k) to mm.
    distance : callable
        Signed distances from the boundary, (n,) mm, negative inside, at points (n, 3) mm.
    """

    extents: np.ndarray
    inside: np.ndarray
    lattice: np.ndarray
    distance: Callable[[np.ndarray], np.ndarray]

    def misfit(self, surface: BSplineSurface) -> float:
        """Mean distance of a surface from the organ's boundary, mm."""
        return float(np.abs(self.distance(surface.points(*surface.midpoints(*_SAMPLES)))).mean())


def generic_model(name: str, shape: OrganShape, net: tuple[int, int], closure: str) -> BSplineSurface:
    """Make a generic model by its name in `GENERIC_MODELS`.

    Parameters
    ----------
    name : str
    shape : OrganShape
    net : (rows, columns)
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface
        In the frame of the shape.

    Raises
    ------
    ValueError
        If there is no such model, it cannot be made for this organ, or its surface is no closed organ with that net.
    """
    if name not in GENERIC_MODELS:
        msg = f"The generic model {name!r} was asked for; choose one of {', '.join(GENERIC_MODELS)}."
        raise ValueError(msg)
    surface = GENERIC_MODELS[name](shape, net, closure)
    needed = closed_organ(net, closure=closure).control_net.shape
    if surface.control_net.shape != needed or not (surface.closed_u and all(surface.poles) and surface.volume() > 0.0):
        msg = (
            f"The generic model {name!r} has a control net of shape {surface.control_net.shape}; needed is {needed}, "
            "closed by a seam and two poles, with outward normals. Make it with drawn() or closed_organ()."
        )
        raise ValueError(msg)
    return surface


def automatic(shape: OrganShape, net: tuple[int, int], closure: str, *, least_bend: float = _BENT) -> BSplineSurface:
    """Make the ellipsoid, or a tube if the organ is bent and the tube fits much better.

    Notes
    -----
    The bend alone does not decide: the centreline of an egg is bent too, but the ellipsoid fits an egg better.
    """
    straight = ellipsoid(shape, net, closure)
    axis = centreline(shape.inside, shape.lattice)
    if axis is None or axis.bend <= least_bend:
        return straight
    tube = _tube_along(axis, net, closure)
    return straight if shape.misfit(tube) > _NEARER * shape.misfit(straight) else tube


def ellipsoid(shape: OrganShape, net: tuple[int, int], closure: str) -> BSplineSurface:
    """Make an ellipsoid with the organ's moments, poles at both ends of its longest axis."""
    longest, middle, shortest = np.sqrt(5.0) * shape.extents
    axes = np.array([[0.0, middle, 0.0], [0.0, 0.0, shortest], [longest, 0.0, 0.0]])
    return closed_organ(net, closure=closure, axes=axes)


def tube(shape: OrganShape, net: tuple[int, int], closure: str) -> BSplineSurface:
    """Make a tube along the organ's centreline, with the organ's cross-sections and a pole at each end.

    Raises
    ------
    ValueError
        If the organ is too small to have a centreline.
    """
    axis = centreline(shape.inside, shape.lattice)
    if axis is None:
        msg = "The region is too small for a tube; choose the generic model 'ellipsoid', or check the thresholds."
        raise ValueError(msg)
    return _tube_along(axis, net, closure)


def _tube_along(axis: Centreline, net: tuple[int, int], closure: str) -> BSplineSurface:
    return drawn(axis.bent, net, closure=closure)


GENERIC_MODELS: dict[str, Callable[[OrganShape, tuple[int, int], str], BSplineSurface]] = {
    "automatic": automatic,
    "ellipsoid": ellipsoid,
    "tube": tube,
}


def drawn(
    place: Callable[[np.ndarray], np.ndarray], net: tuple[int, int] = DEFAULT_NET, *, closure: str = "smooth"
) -> BSplineSurface:
    """Make a closed organ of any form, by a map of the unit sphere.

    Parameters
    ----------
    place : callable
        Maps points of the unit sphere (n, 3) to mm, (n, 3); one to one, and without mirroring. The poles are
        (0, 0, -1) and (0, 0, 1).
    net : (rows, columns)
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface
        The least-squares fit to the mapped points by a closed organ with that net.
    """
    sphere = closed_organ(net, closure=closure)
    counts = max(3 * (net[0] - 1), 24), max(3 * (net[1] - 3), 12)
    points = sphere.grid_basis(*sphere.midpoint_axes(*counts)) @ sphere.control_net.reshape(-1, 3)
    return closed_through(place(points), counts, net, closure=closure)


def closed_through(
    points: np.ndarray, counts: tuple[int, int], net: tuple[int, int], *, closure: str
) -> BSplineSurface:
    """Fit a closed organ to points of another surface by least squares.

    Parameters
    ----------
    points : (n_u * n_v, 3) ndarray
        mm, at the midpoints of equal intervals of the parameters, see :meth:`.surface.BSplineSurface.midpoints`.
    counts : (n_u, n_v)
    net : (rows, columns)
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface
    """
    sphere = closed_organ(net, closure=closure)
    closed = closed_organ_parametrization(sphere, closure=closure)
    basis = sphere.grid_basis(*sphere.midpoint_axes(*counts))
    start = basis @ sphere.control_net.reshape(-1, 3)
    q = np.zeros(closed.n_dof)
    for k, (matrix, index) in enumerate(zip(closed.matrices, closed.indices)):
        q[index] = np.linalg.lstsq((basis @ matrix).toarray(), points[:, k] - start[:, k], rcond=None)[0]
    return closed.deform(q)


def closed_organ(
    net: tuple[int, int] = DEFAULT_NET,
    *,
    degrees: tuple[int, int] = (3, 3),
    closure: str = "smooth",
    axes: np.ndarray | None = None,
    center: np.ndarray = (0.0, 0.0, 0.0),
) -> BSplineSurface:
    """Make a closed surface close to a sphere or ellipsoid.

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
    # With fewer rows the midpoints at the seam lie on the axis.
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
    basis = start.grid_basis(u, v)
    u, v = 2.0 * np.pi * np.repeat(u, len(v)), np.pi * np.tile(v, len(u))
    sphere = np.column_stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), -np.cos(v)])
    # The knots do not allow equal steps of latitude at the poles. As only the shape matters, the target of each sample
    # is the radial projection of the current surface to the sphere, a few times over.
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
