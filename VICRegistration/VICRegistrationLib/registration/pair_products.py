"""Sums over the samples of products of two basis functions: what quadratic forms of a displacement are made of.

Few basis functions meet at a sample, so that few of their products are not zero. These are worked out once for all
weights that the samples will ever have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True, eq=False)
class PairProducts:
    """Products of pairs of functions that meet at a sample.

    Parameters
    ----------
    n : int
        Number of functions.
    rows, columns : (n_pairs,) ndarray of int
        Which two functions; rows <= columns, each pair once.
    products : (n_pairs, n_samples) csr_matrix
        Of the two at each sample.
    """

    n: int
    rows: np.ndarray
    columns: np.ndarray
    products: sparse.csr_matrix

    @classmethod
    def of(cls, functions: sparse.csr_matrix) -> PairProducts:
        """Multiply all functions that meet.

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
        # Samples with equally many functions are done at once.
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
            Whether arrays are wanted, or sparse matrices.

        Returns
        -------
        list of m (n, n) ndarray or csc_matrix
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
        return [sparse.csc_matrix((np.append(s, s[below]), place), shape=(self.n, self.n)) for s in sums.T]
