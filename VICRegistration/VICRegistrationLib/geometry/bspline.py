"""B-spline bases in one variable as sparse matrices: collocation, knot insertion, Gram matrices.

Notation follows Piegl & Tiller, *The NURBS Book* (1997): degree ``p``, knot vector ``t`` of length ``n + p + 1`` for
``n`` control points, domain ``[t[p], t[n]]``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import sparse

# Collocation matrices for at most so many parameters are cached: those of grids, which are the same for many surfaces.
_FEW = 512


def validated_knots(degree: int, knots: np.ndarray) -> np.ndarray:
    """Return the knot vector as a float array after checking it.

    Parameters
    ----------
    degree : int
        Polynomial degree, at least 1.
    knots : (n + degree + 1,) array_like
        Knot vector.

    Returns
    -------
    (n + degree + 1,) ndarray

    Raises
    ------
    ValueError
        If the degree is below 1, or the knots decrease, are too few, not finite or span no interval.
    """
    knots = np.array(knots, dtype=float)
    if int(degree) != degree or degree < 1:
        msg = f"Degree {degree} was given; a whole number of at least 1 is needed."
        raise ValueError(msg)
    if knots.ndim != 1 or len(knots) < 2 * degree + 2:
        msg = f"{knots.size} knots were given; degree {degree} needs at least {2 * degree + 2} in one row."
        raise ValueError(msg)
    if not np.isfinite(knots).all() or (np.diff(knots) < 0).any():
        msg = "The knots decrease somewhere or are not finite; give finite knots in ascending order."
        raise ValueError(msg)
    if knots[degree] >= knots[-degree - 1]:
        msg = f"The knots span no interval for degree {degree}; give at least two different inner knots."
        raise ValueError(msg)
    return knots


def uniform_clamped_knots(degree: int, n_control: int) -> np.ndarray:
    """Clamped knot vector over [0, 1] with equal spans.

    Parameters
    ----------
    degree : int
        Polynomial degree.
    n_control : int
        Number of control points, at least ``degree + 1``.

    Returns
    -------
    (n_control + degree + 1,) ndarray
    """
    inner = np.linspace(0.0, 1.0, n_control - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.ones(degree)])


def domain(degree: int, knots: np.ndarray) -> tuple[float, float]:
    """First and last parameter of a spline with these knots."""
    return float(knots[degree]), float(knots[-degree - 1])


def span_limits(degree: int, knots: np.ndarray) -> np.ndarray:
    """Distinct knots inside the domain: the ends of the non-empty spans, ascending."""
    return np.unique(knots[degree : len(knots) - degree])


def nonzero_basis(degree: int, knots: np.ndarray, x: np.ndarray, derivative: int = 0):
    """Values of the ``degree + 1`` basis functions that do not vanish at each parameter.

    Parameters
    ----------
    degree : int
        Polynomial degree.
    knots : (n + degree + 1,) ndarray
        Knot vector.
    x : (m,) array_like
        Parameters inside the domain.
    derivative : int
        Order of the derivative, 0 for the functions themselves.

    Returns
    -------
    first : (m,) ndarray of int
        Index of the first of these functions.
    values : (m, degree + 1) ndarray

    Raises
    ------
    ValueError
        If a parameter lies outside the domain.

    Notes
    -----
    Cox-de Boor recursion (The NURBS Book, eqs 2.5 and 2.7), vectorised over the parameters.
    """
    x = np.asarray(x, dtype=float)
    low, high = domain(degree, knots)
    if x.size and (x.min() < low or x.max() > high):
        msg = f"Parameters reach from {x.min():g} to {x.max():g}; the surface is defined on {low:g} to {high:g}."
        raise ValueError(msg)
    last = len(knots) - degree - 2
    span = np.clip(np.searchsorted(knots, x, side="right") - 1, degree, last)
    # The end of the domain belongs to the last span that is not empty.
    last_filled = np.searchsorted(knots, high, side="left") - 1
    span = np.minimum(span, last_filled)
    # One row for each function.
    values = np.ones((1, len(x)))
    for k in range(1, degree + 1):
        width = knots[k:] - knots[:-k]
        inverse = np.divide(1.0, width, out=np.zeros_like(width), where=width > 0)
        raised = np.zeros((k + 1, len(x)))
        for row in range(k):
            index = span - (k - 1 - row)
            ratio = values[row] * inverse[index]
            if k > degree - derivative:
                raised[row] -= k * ratio
                raised[row + 1] += k * ratio
            else:
                raised[row] += (knots[index + k] - x) * ratio
                raised[row + 1] += (x - knots[index]) * ratio
        values = raised
    if derivative > degree:
        values = np.zeros_like(values)
    return span - degree, np.ascontiguousarray(values.T)


def collocation(degree: int, knots: np.ndarray, x: np.ndarray, derivative: int = 0) -> sparse.csr_matrix:
    """Matrix of the basis functions (or a derivative) at the given parameters.

    Parameters
    ----------
    degree, knots, x, derivative
        As in :func:`nonzero_basis`.

    Returns
    -------
    (m, n) csr_matrix
        ``collocation(...) @ control_points`` are the points (or derivatives) of the curve.

    Raises
    ------
    ValueError
        If a parameter lies outside the domain.
    """
    knots, x = np.asarray(knots, dtype=float), np.asarray(x, dtype=float)
    if len(x) > _FEW:
        return _collocation(degree, knots, x, derivative)
    return _kept_collocation(degree, knots.tobytes(), x.tobytes(), derivative).copy()


@lru_cache(maxsize=128)
def _kept_collocation(degree: int, knots: bytes, x: bytes, derivative: int) -> sparse.csr_matrix:
    """Compute a collocation matrix; the last ones are cached."""
    return _collocation(degree, np.frombuffer(knots), np.frombuffer(x), derivative)


def _collocation(degree: int, knots: np.ndarray, x: np.ndarray, derivative: int) -> sparse.csr_matrix:
    first, values = nonzero_basis(degree, knots, x, derivative)
    columns = first[:, None] + np.arange(degree + 1)
    rows = np.arange(0, values.size + 1, degree + 1)
    shape = (len(values), len(knots) - degree - 1)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), rows), shape=shape)


def greville_abscissae(degree: int, knots: np.ndarray) -> np.ndarray:
    """Parameter that belongs to each control point: the mean of its ``degree`` inner knots."""
    windows = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree)
    return windows.mean(axis=1)


def knot_insertion(degree: int, knots: np.ndarray, new_knots: np.ndarray):
    """Exact insertion of knots.

    Parameters
    ----------
    degree : int
        Polynomial degree.
    knots : (n + degree + 1,) ndarray
        Knot vector.
    new_knots : (r,) array_like
        Knots to insert, repeated for higher multiplicity, inside the domain.

    Returns
    -------
    refined : (n + r + degree + 1,) ndarray
        The new knot vector.
    matrix : (n + r, n) csr_matrix
        New control points are ``matrix @ control_points``; the curve does not change.

    Raises
    ------
    ValueError
        If a knot lies outside the domain, or its multiplicity would exceed ``degree + 1``.

    Notes
    -----
    Boehm's algorithm (The NURBS Book, eq. 5.15), one knot after the other.
    """
    knots, new_knots = (np.atleast_1d(np.asarray(part, dtype=float)) for part in (knots, new_knots))
    refined, matrix = _kept_insertion(degree, knots.tobytes(), new_knots.tobytes())
    return refined.copy(), matrix.copy()


@lru_cache(maxsize=32)
def _kept_insertion(degree: int, knots: bytes, new_knots: bytes) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Insert knots; cached, because nets of one size are refined in the same way for every organ."""
    knots = np.frombuffer(knots)
    low, high = domain(degree, knots)
    matrix = sparse.identity(len(knots) - degree - 1, format="csr")
    for knot in np.frombuffer(new_knots):
        if not low <= knot <= high:
            msg = f"Knot {knot:g} lies outside the domain {low:g} to {high:g}; insert knots inside it."
            raise ValueError(msg)
        if np.count_nonzero(knots == knot) > degree:
            msg = f"Knot {knot:g} has multiplicity {degree + 1} already; it cannot be inserted once more."
            raise ValueError(msg)
        span = int(np.searchsorted(knots, knot, side="right")) - 1
        n = len(knots) - degree - 1
        i = np.arange(n + 1)
        begin, end = knots[i], knots[i + degree]
        width = np.where(end > begin, end - begin, 1.0)
        alpha = np.where(i <= span - degree, 1.0, np.where(i > span, 0.0, (knot - begin) / width))
        step = sparse.diags([alpha[:n], 1.0 - alpha[1:]], [0, -1], shape=(n + 1, n), format="csr")
        matrix = (step @ matrix).tocsr()
        knots = np.insert(knots, span + 1, knot)
    return knots, matrix


def periodic_to_clamped(degree: int, breaks: np.ndarray):
    """Clamped form of the periodic splines with the given knots.

    Parameters
    ----------
    degree : int
        Polynomial degree.
    breaks : (n_distinct + 1,) ndarray
        Knots of one period, simple and ascending; the last one is the first one of the next period.

    Returns
    -------
    knots : (n_distinct + 2 * degree + 1,) ndarray
        Clamped knot vector over the period.
    matrix : (n_distinct + degree, n_distinct) csr_matrix
        Maps the distinct control points of the periodic spline to those of the clamped one. Its first and its last
        row are bitwise equal, so that the seam is closed exactly.

    Raises
    ------
    ValueError
        If there are fewer than ``degree + 1`` spans.
    """
    n = len(breaks) - 1
    if n < degree + 1:
        msg = f"{n} spans were given; a closed spline of degree {degree} needs at least {degree + 1}."
        raise ValueError(msg)
    period = breaks[-1] - breaks[0]
    before = breaks[n - degree : n] - period
    after = breaks[1 : degree + 1] + period
    knots = np.concatenate([before, breaks, after])
    wrap = sparse.csr_matrix((np.ones(n + degree), (np.arange(n + degree), np.arange(n + degree) % n)))
    knots, insertion = knot_insertion(degree, knots, np.repeat([breaks[0], breaks[-1]], degree))
    inside = slice(degree, -degree)
    matrix = (insertion @ wrap).tocsr()[inside].tolil()
    # Both ends of the seam have the same row up to rounding; made equal, so that the seam is closed exactly.
    matrix[-1] = matrix[0]
    return knots[inside], matrix.tocsr()


def gauss_points(degree: int, knots: np.ndarray, n_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre points and weights on every non-empty span.

    Parameters
    ----------
    degree, knots
        The spline.
    n_points : int
        Points on each span; polynomials of degree ``2 * n_points - 1`` are integrated exactly.

    Returns
    -------
    x, weights : (n_spans * n_points,) ndarray
    """
    limits = span_limits(degree, knots)
    nodes, weights = np.polynomial.legendre.leggauss(n_points)
    half = np.diff(limits)[:, None] / 2.0
    center = (limits[1:, None] + limits[:-1, None]) / 2.0
    return (center + half * nodes).ravel(), (half * weights).ravel()


def gram(degree: int, knots: np.ndarray, derivative: int = 0) -> sparse.csr_matrix:
    """Exact integrals of the products of the basis functions' derivatives.

    Parameters
    ----------
    degree, knots
        The spline.
    derivative : int
        Order of the derivative of both factors.

    Returns
    -------
    (n, n) csr_matrix
    """
    x, weights = gauss_points(degree, knots, degree + 1)
    basis = collocation(degree, knots, x, derivative)
    return (basis.T @ sparse.diags(weights) @ basis).tocsr()
