"""Samples of a surface: their parameters, and sums of products of functions that meet at samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import affine
from VICRegistrationLib.registration.sample_grid import PairProducts, SampledSurface, SampleGrid


@pytest.mark.parametrize("between", [False, True])
def test_bases_are_those_at_the_parameters(between):
    organ = models.closed_organ((9, 7), axes=np.diag([10.0, 8.0, 15.0]))
    grid = SampleGrid.on(organ, (24, 12), between=between)
    points = grid.bases[0] @ organ.control_net.reshape(-1, 3)
    np.testing.assert_allclose(points, organ.grid(*grid.axes).reshape(-1, 3), atol=1e-12)
    np.testing.assert_allclose(SampledSurface(affine(organ), grid).frame(np.zeros(12)).points, points, atol=1e-12)


@pytest.fixture
def functions():
    """Ten functions at 40 samples; one sample at which none of them is there, and a zero that is stored."""
    values = np.where(np.random.default_rng(0).random((40, 10)) < 0.3, np.arange(400).reshape(40, 10) + 1.0, 0.0)
    values[7] = 0.0
    matrix = sparse.csr_matrix(values)
    matrix.data[5] = 0.0
    return matrix


@pytest.mark.parametrize("dense", [True, False])
def test_forms_are_those_of_the_full_matrices(functions, dense):
    weights = np.random.default_rng(1).normal(size=(40, 3))
    forms = PairProducts.of(functions).forms(weights, dense=dense)
    full = functions.toarray()
    for form, weight in zip(forms, weights.T):
        assert sparse.issparse(form) != dense
        expected = full.T @ (weight[:, None] * full)
        np.testing.assert_allclose(form if dense else form.toarray(), expected, atol=1e-9 * np.abs(expected).max())


def test_a_pair_is_kept_once_and_only_where_both_are_there(functions):
    found = PairProducts.of(functions)
    assert (found.rows <= found.columns).all()
    meeting = (functions.toarray() != 0.0).astype(int)
    together = np.triu(meeting.T @ meeting)
    assert len(found.rows) == np.count_nonzero(together)
    np.testing.assert_array_equal(np.diff(found.products.indptr), together[found.rows, found.columns])
