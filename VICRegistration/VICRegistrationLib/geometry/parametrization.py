"""Parametrizations: linear maps from degrees of freedom to control nets, P = P0 + E q.

Every parametrization has one matrix for each coordinate, so that one cost, one Jacobian (chain rule through E) and one
solver serve all of them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg
from scipy.spatial.transform import Rotation

from . import bspline
from .surface import BSplineSurface

AFFINE_NAMES = tuple(f"R{row}{column}" for row in range(3) for column in range(3)) + ("T0", "T1", "T2")
AFFINE_PRESETS = {
    "scaling": ("R00", "R11", "R22"),
    "translation": ("T0", "T1", "T2"),
    "linear": AFFINE_NAMES[:9],
    "affine": AFFINE_NAMES,
}
CLOSURES = ("smooth", "paper")


@dataclass(frozen=True, eq=False)
class Parametrization:
    """Linear map from degrees of freedom q to a control net.

    Parameters
    ----------
    surface : BSplineSurface
        The surface at q = 0 (P0).
    matrices : three (n_u * n_v, n_k) csr_matrix
        Displacement of the control points (u-major order) along R, A and S by the degrees of freedom of that
        coordinate.
    indices : three (n_k,) ndarray of int
        Where the degrees of freedom of each coordinate are in q. Coordinates may share some.
    n_dof : int
        Length of q.
    """

    surface: BSplineSurface
    matrices: tuple[sparse.csr_matrix, sparse.csr_matrix, sparse.csr_matrix]
    indices: tuple[np.ndarray, np.ndarray, np.ndarray]
    n_dof: int
    _forms: dict = field(default_factory=dict, repr=False)

    def at(self, surface: BSplineSurface) -> Parametrization:
        """Copy with another surface at q = 0, which the degrees of freedom can reach."""
        return replace(self, surface=surface)

    def control_net(self, q: np.ndarray) -> np.ndarray:
        """Return the control net P0 + E q, (n_u, n_v, 3) RAS mm, for degrees of freedom (n_dof,)."""
        net = self.surface.control_net
        moved = [matrix @ q[index] for matrix, index in zip(self.matrices, self.indices)]
        return net + np.stack(moved, axis=-1).reshape(net.shape)

    def deform(self, q: np.ndarray) -> BSplineSurface:
        """Return the surface with degrees of freedom q, (n_dof,)."""
        return self.surface.with_control_net(self.control_net(q))

    def scales(self) -> np.ndarray:
        """Root mean square displacement of the control points by one unit of each degree of freedom, (n_dof,) mm.

        Used in gradient descent to normalise translations (mm) and entries of R (dimensionless).
        """
        squared = np.zeros(self.n_dof)
        for matrix, index in zip(self.matrices, self.indices):
            squared[index] += np.asarray(matrix.multiply(matrix).mean(axis=0)).ravel()
        return np.sqrt(squared)

    def quadratic_form(self, form: sparse.spmatrix):
        """Convert a quadratic form of the control points, the same for each coordinate, to the degrees of freedom.

        Parameters
        ----------
        form : (n_u * n_v, n_u * n_v) sparse matrix
            Symmetric.

        Returns
        -------
        (n_dof, n_dof) csc_matrix
        """
        # The last four are cached for the stages of a registration, with the form, so that its id is not used again.
        if id(form) not in self._forms:
            while len(self._forms) >= 4:
                self._forms.pop(next(iter(self._forms)))
            self._forms[id(form)] = form, self._quadratic_form(form)
        return self._forms[id(form)][1]

    def _quadratic_form(self, form: sparse.spmatrix):
        total = sparse.csc_matrix((self.n_dof, self.n_dof))
        made = {}
        for matrix, index in zip(self.matrices, self.indices):
            if id(matrix) not in made:
                made[id(matrix)] = (matrix.T @ form @ matrix).tocoo()
            block = made[id(matrix)]
            place = (index[block.row], index[block.col])
            total = total + sparse.csc_matrix((block.data, place), shape=(self.n_dof, self.n_dof))
        return total

    def fit(self, control_net: np.ndarray) -> np.ndarray:
        """Fit the degrees of freedom to a control net by least squares.

        Parameters
        ----------
        control_net : (n_u, n_v, 3) array_like
            RAS mm.

        Returns
        -------
        (n_dof,) ndarray
        """
        offset = (np.asarray(control_net) - self.surface.control_net).reshape(-1, 3)
        right = np.zeros(self.n_dof)
        for k, (matrix, index) in enumerate(zip(self.matrices, self.indices)):
            np.add.at(right, index, matrix.T @ offset[:, k])
        return sparse_linalg.spsolve(self.quadratic_form(_identity(len(offset))), right)


@lru_cache(maxsize=8)
def _identity(n: int) -> sparse.spmatrix:
    return sparse.identity(n, format="csr")


def _same_for_all_coordinates(surface: BSplineSurface, matrix: sparse.spmatrix) -> Parametrization:
    """Make a parametrization whose three coordinates have the same matrix and their own degrees of freedom."""
    n = matrix.shape[1]
    matrix = sparse.csr_matrix(matrix)
    indices = tuple(np.arange(n) + k * n for k in range(3))
    return Parametrization(surface, (matrix,) * 3, indices, 3 * n)


def affine(
    surface: BSplineSurface, *, free: str | tuple[str, ...] = "affine", center: np.ndarray | None = None
) -> Parametrization:
    """Global transformation p = R (p0 - c) + T + c with any subset of R and T free.

    Parameters
    ----------
    surface : BSplineSurface
        The surface to be moved.
    free : str or tuple of str
        Names out of R00, R01, ..., R22, T0, T1, T2, or one of the presets "scaling" (the diagonal of R),
        "translation", "linear" (all of R) and "affine" (all twelve). The degrees of freedom are the deviations from
        R = identity and T = 0, in the order of the names.
    center : (3,) array_like, optional
        The local origin c, RAS mm; the mean of the control points if not given.

    Returns
    -------
    Parametrization

    Notes
    -----
    Equation 2 of Jiang et al. (Strain 2019).
    """
    names = AFFINE_PRESETS.get(free, (free,)) if isinstance(free, str) else tuple(free)
    net = surface.control_net.reshape(-1, 3)
    origin = net.mean(axis=0) if center is None else np.asarray(center, dtype=float)
    columns = np.column_stack([net - origin, np.ones(len(net))])
    matrices, indices = [], []
    for row in range(3):
        own = [f"R{row}0", f"R{row}1", f"R{row}2", f"T{row}"]
        chosen = [k for k, name in enumerate(own) if name in names]
        matrices.append(sparse.csr_matrix(columns[:, chosen]))
        indices.append(np.array([names.index(own[k]) for k in chosen], dtype=int))
    return Parametrization(surface, tuple(matrices), tuple(indices), len(names))


def affine_matrix(
    q: np.ndarray, *, free: str | tuple[str, ...] = "affine", center: np.ndarray = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Return the 4x4 matrix of equation 2 for degrees of freedom of :func:`affine`.

    Parameters
    ----------
    q : (n,) array_like
        Degrees of freedom.
    free, center
        As given to :func:`affine`.

    Returns
    -------
    (4, 4) ndarray
        Acts on RAS mm; its upper left block is R.
    """
    names = AFFINE_PRESETS.get(free, (free,)) if isinstance(free, str) else tuple(free)
    values = dict(zip(names, q))
    linear = np.eye(3)
    shift = np.array([values.get(f"T{row}", 0.0) for row in range(3)])
    for name, value in values.items():
        if re.fullmatch("R[0-2][0-2]", name):
            linear[int(name[1]), int(name[2])] += value
    center = np.asarray(center, dtype=float)
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    matrix[:3, 3] = shift + center - linear @ center
    return matrix


def rigid(surface: BSplineSurface, center: np.ndarray) -> Parametrization:
    """Small rotation and translation, p = p0 + w x (p0 - c) + t, with the degrees of freedom w (radians) and t (mm).

    Parameters
    ----------
    surface : BSplineSurface
        The surface to be moved.
    center : (3,) array_like
        The centre c of the rotation, mm.

    Returns
    -------
    Parametrization
        Of first order in w; :func:`rigid_matrix` is exact. The coordinates share w, so that
        :meth:`Parametrization.fit` does not apply.
    """
    x, y, z = (surface.control_net.reshape(-1, 3) - center).T
    none, ones = np.zeros_like(x), np.ones_like(x)
    turned = ((none, z, -y), (-z, none, x), (y, -x, none))
    columns = [np.column_stack([*parts, *(ones * (axis == k) for k in range(3))]) for axis, parts in enumerate(turned)]
    return Parametrization(surface, tuple(map(sparse.csr_matrix, columns)), (np.arange(6),) * 3, 6)


def rigid_matrix(q: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Return the exact motion (4, 4), mm, for degrees of freedom (6,) of :func:`rigid` about a centre (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(q[:3]).as_matrix()
    matrix[:3, 3] = center + q[3:] - matrix[:3, :3] @ center
    return matrix


def closed_organ(surface: BSplineSurface, *, closure: str = "smooth") -> Parametrization:
    """All displacements of the control points with which a closed organ stays closed and smooth.

    Parameters
    ----------
    surface : BSplineSurface
        Closed surface with a seam in u and two poles in v, clamped knots in u.
    closure : {"smooth", "paper"}
        "smooth": the seam is as smooth as the spline itself (periodic in u, C2 for cubics), and each pole has a
        tangent plane: the ring of control points next to the pole is an affine image of the present ring,
        ``pole + alpha_i a + beta_i b``, so that three vectors move a pole and its ring. "paper": the seam points are
        the midpoints of their neighbours (C1), and a pole is translated together with its ring.

    Returns
    -------
    Parametrization

    Raises
    ------
    ValueError
        If the surface is not such a closed organ, has too few control points or the closure is unknown.

    Notes
    -----
    Paper: figures 2 and 3 of Jiang et al. (Strain 2019). Smooth: the C1 polar splines of Toshniwal, Speleers, Hiemstra
    and Hughes (Comput. Methods Appl. Mech. Engrg. 316, 2017), here with the ring's own shape as reference.
    """
    if closure not in CLOSURES:
        msg = f"The closure {closure!r} was asked for; choose one of {', '.join(CLOSURES)}."
        raise ValueError(msg)
    if not (surface.closed_u and all(surface.poles)):
        msg = "The surface has no seam in u or no two poles; a closed organ needs both."
        raise ValueError(msg)
    n_v = surface.control_net.shape[1]
    if n_v < 4:
        msg = f"{n_v} columns of control points were given; a closed organ needs at least 4 (two poles, two rings)."
        raise ValueError(msg)
    along_u = _seam_matrix(surface, closure)
    columns = [sparse.kron(along_u, _unit_column(n_v, j)) for j in range(2, n_v - 2)]
    for pole, ring in ((0, 1), (n_v - 1, n_v - 2)):
        columns.append(_pole_matrix(surface, closure, pole, ring))
    return _same_for_all_coordinates(surface, sparse.hstack(columns))


def _unit_column(n: int, index: int) -> sparse.csr_matrix:
    return sparse.csr_matrix(([1.0], ([index], [0])), shape=(n, 1))


def _seam_matrix(surface: BSplineSurface, closure: str) -> sparse.csr_matrix:
    """Map from the free control points around the tube to all n_u of them."""
    degree, n_u = surface.degrees[0], surface.control_net.shape[0]
    limits = surface.span_limits(0)
    if closure == "smooth":
        knots, matrix = bspline.periodic_to_clamped(degree, limits)
        if len(knots) != len(surface.knots_u) or np.abs(knots - surface.knots_u).max() > 1e-12:
            msg = "The knots in u are not clamped or not simple; the smooth closure needs clamped, simple knots."
            raise ValueError(msg)
        return matrix
    if n_u < 4:
        msg = f"{n_u} rows of control points were given; the closure of the paper needs at least 4."
        raise ValueError(msg)
    inner = sparse.identity(n_u - 2, format="csr")
    seam = sparse.csr_matrix(([0.5, 0.5], ([0, 0], [0, n_u - 3])), shape=(1, n_u - 2))
    return sparse.vstack([seam, inner, seam]).tocsr()


def _pole_matrix(surface: BSplineSurface, closure: str, pole: int, ring: int) -> sparse.csr_matrix:
    """Columns of the matrix that move one pole and its ring."""
    n_u, n_v, _ = surface.control_net.shape
    ones = np.ones((n_u, 1))
    shift = sparse.kron(ones, _unit_column(n_v, pole) + _unit_column(n_v, ring))
    if closure == "paper":
        return shift
    return sparse.hstack([shift, sparse.kron(_ring_shape(surface, pole, ring), _unit_column(n_v, ring))])


def _ring_shape(surface: BSplineSurface, pole: int, ring: int) -> np.ndarray:
    """Coordinates (alpha_i, beta_i) of a ring in the tangent plane of its pole, (n_u, 2), of unit size."""
    net = surface.control_net
    offsets = net[:, ring] - net[0, pole]
    left, singular, _ = np.linalg.svd(offsets, full_matrices=False)
    if singular[1] <= 1e-6 * singular[0] or singular[2] > 1e-6 * singular[0]:
        msg = (
            "The control points next to a pole do not lie in one plane through it; start from a generic model, "
            "or use the paper's closure."
        )
        raise ValueError(msg)
    shape = left[:, :2] * np.sqrt(len(offsets))
    # Bitwise equal, so that the seam stays closed exactly.
    shape[-1] = shape[0]
    return shape
