"""Centre, axes and extents of a region follow it wherever it is turned."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.moments import moments
from VICRegistrationLib.imaging.region import region_from_mask


def region_in(matrix, shape, contains):
    """Return the region of the voxels whose centres (RAS, shape (n, 3)) are contained."""
    image = Image(np.zeros(shape, dtype=np.uint8), matrix)
    k, j, i = np.indices(shape)
    points = image.to_ras(np.stack([i, j, k], axis=-1).reshape(-1, 3))
    return region_from_mask(image, contains(points).reshape(shape))


def centred_matrix(rotation, spacing, shape):
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * spacing
    matrix[:3, 3] = -matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2)
    return matrix


@pytest.fixture
def rotation():
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


def egg(points):
    """Tell which points lie in a lopsided body along x, skewed along y as well, of unequal widths."""
    x, y, z = points.T
    y = y - 0.015 * x**2 + 3
    return (x / 24) ** 2 + (y / (14 + 0.25 * x)) ** 2 + (z / (9 - 0.2 * y)) ** 2 < 1


def test_an_ellipsoid_on_an_oblique_anisotropic_grid(rotation):
    shape = (30, 110, 110)
    radii, center = np.array([25.0, 18.0, 12.0]), np.array([3.0, -2.0, 1.0])
    matrix = centred_matrix(rotation, [0.6, 0.6, 2.0], shape)
    found = moments(region_in(matrix, shape, lambda p: (((p - center) / radii) ** 2).sum(axis=1) < 1))
    np.testing.assert_allclose(found.center, center, atol=0.05)
    np.testing.assert_allclose(found.extents * np.sqrt(5), radii, rtol=0.01)
    np.testing.assert_allclose(np.abs(found.axes), np.eye(3), atol=0.02)


def test_a_box_of_voxels_has_exactly_the_extents_of_the_box():
    image = Image(np.zeros((8, 9, 10)), np.diag([1.0, 2.0, 3.0, 1.0]))
    mask = np.zeros(image.array.shape, dtype=bool)
    mask[2:4, 3:4, 1:9] = True
    found = moments(region_from_mask(image, mask))
    np.testing.assert_allclose(found.extents, np.array([8.0, 6.0, 2.0]) / np.sqrt(12))
    np.testing.assert_allclose(found.center, [4.5, 6.0, 7.5])


def test_axes_are_a_right_handed_frame_on_any_grid(rotation):
    for handedness in (1, -1):
        matrix = centred_matrix(rotation * [handedness, 1, 1], [0.7, 0.7, 2.0], (30, 80, 80))
        axes = moments(region_in(matrix, (30, 80, 80), egg)).axes
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)


def test_axes_turn_with_the_organ(rotation):
    shape = (40, 90, 90)
    matrix = centred_matrix(np.eye(3), [0.8, 0.8, 1.6], shape)
    region = region_in(matrix, shape, egg)
    expected = moments(region)
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = rotation, [30, -20, 10]
    image = Image(region.mask, turned @ region.ijk_to_ras)
    found = moments(region_from_mask(image, region.mask))
    np.testing.assert_allclose(found.axes, expected.axes @ rotation.T, atol=1e-9)
    np.testing.assert_allclose(found.center, rotation @ expected.center + [30, -20, 10], atol=1e-9)
    np.testing.assert_allclose(found.extents, expected.extents)


def test_the_long_axis_points_to_the_thin_end():
    def pear(points):
        x, y, z = points.T
        return (np.abs(x) < 20) & (y**2 + z**2 < (8 - 0.2 * x) ** 2)

    matrix = centred_matrix(np.eye(3), [1, 1, 1], (40, 40, 60))
    axis = moments(region_in(matrix, (40, 40, 60), pear)).axes[0]
    # The tail of the distribution, with positive skewness, is where the pear is thin.
    assert axis[0] > 0.99
