"""Samples of a surface: its curvature there, and sums of products of functions that meet at samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import affine
from VICRegistrationLib.registration.sample_grid import PairProducts, SampledSurface, SampleGrid


def test_a_curvature_is_that_of_a_ball():
    radius = 20.0
    ball = models.closed_organ((33, 33), axes=radius * np.eye(3))
    surface = SampledSurface(affine(ball), SampleGrid.on(ball, (24, 20)))
    normals = surface.frame(np.zeros(12)).normals
    expected = (np.eye(3) - normals[:, :, None] * normals[:, None, :]) / radius
    # A net of 33 x 33 is round to 1 % of its curvature; next to the poles, where its derivatives vanish, less so.
    np.testing.assert_allclose(surface.curvature(np.zeros(12)), expected, atol=0.03 / radius)


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
