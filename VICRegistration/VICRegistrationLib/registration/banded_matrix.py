"""Sparse symmetric positive definite matrices as banded matrices, in reverse Cuthill-McKee order.

A control point is coupled only with its neighbours. In this order the Gauss-Newton matrix of a net has a narrow band,
in spite of the seam and the poles, and a band is factorised several times faster than a general sparse matrix.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import csgraph


class BandedMatrix:
    """A symmetric positive definite matrix.

    Parameters
    ----------
    matrix : (n, n) ndarray or sparse matrix
    """

    def __init__(self, matrix):
        entries = sparse.csr_matrix(matrix)
        self.diagonal = entries.diagonal()
        self._order = csgraph.reverse_cuthill_mckee(entries, symmetric_mode=True)
        self._place = np.empty_like(self._order)
        self._place[self._order] = np.arange(len(self._order))
        entries = entries.tocoo()
        self._rows, self._columns, self._values = self._place[entries.row], self._place[entries.col], entries.data
        below = self._rows >= self._columns
        offsets, columns = self._rows[below] - self._columns[below], self._columns[below]
        self.bandwidth = int(offsets.max(initial=0))
        self._band = np.zeros((self.bandwidth + 1, len(self._order)))
        self._band[offsets, columns] = self._values[below]

    def solve(self, right: np.ndarray, *, lift: np.ndarray | None = None) -> np.ndarray:
        """Solve (A + diag(lift)) x = right.

        Parameters
        ----------
        right : (n,) ndarray
        lift : (n,) ndarray, optional

        Returns
        -------
        (n,) ndarray

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        band = self._band
        if lift is not None:
            band = band.copy()
            band[0] += lift[self._order]
        return linalg.solveh_banded(band, right[self._order], lower=True, check_finite=False)[self._place]

    def variances(self, vectors) -> np.ndarray:
        """Compute v' A^-1 v for sparse vectors v.

        Parameters
        ----------
        vectors : (m, n) ndarray or sparse matrix
            Every two non-zero entries of a row must be coupled by a non-zero entry of A, like basis functions at a
            sample.

        Returns
        -------
        (m,) ndarray

        Notes
        -----
        With blocks as wide as the band the matrix is block tridiagonal, and the needed blocks of its inverse are
        computed one after the other, without the remaining ones (Takahashi, Fagan and Chin, 1973).
        """
        vectors = sparse.csc_matrix(vectors)[:, self._order]
        blocks = self._blocks()
        columns = [vectors[:, block].tocsr() for block in blocks]
        inverses, gains = [np.linalg.inv(self._dense(blocks[0], blocks[0]))], []
        for block, below in zip(blocks, blocks[1:]):
            coupling = self._dense(block, below)
            gains.append(inverses[-1] @ coupling)
            inverses.append(np.linalg.inv(self._dense(below, below) - coupling.T @ gains[-1]))
        result = np.zeros(vectors.shape[0])
        inverse = inverses[-1]
        _add_forms(result, columns[-1], inverse, columns[-1])
        for k in reversed(range(len(gains))):
            across = -gains[k] @ inverse
            _add_forms(result, columns[k], 2.0 * across, columns[k + 1])
            inverse = inverses[k] - across @ gains[k].T
            _add_forms(result, columns[k], inverse, columns[k])
        return result

    def _blocks(self) -> list[slice]:
        """Divide the rows into blocks as long as the band is wide."""
        n, size = len(self._order), max(self.bandwidth, 1)
        return [slice(start, min(start + size, n)) for start in range(0, n, size)]

    def _dense(self, rows: slice, columns: slice) -> np.ndarray:
        """Part of the matrix, in the order of the band."""
        part = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
        within = (self._rows >= rows.start) & (self._rows < rows.stop)
        within &= (self._columns >= columns.start) & (self._columns < columns.stop)
        part[self._rows[within] - rows.start, self._columns[within] - columns.start] = self._values[within]
        return part


def _add_forms(result: np.ndarray, left: sparse.csr_matrix, matrix: np.ndarray, right: sparse.csr_matrix) -> None:
    """Add left_i M right_i for each row i of two sparse matrices."""
    there = np.flatnonzero((np.diff(left.indptr) > 0) & (np.diff(right.indptr) > 0))
    if len(there):
        result[there] += np.asarray(right[there].multiply(left[there] @ matrix).sum(axis=1)).ravel()
