"""Thin-plate (bending) energy of a B-spline surface."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import sparse

from . import bspline
from .surface import BSplineSurface


def bending_matrix(surface: BSplineSurface):
    """Thin-plate energy of the control net as a quadratic form.

    Parameters
    ----------
    surface : BSplineSurface
        Only its degrees and knots count.

    Returns
    -------
    (n_u * n_v, n_u * n_v) csr_matrix
        K with sum over R, A, S of p' K p = int |S_uu|^2 + 2 |S_uv|^2 + |S_vv|^2 du dv, in mm^2, exact.
    """
    return _bending_matrix(surface.degrees, surface.knots_u.tobytes(), surface.knots_v.tobytes())


@lru_cache(maxsize=8)
def _bending_matrix(degrees: tuple[int, int], knots_u: bytes, knots_v: bytes):
    knots = np.frombuffer(knots_u), np.frombuffer(knots_v)
    gram_u = [bspline.gram(degrees[0], knots[0], k) for k in range(3)]
    gram_v = [bspline.gram(degrees[1], knots[1], k) for k in range(3)]
    terms = [sparse.kron(gram_u[2], gram_v[0]), 2.0 * sparse.kron(gram_u[1], gram_v[1])]
    return (terms[0] + terms[1] + sparse.kron(gram_u[0], gram_v[2])).tocsr()
