"""Cutting an organ into patches: exact pieces of its closed surface, by knot insertion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..export.step_shapes import clamped_piece, missing_knots
from ..geometry import bspline
from ..geometry.surface import BSplineSurface

# Parameters closer than this share of the period are one knot.
_SAME_KNOT = 1e-12
# A seam is smooth if the periodic form reproduces the control points within this share of the surface's size.
_SMOOTH_SEAM = 1e-9


@dataclass(frozen=True, eq=False)
class OrganCuts:
    """Cuts of a closed surface into columns around its tube and rows from pole to pole.

    Parameters
    ----------
    u : (n_columns,) array_like
        Parameters of the cuts around the tube, ascending, within one period. Column i reaches from ``u[i]`` to
        ``u[i + 1]``, the last one to the next period's ``u[0]``: it may lie across the seam.
    v : (n_rows + 1,) array_like
        Parameters of the cuts from pole to pole, ascending, both poles included.
    names : n_columns sequences of n_rows str
        Names of the patches.

    Raises
    ------
    ValueError
        If the cuts do not ascend, or names are missing.
    """

    u: np.ndarray
    v: np.ndarray
    names: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        """Make the arrays read-only and check them against the names."""
        names = tuple(tuple(column) for column in self.names)
        for key in ("u", "v"):
            cuts = np.array(getattr(self, key), dtype=float)
            cuts.flags.writeable = False
            object.__setattr__(self, key, cuts)
            if cuts.ndim != 1 or len(cuts) < 2 or not np.isfinite(cuts).all() or (np.diff(cuts) <= 0).any():
                msg = f"The cuts in {key} are {cuts.tolist()}; at least two ascending parameters are needed."
                raise ValueError(msg)
        object.__setattr__(self, "names", names)
        if len(names) != len(self.u) or any(len(column) != len(self.v) - 1 for column in names):
            found = " and ".join(sorted({str(len(column)) for column in names}))
            msg = (
                f"{len(names)} columns with {found} names were given; the cuts make {len(self.u)} columns of "
                f"{len(self.v) - 1} patches, and every patch needs a name."
            )
            raise ValueError(msg)

    def pieces(self, parent: BSplineSurface) -> Pieces:
        """Cut a closed surface.

        Parameters
        ----------
        parent : BSplineSurface
            Closed by a seam in u and two poles, RAS mm.

        Returns
        -------
        Pieces

        Raises
        ------
        ValueError
            If the surface is not closed like that, the cuts in v do not reach from pole to pole, those in u span more
            than one period, or a column lies across a seam that is not smooth.
        """
        if not (parent.closed_u and all(parent.poles)):
            msg = "The surface is open or a ring; an organ needs a seam in u and a pole at each end of v."
            raise ValueError(msg)
        low, high = parent.domain[1]
        if abs(self.v[0] - low) > _SAME_KNOT or abs(self.v[-1] - high) > _SAME_KNOT:
            msg = f"The cuts in v reach from {self.v[0]:g} to {self.v[-1]:g}; they must reach from {low:g} to {high:g}."
            raise ValueError(msg)
        knots_u, around = self._around(parent)
        new = _missing(parent.degrees[1], parent.knots_v, self.v)
        knots_v, along = bspline.knot_insertion(parent.degrees[1], parent.knots_v, new)
        return Pieces(parent.degrees, knots_u, knots_v, self, _grid_matrix(around, along))

    def _around(self, parent: BSplineSurface) -> tuple[np.ndarray, sparse.csr_matrix]:
        """Knots of one period from the first cut on, and the matrix to its distinct rows of control points."""
        degree, (low, high) = parent.degrees[0], parent.domain[0]
        period = high - low
        if self.u[0] < low - _SAME_KNOT or self.u[0] >= high or self.u[-1] >= self.u[0] + period:
            msg = (
                f"The cuts in u reach from {self.u[0]:g} to {self.u[-1]:g}; the first one must lie in {low:g} to "
                f"{high:g}, and the last one before the first one's next turn."
            )
            raise ValueError(msg)
        if abs(self.u[0] - low) <= _SAME_KNOT * period:
            inner = _missing(degree, parent.knots_u, self.u[1:])
            knots, matrix = bspline.knot_insertion(degree, parent.knots_u, inner)
            return knots, matrix[:-1]
        return self._across_the_seam(parent, period)

    def _across_the_seam(self, parent: BSplineSurface, period: float) -> tuple[np.ndarray, sparse.csr_matrix]:
        """As `_around`, if the first cut is not at the seam: from three periods without the seam's multiple knots."""
        degree = parent.degrees[0]
        breaks = parent.span_limits(0)
        n = len(breaks) - 1
        distinct = _periodic_matrix(parent, breaks)
        turns = np.concatenate([breaks[:-1] - period, breaks[:-1], breaks + period, breaks[1:] + 2.0 * period])
        rows = np.arange(len(turns) - degree - 1)
        wrap = sparse.csr_matrix((np.ones(len(rows)), (rows, (rows + degree) % n)))
        ends = np.append(self.u, self.u[0] + period)
        knots, insertion = bspline.knot_insertion(degree, turns, _missing(degree, turns, ends))
        first = int(np.searchsorted(knots, _snapped(ends[:1], knots)[0], side="right")) - 1
        last = int(np.searchsorted(knots, _snapped(ends[-1:], knots)[0], side="left"))
        clamped = np.concatenate([[knots[first]], knots[first - degree + 1 : last + degree], [knots[last]]])
        return clamped, (insertion @ wrap @ distinct).tocsr()[first - degree : last - 1]


@dataclass(frozen=True, eq=False)
class Pieces:
    """The distinct control points of all patches of a closed surface, as a linear map of its control net.

    Parameters
    ----------
    degrees : (p, q)
    knots_u, knots_v : ndarray
        Knots of the whole surface after the cuts were inserted, each with the degree as its multiplicity.
    cuts : OrganCuts
    matrix : (n_points, n_u * n_v) csr_matrix
        ``matrix @ parent.control_net.reshape(-1, 3)`` are the points: the pole at v_min, then those between the poles
        (u-major), then the pole at v_max.
    """

    degrees: tuple[int, int]
    knots_u: np.ndarray
    knots_v: np.ndarray
    cuts: OrganCuts
    matrix: sparse.csr_matrix

    def patches(self) -> list[tuple[str, tuple[np.ndarray, np.ndarray], np.ndarray]]:
        """Name, knots (u, v) and point indices (n_u, n_v) of every patch, column by column."""
        n_v = len(self.knots_v) - self.degrees[1] - 1
        n_u = (self.matrix.shape[0] - 2) // (n_v - 2)
        grid = np.empty((n_u, n_v), dtype=int)
        grid[:, 0], grid[:, -1] = 0, self.matrix.shape[0] - 1
        grid[:, 1:-1] = 1 + np.arange(n_u * (n_v - 2)).reshape(n_u, n_v - 2)
        grid = np.concatenate([grid, grid[:1]])
        period = self.knots_u[-1] - self.knots_u[0]
        columns = _intervals(self.degrees[0], self.knots_u, np.append(self.cuts.u, self.cuts.u[0] + period))
        rows = _intervals(self.degrees[1], self.knots_v, self.cuts.v)
        return [
            (name, (knots_u, knots_v), grid[column, row])
            for (knots_u, column), names in zip(columns, self.cuts.names)
            for (knots_v, row), name in zip(rows, names)
        ]


def _grid_matrix(around: sparse.csr_matrix, along: sparse.csr_matrix) -> sparse.csr_matrix:
    """Matrix from the control net to the points, in which each pole is one point."""
    n_u, n_v = around.shape[0], along.shape[0]
    whole = sparse.kron(around, along, format="csr")
    inner = (np.arange(n_u)[:, None] * n_v + np.arange(1, n_v - 1)).ravel()
    # All control points of a pole coincide; the first one is taken.
    columns = [0, along.shape[1] - 1]
    poles = sparse.csr_matrix(([1.0, 1.0], ([0, 1], columns)), shape=(2, whole.shape[1]))
    return sparse.vstack([poles[0], whole[inner], poles[1]], format="csr")


def _periodic_matrix(parent: BSplineSurface, breaks: np.ndarray) -> sparse.csr_matrix:
    """Matrix from the rows of a control net with a smooth seam to the distinct ones of its periodic form."""
    knots, matrix = bspline.periodic_to_clamped(parent.degrees[0], breaks)
    net = parent.control_net.reshape(len(parent.control_net), -1)
    smooth = len(knots) == len(parent.knots_u) and np.abs(knots - parent.knots_u).max() <= _SAME_KNOT
    if smooth:
        # The other rows repeat these by the period.
        inverse = np.linalg.inv(matrix[: matrix.shape[1]].toarray())
        inverse[np.abs(inverse) < _SAME_KNOT] = 0.0
        inverse = np.hstack([inverse, np.zeros((len(inverse), matrix.shape[0] - len(inverse)))])
        smooth = np.abs(matrix @ (inverse @ net) - net).max() <= _SMOOTH_SEAM * parent.size
    if not smooth:
        msg = "The seam of the surface is not as smooth as its other knots; put the first cut in u at the seam."
        raise ValueError(msg)
    return sparse.csr_matrix(inverse)


def _snapped(cuts: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Move cuts to knots that differ from them by rounding only."""
    nearest = knots[np.abs(cuts[:, None] - knots).argmin(axis=1)]
    return np.where(np.abs(cuts - nearest) <= _SAME_KNOT * (knots[-1] - knots[0]), nearest, cuts)


def _missing(degree: int, knots: np.ndarray, cuts: np.ndarray) -> np.ndarray:
    """Knots to insert so that the multiplicity of each cut is the degree."""
    return missing_knots(degree, knots, _snapped(cuts, knots))


def _intervals(degree: int, knots: np.ndarray, cuts: np.ndarray):
    """Clamped knots and range of control points between each cut and the next, after the cuts were inserted."""
    cuts = _snapped(cuts, knots)
    return [clamped_piece(degree, knots, low, high) for low, high in zip(cuts[:-1], cuts[1:])]
