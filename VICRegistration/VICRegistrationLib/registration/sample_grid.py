"""Samples of a surface: parameters, basis functions, points, normals, and their derivatives by degrees of freedom.

Samples lie along normal lines of the surface, x = S(u, v) + d n(u, v). This file has the part that is independent of
the images; all images that are compared with one surface share it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage, sparse

from ..geometry.parametrization import Parametrization
from ..geometry.surface import BSplineSurface

# Number of matrices whose products with the bases are cached: three each for a few parametrizations.
_CACHED_MATRICES = 8
# Share of non-zero entries from which on a matrix counts as full. Deformations of space move all points, control points
# only a few.
_FULL = 0.5
# Below this number of control points dense matrices are faster than sparse ones.
_DENSE_LIMIT = 400


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """Parameters at which a surface is compared with the image, and the basis functions there.

    Parameters
    ----------
    shape : (n_u, n_v)
        Number of parameters in each direction.
    axes : (n_u,) and (n_v,) ndarray
        The parameters: all pairs of them.
    bases : three (n_u * n_v, n_control) csr_matrix
        Basis functions at the samples (u-major) and their derivatives: S, S_u, S_v.
    """

    shape: tuple[int, int]
    axes: tuple[np.ndarray, np.ndarray]
    bases: tuple[sparse.csr_matrix, ...]
    _motions: dict = field(default_factory=dict, repr=False)
    _products: dict = field(default_factory=dict, repr=False)

    @classmethod
    def on(cls, surface: BSplineSurface, shape: tuple[int, int], *, between: bool = False) -> SampleGrid:
        """Grid for surfaces with the same degrees and knots as this one.

        Parameters
        ----------
        surface : BSplineSurface
        shape : (n_u, n_v)
            Number of equal intervals. The samples are their midpoints, so that none lies on a pole or on the seam.
        between : bool
            Take the ends of the intervals instead, without the poles: n_u x (n_v - 1) samples half-way between those
            midpoints.

        Returns
        -------
        SampleGrid
        """
        axes = surface.midpoint_axes(*shape)
        if between:
            shares = np.arange(shape[0]) / shape[0], np.arange(1, shape[1]) / shape[1]
            axes = tuple(low + (high - low) * share for (low, high), share in zip(surface.domain, shares))
        bases = tuple(surface.grid_basis(*axes, du=du, dv=dv) for du, dv in ((0, 0), (1, 0), (0, 1)))
        return cls(tuple(map(len, axes)), axes, bases)

    def motion(self, matrix: sparse.csr_matrix, *, dense: bool):
        """Displacement of S, S_u and S_v at the samples by a coordinate's degrees of freedom, three (n, n_k) matrices.

        Cached, because the stages of a registration and the coordinates share their matrices.
        """

        def multiply():
            products = [basis @ matrix for basis in self.bases]
            return tuple(p.toarray() if dense else p.tocsr() for p in products)

        return _cached(self._motions, matrix, multiply)

    def products(self, matrix: sparse.csr_matrix) -> PairProducts:
        """Products of the displacements of S by every two of a coordinate's degrees of freedom; cached as well."""
        return _cached(self._products, matrix, lambda: PairProducts.of(self.bases[0] @ matrix))


def _cached(cache: dict, matrix: sparse.csr_matrix, make: Callable[[], object]):
    """Return the cached result for a matrix, or make it; the oldest entry is dropped."""
    if id(matrix) not in cache:
        # The matrix is stored too, so that its id is not used again.
        cache[id(matrix)] = matrix, make()
        while len(cache) > _CACHED_MATRICES:
            del cache[next(iter(cache))]
    return cache[id(matrix)][1]


@dataclass(frozen=True, eq=False)
class PairProducts:
    """Products of every two functions that are both non-zero at a sample; quadratic forms are weighted sums of them.

    Few basis functions are non-zero at a sample, and so are few of their products. They are computed once, and used
    with the weights of every iteration.

    Parameters
    ----------
    n : int
        Number of functions.
    rows, columns : (n_pairs,) ndarray of int
        Indices of the two functions; rows <= columns, each pair once.
    products : (n_pairs, n_samples) csr_matrix
        Product of the two at each sample.
    """

    n: int
    rows: np.ndarray
    columns: np.ndarray
    products: sparse.csr_matrix

    @classmethod
    def of(cls, functions: sparse.csr_matrix) -> PairProducts:
        """Compute the products.

        Parameters
        ----------
        functions : (n_samples, n) sparse matrix
            Values of n functions at the samples.

        Returns
        -------
        PairProducts
        """
        functions = sparse.csr_matrix(functions, copy=True)
        functions.eliminate_zeros()
        functions.sort_indices()
        n_samples, n = functions.shape
        count = np.diff(functions.indptr)
        pairs, samples, values = [], [], []
        # All samples with the same number of non-zero functions at once.
        for number in np.unique(count):
            here = np.flatnonzero(count == number)
            first, second = (functions.indptr[here][:, None] + part for part in np.triu_indices(number))
            pairs.append((functions.indices[first] * np.int64(n) + functions.indices[second]).ravel())
            samples.append(np.repeat(here.astype(np.int32), first.shape[1]))
            values.append((functions.data[first] * functions.data[second]).ravel())
        place = np.concatenate(pairs), np.concatenate(samples)
        products = sparse.csr_matrix((np.concatenate(values), place), shape=(n * n, n_samples))
        there = np.flatnonzero(np.diff(products.indptr))
        ends = np.append(products.indptr[there], products.nnz)
        shape = (len(there), n_samples)
        return cls(n, *np.divmod(there, n), sparse.csr_matrix((products.data, products.indices, ends), shape=shape))

    def forms(self, weights: np.ndarray, *, dense: bool) -> list:
        """Sum up the products, weighted.

        Parameters
        ----------
        weights : (n_samples, m) ndarray
        dense : bool
            Whether to return arrays in place of sparse matrices.

        Returns
        -------
        list of m (n, n) ndarray or coo_matrix
            F' diag(w) F for the functions F and each column w of the weights.
        """
        sums = self.products @ weights
        if dense:
            forms = np.zeros((sums.shape[1], self.n, self.n))
            forms[:, self.rows, self.columns] = sums.T
            forms[:, self.columns, self.rows] = sums.T
            return list(forms)
        below = self.rows < self.columns
        place = np.append(self.rows, self.columns[below]), np.append(self.columns, self.rows[below])
        return [sparse.coo_matrix((np.append(s, s[below]), place), shape=(self.n, self.n)) for s in sums.T]


@dataclass(frozen=True, eq=False)
class Frame:
    """Position of the surface at n samples.

    Parameters
    ----------
    points : (n, 3) ndarray
    tangents : two (n, 3) ndarray
        S_u and S_v.
    cross : (n, 3) ndarray
        S_u x S_v.
    length : (n,) ndarray
        Its length.
    normals : (n, 3) ndarray
        Unit normals.
    """

    points: np.ndarray
    tangents: tuple[np.ndarray, np.ndarray]
    cross: np.ndarray
    length: np.ndarray
    normals: np.ndarray

    @property
    def area(self) -> np.ndarray:
        """Share of the surface's area that belongs to each sample, (n,), sum 1."""
        return self.length / self.length.sum()

    def along_normals(self, offsets: np.ndarray) -> np.ndarray:
        """Points (n, m, 3) at distances (n, m) or (m,) along the normals."""
        # numpy is faster if each coordinate is contiguous in memory.
        return np.moveaxis(self.points.T[:, :, None] + offsets * self.normals.T[:, :, None], 0, -1)

    def normal_terms(self, lever: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vectors t_u, t_v (n, 3) with lever . dn = t_u . dS_u + t_v . dS_v."""
        along = np.einsum("nk,nk->n", lever, self.normals)
        tangential = (lever - along[:, None] * self.normals) / np.maximum(self.length, 1e-300)[:, None]
        along_u, along_v = self.tangents
        return cross(along_v, tangential), cross(tangential, along_u)


class SampledSurface:
    """A surface with degrees of freedom, at the samples of a grid.

    Parameters
    ----------
    parametrization : Parametrization
        How the surface deforms.
    grid : SampleGrid
        Made for surfaces with its knots.
    use_sparse : bool, optional
        Whether to use sparse matrices; if not given, only for large control nets.

    Attributes
    ----------
    parametrization : Parametrization
    grid : SampleGrid
    sparse : bool
    """

    def __init__(self, parametrization: Parametrization, grid: SampleGrid, *, use_sparse: bool | None = None):
        self.parametrization = parametrization
        self.grid = grid
        flat = parametrization.surface.control_net.reshape(-1, 3)
        self.sparse = len(flat) > _DENSE_LIMIT if use_sparse is None else use_sparse
        self._start = tuple(basis @ flat for basis in grid.bases)
        motions = [grid.motion(matrix, dense=not self.sparse) for matrix in parametrization.matrices]
        self._motion = tuple(zip(*motions))
        # Coordinates with the same matrix are computed together.
        self._same_matrix = all(motion is motions[0] for motion in motions)
        first = parametrization.matrices[0]
        # With full matrices, sparse products of pairs save nothing over a matrix product.
        self._full = first.nnz > _FULL * np.prod(first.shape)
        self._last = None

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return self.parametrization.n_dof

    def at(self, surface: BSplineSurface) -> SampledSurface:
        """Copy with another surface at q = 0, which the degrees of freedom can reach."""
        return SampledSurface(self.parametrization.at(surface), self.grid, use_sparse=self.sparse)

    def frame(self, q: np.ndarray) -> Frame:
        """Points, tangents and normals at the samples for degrees of freedom (n_dof,)."""
        if self._last is not None and np.array_equal(q, self._last[0]):
            return self._last[1]
        indices = self.parametrization.indices
        parts = []
        for start, motion in zip(self._start, self._motion):
            if self._same_matrix:
                moved = motion[0] @ np.stack([q[index] for index in indices], axis=1)
            else:
                moved = np.stack([matrix @ q[index] for matrix, index in zip(motion, indices)], axis=1)
            parts.append(start + moved)
        points, along_u, along_v = parts
        product = cross(along_u, along_v)
        length = np.sqrt(np.einsum("nk,nk->n", product, product))
        normals = product / np.maximum(length, 1e-12 * length.max())[:, None]
        frame = Frame(points, (along_u, along_v), product, length, normals)
        # An iteration starts where the last one ended.
        self._last = q.copy(), frame
        return frame

    def gradient(self, frame: Frame, direct: np.ndarray, lever: np.ndarray) -> np.ndarray:
        """Sum over the samples of direct . dS + lever . dn, by the degrees of freedom, (n_dof,).

        Parameters
        ----------
        frame : Frame
            The surface.
        direct, lever : (n, 3) ndarray
        """
        result = np.zeros(self.n_dof)
        for motion, part in zip(self._motion, (direct, *frame.normal_terms(lever))):
            for k, index in enumerate(self.parametrization.indices):
                result[index] += motion[k].T @ part[:, k]
        return result

    def normal_motion(self, normals: np.ndarray):
        """Displacement of the samples along normals (n, 3) by each degree of freedom, (n, n_dof) array or matrix."""
        parts = [sparse.diags(normals[:, k]) @ motion for k, motion in enumerate(self._motion[0])]
        if self.sparse and self._same_matrix:
            return sparse.hstack(parts, format="csr")
        result = np.zeros((len(normals), self.n_dof))
        for part, index in zip(parts, self.parametrization.indices):
            result[:, index] += part.toarray() if self.sparse else part
        return result

    def quadratic_form(self, outer: np.ndarray):
        """Sum over the samples of dS' M dS for symmetric matrices M (n, 3, 3), as a matrix (n_dof, n_dof)."""
        pairs = [(a, b) for a in range(3) for b in range(a, 3)]
        weights = np.stack([outer[:, a, b] for a, b in pairs], axis=1)
        motion, indices = self._motion[0], self.parametrization.indices
        if self._same_matrix and not self._full:
            blocks = self.grid.products(self.parametrization.matrices[0]).forms(weights, dense=not self.sparse)
        elif self.sparse:
            blocks = [(motion[a].T @ sparse.diags(w) @ motion[b]).tocoo() for (a, b), w in zip(pairs, weights.T)]
        else:
            blocks = [motion[a].T @ (w[:, None] * motion[b]) for (a, b), w in zip(pairs, weights.T)]
        whole = [(indices[a], indices[b], block) for (a, b), block in zip(pairs, blocks)]
        whole += [(indices[b], indices[a], block.T) for (a, b), block in zip(pairs, blocks) if a != b]
        shape = (self.n_dof, self.n_dof)
        if self.sparse:
            rows = np.concatenate([rows[block.row] for rows, _, block in whole])
            columns = np.concatenate([columns[block.col] for _, columns, block in whole])
            return sparse.csc_matrix((np.concatenate([block.data for *_, block in whole]), (rows, columns)), shape)
        total = np.zeros(shape)
        for rows, columns, block in whole:
            total[np.ix_(rows, columns)] += block
        return total


def mean_over_neighbours(
    values: np.ndarray, weights: np.ndarray, shape: tuple[int, int], sigma: Sequence[float], *, least: float = 0.0
) -> np.ndarray:
    """Gaussian-weighted mean over the neighbourhood of each normal line.

    Parameters
    ----------
    values, weights : (n_u * n_v,) ndarray
    shape : (n_u, n_v)
        The lines as a grid, periodic in u.
    sigma : (float, float)
        Standard deviations of the Gaussian, in lines.
    least : float
        Lower limit of the sum of weights.

    Returns
    -------
    (n_u * n_v,) ndarray
    """
    above, below = (
        ndimage.gaussian_filter(part.reshape(shape), sigma, mode=("wrap", "nearest")).ravel()
        for part in (weights * values, weights)
    )
    return above / np.maximum(below, least)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of (n, 3) arrays; numpy's own is several times slower."""
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )
