"""An image knows where its voxels are, whatever its grid looks like."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from VICRegistrationLib.imaging.image import Image

OBLIQUE_SHEARED_LEFT_HANDED = np.array(
    [[0.5, 0.1, -0.3, 10.0], [0.2, -0.6, 0.4, -20.0], [0.05, 0.3, 3.8, 30.0], [0, 0, 0, 1]]
)


def regridded(image, order, flips):
    """Return a copy of the world whose grid has permuted and flipped axes; new axis n is old axis order[n]."""
    change = np.zeros((4, 4))
    change[list(order), [0, 1, 2]] = 1
    change[3, 3] = 1
    for axis in range(3):
        if flips[axis]:
            change[:3, 3] += change[:3, axis] * (image.size[order[axis]] - 1)
            change[:3, axis] *= -1
    array = image.array.transpose([2 - axis for axis in order[::-1]])
    array = array[tuple(slice(None, None, -1 if flip else 1) for flip in flips[::-1])]
    return Image(np.ascontiguousarray(array), image.ijk_to_ras @ change)


@pytest.fixture
def image():
    array = np.random.default_rng(1).integers(0, 1000, (4, 6, 5)).astype(np.int16)
    return Image(array, OBLIQUE_SHEARED_LEFT_HANDED)


def test_points_go_to_indices_and_back(image):
    ijk = np.random.default_rng(2).uniform(-3, 9, (20, 3))
    ras = image.to_ras(ijk)
    np.testing.assert_allclose(ras[0], (OBLIQUE_SHEARED_LEFT_HANDED @ [*ijk[0], 1])[:3])
    np.testing.assert_allclose(image.to_ijk(ras), ijk, atol=1e-12)


def test_spacing_and_voxel_volume_come_from_the_columns():
    image = Image(np.zeros((2, 3, 4)), np.diag([-0.59, -0.59, 4.0, 1.0]))
    np.testing.assert_allclose(image.spacing, [0.59, 0.59, 4.0])
    assert image.voxel_volume == pytest.approx(0.59 * 0.59 * 4)
    assert image.size.tolist() == [4, 3, 2]


def test_a_crop_stays_in_place_and_shares_its_voxels(image):
    crop = image.crop((1, 2, 0), (4, 5, 3))
    assert np.shares_memory(crop.array, image.array)
    assert crop.array[0, 1, 2] == image.array[1, 3, 2]
    np.testing.assert_allclose(crop.to_ras([[2, 1, 0]]), image.to_ras([[2, 3, 1]]))


def test_a_crop_outside_the_volume_is_refused(image):
    with pytest.raises(ValueError, match="leaves the volume of"):
        image.crop((0, 0, 0), (5, 6, 5))


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_permuted_and_flipped_copies_have_one_canonical_form(image, order):
    canonical = image.canonical()
    assert np.shares_memory(canonical.array, image.array)
    for flips in itertools.product((False, True), repeat=3):
        other = regridded(image, order, flips).canonical()
        np.testing.assert_array_equal(other.array, canonical.array)
        np.testing.assert_allclose(other.ijk_to_ras, canonical.ijk_to_ras, atol=1e-12)


def test_the_canonical_form_does_not_depend_on_the_order_of_axes_at_45_degrees():
    half = np.sqrt(0.5)
    matrix = np.array([[half, half, 0, 0], [half, -half, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])
    image = Image(np.random.default_rng(3).random((3, 4, 5)), matrix)
    for order in itertools.permutations(range(3)):
        other = regridded(image, order, (True, False, True)).canonical()
        np.testing.assert_array_equal(other.array, image.canonical().array)


def test_canonical_axes_run_to_right_anterior_and_superior(image):
    directions = image.canonical().ijk_to_ras[:3, :3]
    assert (np.diag(directions) > 0).all()
    assert np.abs(directions).argmax(axis=0).tolist() == [0, 1, 2]


def test_masks_are_images():
    assert Image(np.zeros((2, 2, 2), dtype=bool), np.eye(4)).array.dtype == bool


def test_numbers_in_foreign_byte_order_are_read():
    image = Image(np.arange(8, dtype=">i2").reshape(2, 2, 2), np.eye(4))
    assert image.array.dtype == np.int16
    assert image.array[1, 1, 1] == 7
