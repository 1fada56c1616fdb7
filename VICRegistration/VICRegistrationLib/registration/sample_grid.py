"""Parameters at which a surface is compared with an image, and its basis functions there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from ..geometry import bspline
from ..geometry.surface import BSplineSurface
from .pair_products import PairProducts

# Matrices whose products with the bases are kept: those of one global and one local parametrization, and some to spare.
_KEPT_MOTIONS = 8


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """Parameters at which a surface is compared with the image, and the basis functions there.

    Parameters
    ----------
    shape : (n_u, n_v)
        Number of parameters in each direction.
    bases : six (n_u * n_v, n_control) csr_matrix
        Basis functions at the samples (u-major) and their derivatives: S, S_u, S_v, S_uu, S_uv, S_vv.
    """

    shape: tuple[int, int]
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
            Equal intervals: the samples are their midpoints, so that poles and seam are not hit.
        between : bool
            Take the ends of the intervals instead, but for the poles: n_u x (n_v - 1) samples as far from the others
            as can be.

        Returns
        -------
        SampleGrid
        """
        one_way = []
        shares = [(np.arange(n) + 0.5) / n for n in shape]
        if between:
            shares = [np.arange(shape[0]) / shape[0], np.arange(1, shape[1]) / shape[1]]
        for degree, knots, share in zip(surface.degrees, (surface.knots_u, surface.knots_v), shares):
            low, high = bspline.domain(degree, knots)
            x = low + (high - low) * share
            one_way.append([bspline.collocation(degree, knots, x, derivative) for derivative in (0, 1, 2)])
        along_u, along_v = one_way
        orders = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        return cls(
            tuple(map(len, shares)), tuple(sparse.kron(along_u[du], along_v[dv], format="csr") for du, dv in orders)
        )

    def motion(self, matrix: sparse.csr_matrix, *, dense: bool):
        """Displacement of S, S_u and S_v at the samples by a coordinate's degrees of freedom, three (n, n_k) matrices.

        Kept, because the stages of a registration and the coordinates share their matrices.
        """

        def moved():
            products = [basis @ matrix for basis in self.bases[:3]]
            return tuple(p.toarray() if dense else p.tocsr() for p in products)

        return _kept(self._motions, matrix, moved)

    def products(self, matrix: sparse.csr_matrix) -> PairProducts:
        """Products of the motions of S by every two of a coordinate's degrees of freedom; kept as well."""
        return _kept(self._products, matrix, lambda: PairProducts.of(self.bases[0] @ matrix))


def _kept(made: dict, matrix: sparse.csr_matrix, make: Callable[[], object]):
    """Take what was made for a matrix, or make it; the last ones are kept."""
    if id(matrix) not in made:
        # The matrix is kept too, so that its id stays its own.
        made[id(matrix)] = matrix, make()
        while len(made) > _KEPT_MOTIONS:
            del made[next(iter(made))]
    return made[id(matrix)][1]
