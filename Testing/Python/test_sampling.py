"""Interpolated grey levels and their exact gradients, in the world's frame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler

MATRIX = np.array([[0.5, 0.1, -0.3, 10.0], [0.2, -0.6, 0.4, -20.0], [0.05, 0.3, 3.8, 30.0], [0, 0, 0, 1]])


@pytest.fixture
def image():
    return Image(np.random.default_rng(0).normal(size=(6, 9, 8)), MATRIX)


@pytest.fixture
def points(image):
    ijk = np.random.default_rng(1).uniform(-0.45, 1, (500, 3)) * (image.size - 0.55)
    return image.to_ras(ijk.clip(-0.45, None))


def test_values_are_those_of_scipy(image, points):
    index = image.to_ijk(points).clip(0, image.size - 1)
    expected = ndimage.map_coordinates(image.array, index[:, ::-1].T, order=1, mode="mirror")
    values, valid = Sampler(image).values(points)
    assert valid.all()
    np.testing.assert_allclose(values, expected, atol=1e-12)


def test_voxel_centres_keep_their_grey_level(image):
    k, j, i = np.indices(image.array.shape)
    points = image.to_ras(np.stack([i, j, k], axis=-1).reshape(-1, 3))
    values, valid = Sampler(image).values(points)
    assert valid.all()
    np.testing.assert_allclose(values, image.array.ravel(), atol=1e-10)


def test_gradients_are_the_derivatives_of_the_values(image, points):
    sampler = Sampler(image)
    _, gradients, valid = sampler.values_and_gradients(points)
    assert valid.all()
    # Points within the step of a cell's face have no single derivative.
    index = image.to_ijk(points)
    clear = (np.abs(index - np.rint(index)) > 1e-4).all(axis=1)
    step = 1e-5
    for axis, direction in enumerate(np.eye(3)):
        ahead, _ = sampler.values(points + step * direction)
        behind, _ = sampler.values(points - step * direction)
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(gradients[clear, axis], difference[clear], atol=1e-6)


def test_a_linear_world_has_its_own_gradient():
    k, j, i = np.indices((5, 6, 7))
    ras = np.stack([i, j, k], axis=-1) @ MATRIX[:3, :3].T + MATRIX[:3, 3]
    image = Image(ras @ [2.0, -3.0, 0.5], MATRIX)
    point = image.to_ras([[2.3, 1.7, 3.1]])
    _, gradients, _ = Sampler(image).values_and_gradients(point)
    np.testing.assert_allclose(gradients, [[2.0, -3.0, 0.5]], atol=1e-9)


def test_outside_the_outer_faces_there_is_nothing(image):
    sampler = Sampler(image)
    last = image.size - 1
    ijk = np.array([[-0.49, 1, 1], [-0.51, 1, 1], [2, last[1] + 0.49, 2], [2, 2, last[2] + 0.51]])
    values, gradients, valid = sampler.values_and_gradients(image.to_ras(ijk))
    assert valid.tolist() == [True, False, True, False]
    assert values[~valid].tolist() == [0, 0]
    assert not gradients[~valid].any()
    assert values[0] == pytest.approx(image.array[1, 1, 0], abs=1e-9)


def test_points_that_are_not_finite_are_not_valid(image):
    values, gradients, valid = Sampler(image).values_and_gradients([[np.nan, 0, 0], [np.inf, 1, 1]])
    assert not valid.any()
    assert not values.any()
    assert not gradients.any()


def test_results_have_the_shape_of_the_points(image, points):
    stacked = points[:60].reshape(3, 4, 5, 3)
    values, gradients, valid = Sampler(image).values_and_gradients(stacked)
    assert values.shape == valid.shape == (3, 4, 5)
    assert gradients.shape == (3, 4, 5, 3)
    np.testing.assert_array_equal(values.ravel(), Sampler(image).values(points[:60])[0])


def test_many_points_are_treated_like_few(image):
    points = image.to_ras(np.random.default_rng(4).uniform(0, 5, (40000, 3)))
    many, _ = Sampler(image).values(points)
    few, _ = Sampler(image).values(points[-10:])
    np.testing.assert_array_equal(many[-10:], few)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.float32, bool])
def test_small_number_types_neither_wrap_nor_round(dtype):
    array = (np.random.default_rng(5).random((3, 4, 5)) * 255).astype(dtype)
    points = np.random.default_rng(6).uniform(0, 2, (50, 3))
    exact, _ = Sampler(Image(array.astype(float), np.eye(4))).values(points)
    values, _ = Sampler(Image(array, np.eye(4))).values(points)
    np.testing.assert_array_equal(values, exact)


def test_two_voxels_along_an_axis_suffice():
    image = Image(np.random.default_rng(7).random((2, 2, 2)), np.eye(4))
    values, _ = Sampler(image).values([[1, 0, 1]])
    assert values[0] == pytest.approx(image.array[1, 0, 1])


def test_points_without_three_coordinates_are_refused(image):
    with pytest.raises(ValueError, match="last axis must hold R, A and S"):
        Sampler(image).values(np.zeros((4, 2)))
