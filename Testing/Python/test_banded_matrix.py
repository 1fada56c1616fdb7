"""Banded matrices of nets: solutions and variances against those of full matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.bending import bending_matrix
from VICRegistrationLib.registration.banded_matrix import BandedMatrix
from VICRegistrationLib.registration.nets import sampled

AXES = np.array([[15.0, 2.0, 0.0], [-1.5, 11.0, 1.0], [0.0, 2.5, 30.0]])


@pytest.fixture(params=["smooth", "paper"])
def surface(request):
    """An organ with a seam and poles, on sparse matrices."""
    return sampled(models.closed_organ((21, 25), closure=request.param, axes=AXES), request.param)


@pytest.fixture
def matrix(surface):
    """A Gauss-Newton matrix of random gradients, with bending energy."""
    gradients = np.random.default_rng(0).normal(size=(np.prod(surface.grid.shape), 3))
    form = surface.quadratic_form(gradients[:, :, None] * gradients[:, None, :])
    bending = surface.parametrization.quadratic_form(bending_matrix(surface.parametrization.surface))
    return form + 1e-3 * bending + 0.1 * sparse.identity(surface.n_dof)


def test_a_net_has_a_narrow_band_across_the_seam_and_at_the_poles(surface, matrix):
    assert surface.sparse
    assert BandedMatrix(matrix).bandwidth < 0.3 * surface.n_dof


def test_solutions_are_those_of_the_full_matrix(matrix):
    random = np.random.default_rng(1)
    right, lift = random.normal(size=len(matrix.diagonal())), random.uniform(0.5, 2.0, len(matrix.diagonal()))
    banded = BandedMatrix(matrix)
    np.testing.assert_allclose(matrix @ banded.solve(right), right, atol=1e-9)
    np.testing.assert_allclose((matrix + sparse.diags(lift)) @ banded.solve(right, lift=lift), right, atol=1e-9)
    # The lift of one solution is not in the next one.
    np.testing.assert_allclose(matrix @ banded.solve(right), right, atol=1e-9)


def test_variances_are_those_of_the_full_inverse(surface, matrix):
    normals = surface.frame(np.zeros(surface.n_dof)).normals
    moves = surface.normal_motion(normals)
    full = moves @ np.linalg.inv(matrix.toarray())
    expected = np.asarray(moves.multiply(full).sum(axis=1)).ravel()
    np.testing.assert_allclose(BandedMatrix(matrix).variances(moves), expected, rtol=1e-9)


def test_a_full_matrix_and_a_diagonal_one_are_banded_too():
    random = np.random.default_rng(2)
    full = np.eye(6) + 0.1 * np.ones((6, 6))
    vectors = random.normal(size=(4, 6))
    expected = np.einsum("ni,ij,nj->n", vectors, np.linalg.inv(full), vectors)
    np.testing.assert_allclose(BandedMatrix(full).variances(vectors), expected)
    np.testing.assert_allclose(BandedMatrix(np.diag([1.0, 2.0, 4.0])).variances(np.eye(3)), [1.0, 0.5, 0.25])


def test_a_matrix_that_is_not_positive_definite_is_an_error(matrix):
    with pytest.raises(np.linalg.LinAlgError):
        BandedMatrix(matrix).solve(np.ones(len(matrix.diagonal())), lift=-1e6 * np.ones(len(matrix.diagonal())))
