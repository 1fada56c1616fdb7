"""The thin-plate energy of a surface."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.geometry import bspline, models
from VICRegistrationLib.geometry.bending import bending_matrix
from VICRegistrationLib.geometry.surface import BSplineSurface

ROTATION = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


@pytest.fixture(params=["organ", "patch"])
def surface(request):
    if request.param == "organ":
        return models.closed_organ(axes=np.diag([20.0, 25.0, 40.0]), center=(100.0, 0.0, -30.0))
    knots_u = np.array([0.0, 0.0, 0.0, 0.3, 0.3, 2.0, 2.0, 2.0])
    knots_v = np.array([0.0, 0.1, 0.3, 0.6, 1.0, 1.5, 2.1, 2.8, 3.6])
    net = np.random.default_rng(0).normal(size=(5, 5, 3))
    return BSplineSurface((2, 3), knots_u, knots_v, net)


def energy(surface, net=None):
    points = (surface.control_net if net is None else net).reshape(-1, 3)
    return float(np.einsum("nk,nk->", points, bending_matrix(surface) @ points))


def test_the_quadratic_form_is_the_integral(surface):
    u, weights_u = bspline.gauss_points(surface.degrees[0], surface.knots_u, 8)
    v, weights_v = bspline.gauss_points(surface.degrees[1], surface.knots_v, 8)
    expected = 0.0
    for factor, order in ((1.0, (2, 0)), (2.0, (1, 1)), (1.0, (0, 2))):
        second = surface.grid(u, v, du=order[0], dv=order[1])
        expected += factor * weights_u @ np.square(second).sum(axis=2) @ weights_v
    # Coordinates of 100 mm that do not count cancel in the second derivatives.
    assert energy(surface) == pytest.approx(expected, rel=1e-10)


def test_the_matrix_is_symmetric_and_has_no_negative_energy(surface):
    matrix = bending_matrix(surface).toarray()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14 * np.abs(matrix).max())
    eigenvalues = np.linalg.eigvalsh(matrix)
    assert eigenvalues[0] > -1e-13 * eigenvalues[-1]


def test_only_maps_linear_in_u_and_v_cost_nothing():
    surface = BSplineSurface(
        (3, 2), bspline.uniform_clamped_knots(3, 6), bspline.uniform_clamped_knots(2, 5), np.zeros((6, 5, 3))
    )
    eigenvalues = np.linalg.eigvalsh(bending_matrix(surface).toarray())
    # The constant, u and v; already their product u v is a twisted plate with |S_uv| = 1.
    assert eigenvalues[2] < 1e-12 * eigenvalues[-1]
    assert eigenvalues[3] > 1e-8 * eigenvalues[-1]
    u = bspline.greville_abscissae(3, surface.knots_u)
    v = bspline.greville_abscissae(2, surface.knots_v)
    plane = np.stack(np.broadcast_arrays(u[:, None], v, 2.0 * u[:, None] - 3.0 * v + 1.0), axis=-1)
    assert abs(energy(surface, plane)) < 1e-11
    twisted = np.stack(np.broadcast_arrays(0.0 * u[:, None], 0.0 * v, u[:, None] * v), axis=-1)
    assert energy(surface, twisted) == pytest.approx(2.0, rel=1e-12)


def test_the_energy_does_not_depend_on_place_or_orientation(surface):
    moved = surface.control_net @ ROTATION.T + [10.0, -20.0, 30.0]
    assert energy(surface, moved) == pytest.approx(energy(surface), rel=1e-9)


def test_the_energy_grows_with_the_square_of_the_size(surface):
    assert energy(surface, 3.0 * surface.control_net) == pytest.approx(9.0 * energy(surface), rel=1e-12)


def test_the_energy_does_not_change_when_knots_are_inserted(surface):
    assert energy(surface.refined()) == pytest.approx(energy(surface), rel=1e-9)
