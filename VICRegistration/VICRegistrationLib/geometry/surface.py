"""A tensor-product B-spline surface (equation 1 of Jiang et al., Strain 2019)."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from ..surface_formats import writer_of
from . import bspline

if TYPE_CHECKING:
    from .projection import Projection

# Two control points closer than this fraction of the net's size are one point: seams and poles.
COINCIDENCE = 1e-9


@dataclass(frozen=True, eq=False)
class BSplineSurface:
    """B-spline surface S(u, v) = sum_i sum_j N_i,p(u) N_j,q(v) p_ij.

    Parameters
    ----------
    degrees : (p, q)
        Degrees in u and v, at least 1.
    knots_u, knots_v : (n_u + p + 1,), (n_v + q + 1,) array_like
        Knot vectors, ascending; clamped or not.
    control_net : (n_u, n_v, 3) array_like
        Control points p_ij, RAS mm.

    Raises
    ------
    ValueError
        If knots, degrees and control net do not fit together or are not finite.

    Notes
    -----
    The normal is that of S_u x S_v. The generic models are oriented so that it points outward.

    References
    ----------
    .. [1] L. Piegl and W. Tiller: The NURBS Book. Springer, 2nd edition, 1997, chapter 3.

    Examples
    --------
    The generic model of a closed organ, as a ball with a radius of 16 mm:

    >>> import numpy as np
    >>> from VICRegistrationLib.geometry.models import closed_organ
    >>> ball = closed_organ((9, 7), axes=16.0 * np.eye(3))
    >>> ball
    BSplineSurface(11 x 7 control points of degrees (3, 3), 63 mm large)
    >>> print(f"{ball.volume() / 1000:.1f} ml, {ball.area() / 100:.0f} cm2")
    17.1 ml, 32 cm2
    >>> ball.points([0.5], [0.5]).shape
    (1, 3)
    """

    degrees: tuple[int, int]
    knots_u: np.ndarray
    knots_v: np.ndarray
    control_net: np.ndarray

    def __post_init__(self) -> None:
        """Check the parts against each other and make the arrays read-only."""
        p, q = self.degrees
        knots_u = bspline.validated_knots(p, self.knots_u)
        knots_v = bspline.validated_knots(q, self.knots_v)
        net = np.array(self.control_net, dtype=float)
        needed = (len(knots_u) - p - 1, len(knots_v) - q - 1, 3)
        if net.shape != needed:
            msg = f"A control net of shape {net.shape} was given; the degrees and knots need {needed}."
            raise ValueError(msg)
        if not np.isfinite(net).all():
            msg = "The control net has points that are not finite; give coordinates in mm."
            raise ValueError(msg)
        for array in (knots_u, knots_v, net):
            array.flags.writeable = False
        object.__setattr__(self, "degrees", (int(p), int(q)))
        object.__setattr__(self, "knots_u", knots_u)
        object.__setattr__(self, "knots_v", knots_v)
        object.__setattr__(self, "control_net", net)

    def __repr__(self) -> str:
        """Show the size of the net, not its points."""
        rows, columns = self.control_net.shape[:2]
        return f"BSplineSurface({rows} x {columns} control points of degrees {self.degrees}, {self.size:.3g} mm large)"

    @property
    def knots(self) -> tuple[np.ndarray, np.ndarray]:
        """Knot vectors in u and v."""
        return self.knots_u, self.knots_v

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Parameter ranges ``((u_min, u_max), (v_min, v_max))``."""
        return tuple(bspline.domain(degree, knots) for degree, knots in zip(self.degrees, self.knots))

    @property
    def size(self) -> float:
        """Diagonal of the control net's bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.control_net.reshape(-1, 3), axis=0)))

    def closest_points(self, points: np.ndarray) -> Projection:
        """Find the closest point of the surface for each of many points.

        Parameters
        ----------
        points : (n, 3) array_like
            RAS mm.

        Returns
        -------
        Projection
            Parameters, points and signed distances, positive outside.

        Raises
        ------
        ValueError
            If the points are not (n, 3) finite numbers.

        Examples
        --------
        >>> import numpy as np
        >>> from VICRegistrationLib.geometry.models import closed_organ
        >>> ball = closed_organ((33, 19), axes=16.0 * np.eye(3))
        >>> ball.closest_points([[20, 0, 0], [0, 12, 0]]).distances.round(1)
        array([ 4., -4.])
        """
        # projection.py imports this class.
        from .projection import closest_points

        return closest_points(self, points)

    def save(self, path: str | os.PathLike, *, name: str = "", **choices) -> None:
        """Write the surface to a file, completely or not at all.

        Parameters
        ----------
        path : path
            Its ending chooses the format: .json (all control points), .step or .stp (an exact solid, for CAD), .vtp
            (triangles that carry the control points), .stl or .ply (triangles). Its folder must exist.
        name : str
            Name of the organ; that of the file if not given.
        **choices
            Options of the format: ``chord_error`` in mm for triangles, ``faces`` for STEP.

        Raises
        ------
        ValueError
            If no format has this ending, or the surface is no valid solid (STEP).
        OSError
            If the file cannot be written; a file of that name is left as it was.

        Examples
        --------
        >>> import numpy as np, os, tempfile
        >>> from VICRegistrationLib.geometry.models import closed_organ
        >>> ball = closed_organ((9, 7), axes=16.0 * np.eye(3))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     ball.save(os.path.join(folder, "ball.step"))
        ...     ball.save(os.path.join(folder, "ball.stl"), chord_error=0.1)
        ...     print(sorted(os.listdir(folder)))
        ['ball.step', 'ball.stl']
        """
        writer_of(path)(self, path, name=name or Path(path).stem, **choices)

    def with_control_net(self, control_net: np.ndarray) -> BSplineSurface:
        """Copy with another control net, (n_u, n_v, 3) RAS mm."""
        return replace(self, control_net=control_net)

    def transformed(self, matrix: np.ndarray) -> BSplineSurface:
        """Move the surface by a 4x4 affine matrix acting on RAS mm (exact for B-splines)."""
        matrix = np.asarray(matrix, dtype=float)
        return self.with_control_net(self.control_net @ matrix[:3, :3].T + matrix[:3, 3])

    def turned(self) -> BSplineSurface:
        """Reverse u: the same surface with opposite normals."""
        low, high = self.domain[0]
        return replace(self, knots_u=(low + high) - self.knots_u[::-1], control_net=self.control_net[::-1])

    # ------------------------------------------------------------------ parameters

    def span_limits(self, axis: int) -> np.ndarray:
        """Return the ends of the knot spans along an axis (0 is u, 1 is v), ascending."""
        return bspline.span_limits(self.degrees[axis], self.knots[axis])

    def span_steps(self, axis: int, *, per_span: int, least: int = 0, middles: bool = False) -> np.ndarray:
        """Return parameters along an axis (0 is u, 1 is v) at equal steps in every knot span.

        Parameters
        ----------
        axis : {0, 1}
        per_span, least : int
            Least number of steps in a span, and in all.
        middles : bool
            Whether to return the middles of the steps, which lie on no knot, or all ends of steps.

        Returns
        -------
        (n,) ndarray
        """
        limits = self.span_limits(axis)
        steps = max(per_span, -(-least // (len(limits) - 1)))
        fractions = (np.arange(steps) + (0.5 if middles else 0.0)) / steps
        inner = (limits[:-1, None] + np.diff(limits)[:, None] * fractions).ravel()
        return inner if middles else np.append(inner, limits[-1])

    def midpoint_axes(self, n_u: int, n_v: int) -> tuple[np.ndarray, np.ndarray]:
        """Midpoints of n_u and n_v equal intervals of the parameters, (n_u,) and (n_v,), off the poles and the seam."""
        counts = zip(self.domain, (n_u, n_v))
        return tuple(low + (high - low) * (np.arange(count) + 0.5) / count for (low, high), count in counts)

    def midpoints(self, n_u: int, n_v: int) -> tuple[np.ndarray, np.ndarray]:
        """All pairs of :meth:`midpoint_axes`: u and v, each (n_u * n_v,)."""
        u, v = np.meshgrid(*self.midpoint_axes(n_u, n_v), indexing="ij")
        return u.ravel(), v.ravel()

    # ------------------------------------------------------------------ evaluation

    def grid_basis(self, u: np.ndarray, v: np.ndarray, *, du: int = 0, dv: int = 0) -> sparse.csr_matrix:
        """Basis functions, or a partial derivative, on the grid of all pairs of parameters.

        Parameters
        ----------
        u, v, du, dv
            As in :meth:`grid`.

        Returns
        -------
        (m_u * m_v, n_u * n_v) csr_matrix
            Its product with the control points gives the points of :meth:`grid`, u-major.

        Raises
        ------
        ValueError
            If a parameter lies outside the domain.
        """
        along_u = bspline.collocation(self.degrees[0], self.knots_u, u, du)
        along_v = bspline.collocation(self.degrees[1], self.knots_v, v, dv)
        return sparse.kron(along_u, along_v, format="csr")

    def grid(self, u: np.ndarray, v: np.ndarray, *, du: int = 0, dv: int = 0) -> np.ndarray:
        """Points, or a partial derivative, on the grid of all pairs of parameters.

        Parameters
        ----------
        u : (m_u,) array_like
        v : (m_v,) array_like
            Parameters inside the domain.
        du, dv : int
            Orders of the derivative in u and v.

        Returns
        -------
        (m_u, m_v, 3) ndarray
            RAS mm (per parameter unit for derivatives).

        Raises
        ------
        ValueError
            If a parameter lies outside the domain.
        """
        n_u, n_v, _ = self.control_net.shape
        basis_u = bspline.collocation(self.degrees[0], self.knots_u, u, du)
        basis_v = bspline.collocation(self.degrees[1], self.knots_v, v, dv)
        rows = (basis_u @ self.control_net.reshape(n_u, -1)).reshape(-1, n_v, 3)
        columns = basis_v @ rows.transpose(1, 0, 2).reshape(n_v, -1)
        return columns.reshape(-1, len(rows), 3).transpose(1, 0, 2)

    def points(self, u: np.ndarray, v: np.ndarray, *, du: int = 0, dv: int = 0) -> np.ndarray:
        """Points, or a partial derivative, at pairs of parameters.

        Parameters
        ----------
        u, v : (n,) array_like
            Parameters inside the domain.
        du, dv : int
            Orders of the derivative in u and v.

        Returns
        -------
        (n, 3) ndarray
            RAS mm (per parameter unit for derivatives).

        Raises
        ------
        ValueError
            If a parameter lies outside the domain.
        """
        first_u, values_u = bspline.nonzero_basis(self.degrees[0], self.knots_u, u, du)
        first_v, values_v = bspline.nonzero_basis(self.degrees[1], self.knots_v, v, dv)
        i = first_u[:, None, None] + np.arange(values_u.shape[1])[None, :, None]
        j = first_v[:, None, None] + np.arange(values_v.shape[1])[None, None, :]
        return np.einsum("na,nb,nabk->nk", values_u, values_v, self.control_net[i, j])

    def area_vectors(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Compute S_u x S_v at pairs of parameters: along the normal, with the area per unit of u and v as length.

        Parameters
        ----------
        u, v : (n,) array_like
            Parameters inside the domain.

        Returns
        -------
        (n, 3) ndarray
            mm^2 per parameter units; zero at a pole.
        """
        return np.cross(self.points(u, v, du=1), self.points(u, v, dv=1))

    def grid_area_vectors(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Compute :meth:`area_vectors` on the grid of all pairs of parameters (m_u,) and (m_v,): (m_u, m_v, 3)."""
        return np.cross(self.grid(u, v, du=1), self.grid(u, v, dv=1))

    def normals(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return unit normals at pairs of parameters; at a pole, the normal of the tangent plane.

        Parameters
        ----------
        u, v : (n,) array_like
            Parameters inside the domain.

        Returns
        -------
        (n, 3) ndarray
        """
        u, v = np.asarray(u, dtype=float), np.asarray(v, dtype=float)
        return self._normals(u, v, self.points(u, v, du=1), self.points(u, v, dv=1))

    def grid_normals(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Compute :meth:`normals` on the grid of all pairs of parameters (m_u,) and (m_v,): (m_u, m_v, 3)."""
        along = (self.grid(u, v, du=1), self.grid(u, v, dv=1))
        pairs = (part.ravel() for part in np.meshgrid(u, v, indexing="ij"))
        return self._normals(*pairs, *(part.reshape(-1, 3) for part in along)).reshape(along[0].shape)

    def _normals(self, u: np.ndarray, v: np.ndarray, du: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """Return unit normals for the tangents at pairs of parameters."""
        cross = np.cross(du, dv)
        flat = np.linalg.norm(du, axis=1) <= 1e-7 * self.size
        if flat.any():
            # At a pole, where S_u vanishes, the normal is the limit of S_u x S_v, parallel to S_uv x S_v.
            mixed = np.cross(self.points(u[flat], v[flat], du=1, dv=1), dv[flat])
            at_end = v[flat] > np.mean(self.domain[1])
            cross[flat] = np.where(at_end[:, None], -mixed, mixed)
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)

    # ------------------------------------------------------------------ topology

    def _edge_points(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Control points of the two boundary curves across an axis, each (n, 3)."""
        degree, knots = self.degrees[axis], self.knots[axis]
        ends = bspline.collocation(degree, knots, bspline.domain(degree, knots))
        net = np.moveaxis(self.control_net, axis, 0)
        first, last = (ends @ net.reshape(len(net), -1)).reshape(2, -1, 3)
        return first, last

    @property
    def closed_u(self) -> bool:
        """Whether the edges u_min and u_max are one curve: the seam."""
        first, last = self._edge_points(0)
        return bool(np.abs(first - last).max() <= COINCIDENCE * self.size)

    @property
    def closed_v(self) -> bool:
        """Whether the edges v_min and v_max are one curve (a torus), not counting poles."""
        first, last = self._edge_points(1)
        return bool(np.abs(first - last).max() <= COINCIDENCE * self.size) and not any(self.poles)

    @property
    def poles(self) -> tuple[bool, bool]:
        """Whether the edges v_min and v_max are single points."""
        first, last = (np.ptp(edge, axis=0).max() <= COINCIDENCE * self.size for edge in self._edge_points(1))
        return bool(first), bool(last)

    @property
    def closed(self) -> bool:
        """Whether the surface bounds a solid: a seam in u, and two poles or a seam in v."""
        return self.closed_u and (all(self.poles) or self.closed_v)

    # ------------------------------------------------------------------ exact operations

    def insert_knots(self, *, u: np.ndarray = (), v: np.ndarray = ()) -> BSplineSurface:
        """Insert knots without changing the surface.

        Parameters
        ----------
        u, v : (r,) array_like
            Knots to insert in each direction, repeated for higher multiplicity.

        Returns
        -------
        BSplineSurface

        Raises
        ------
        ValueError
            If a knot lies outside the domain or its multiplicity would exceed the degree plus one.
        """
        knots_u, matrix_u = bspline.knot_insertion(self.degrees[0], self.knots_u, u)
        knots_v, matrix_v = bspline.knot_insertion(self.degrees[1], self.knots_v, v)
        n_u, n_v, _ = self.control_net.shape
        rows = (matrix_u @ self.control_net.reshape(n_u, -1)).reshape(-1, n_v, 3)
        columns = matrix_v @ rows.transpose(1, 0, 2).reshape(n_v, -1)
        net = columns.reshape(-1, len(rows), 3).transpose(1, 0, 2)
        return BSplineSurface(self.degrees, knots_u, knots_v, net)

    def refined(self) -> BSplineSurface:
        """Halve every span, without changing the surface, in both directions."""
        u, v = (self.span_steps(axis, per_span=1, middles=True) for axis in (0, 1))
        return self.insert_knots(u=u, v=v)

    def volume(self) -> float:
        """Volume enclosed by a closed surface, mm^3; positive when the normals point outward.

        Returns
        -------
        float

        Raises
        ------
        ValueError
            If the surface is not closed.

        Notes
        -----
        Divergence theorem, V = 1/3 int S . (S_u x S_v) du dv. The integrand is a polynomial on every knot span, so the
        Gauss quadrature is exact up to rounding.
        """
        if not self.closed:
            msg = "The surface is open; a volume needs a closed surface (a seam and two poles, or two seams)."
            raise ValueError(msg)
        # Relative to the net's centre, so that a surface far from the origin loses no digits.
        return self.cone_volume(self.control_net.mean(axis=(0, 1)))

    def cone_volume(self, apex: np.ndarray) -> float:
        """Volume between a point and the surface, mm^3; positive where the normals point away from the point.

        The values of the patches of a closed surface add up to its volume, for any point.

        Parameters
        ----------
        apex : (3,) ndarray
            The point, mm.

        Returns
        -------
        float
        """
        p, q = self.degrees
        u, weights_u = bspline.gauss_points(p, self.knots_u, (3 * p + 1) // 2)
        v, weights_v = bspline.gauss_points(q, self.knots_v, (3 * q + 1) // 2)
        offset = self.grid(u, v) - apex
        return float(np.einsum("i,j,ijk,ijk->", weights_u, weights_v, offset, self.grid_area_vectors(u, v)) / 3.0)

    def area(self, *, tolerance: float = 1e-9) -> float:
        """Area of the surface, mm^2.

        Parameters
        ----------
        tolerance : float
            Relative change at which doubling the quadrature points stops.

        Returns
        -------
        float

        Notes
        -----
        The integrand |S_u x S_v| is not a polynomial; Gauss quadrature on every knot span is refined until it settles.
        """
        previous = None
        for n_points in (6, 12, 24, 48):
            u, weights_u = bspline.gauss_points(self.degrees[0], self.knots_u, n_points)
            v, weights_v = bspline.gauss_points(self.degrees[1], self.knots_v, n_points)
            area = float(weights_u @ np.linalg.norm(self.grid_area_vectors(u, v), axis=2) @ weights_v)
            if previous is not None and abs(area - previous) <= tolerance * area:
                break
            previous = area
        return area
