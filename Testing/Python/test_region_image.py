"""The separated region as a distance image in the organ's own frame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.registration.region_image import region_image

CENTER = np.array([5.0, -7.0, 11.0])


def frame(rotation=None):
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if rotation is None else rotation
    matrix[:3, 3] = CENTER
    return matrix


def ball_region(spacing=(1.0, 1.0, 1.0), radius=15.0, rotation=None):
    """Voxels of a ball at CENTER, on a grid turned by a rotation."""
    shape = tuple(int(2 * (radius + 6) / step) for step in spacing[::-1])
    matrix = np.eye(4)
    matrix[:3, :3] = frame(rotation)[:3, :3] @ np.diag(spacing)
    matrix[:3, 3] = CENTER - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    image = Image(np.zeros(shape), matrix)
    k, j, i = np.indices(shape).reshape(3, -1)
    inside = np.linalg.norm(image.to_ras(np.column_stack([i, j, k])) - CENTER, axis=1) < radius
    return region_from_mask(image, inside.reshape(shape))


def on_sphere(radius, count=400):
    directions = np.random.default_rng(0).normal(size=(count, 3))
    return radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_values_are_signed_distances_negative_inside():
    target = region_image(ball_region(), frame(), margin=8.0)
    sampler = Sampler(target.distance)
    for radius in (8.0, 12.0, 15.0, 18.0, 21.0):
        values, valid = sampler.values(on_sphere(radius))
        assert valid.all()
        # Distances are measured between the centres of voxels: good to about one, better in the mean, and best at the
        # boundary itself, where the errors of both sides cancel.
        np.testing.assert_allclose(values, radius - 15.0, atol=1.0 * target.distance.spacing[0])
        bound = 0.15 if radius == 15.0 else 0.5
        assert values.mean() == pytest.approx(radius - 15.0, abs=bound * target.distance.spacing[0])


def test_the_margin_lies_around_the_region():
    target = region_image(ball_region(), frame(), margin=8.0)
    corners = target.distance.to_ras(np.array([[0, 0, 0], target.distance.size - 1]))
    assert (corners[0] <= -14.0 - 8.0).all()
    assert (corners[1] >= 14.0 + 8.0).all()
    assert target.extent == pytest.approx(np.abs(target.distance.array).max())


def test_the_grid_is_even_and_of_bounded_size():
    for radius in (6.0, 40.0):
        distance = region_image(ball_region((1.0, 1.0, 3.0), radius), frame(), margin=10.0).distance
        assert np.ptp(distance.spacing) < 1e-12
        # 100,000 voxels, and one more plane at each end.
        assert 100_000 <= distance.array.size < 125_000


def test_thick_slices_leave_no_terraces():
    sampler = Sampler(region_image(ball_region((0.6, 0.6, 5.0)), frame(), margin=8.0).distance)
    values, _ = sampler.values(on_sphere(15.0))
    # Steps of 5 mm would be off by 2.5 mm near the ends of the ball; the interpolated mask by about half of that.
    assert np.abs(values).max() < 1.9
    assert np.abs(values).mean() < 0.6


def test_a_region_turned_with_its_frame_gives_the_same_numbers():
    rotation = Rotation.from_rotvec(np.deg2rad(63.0) * np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25)).as_matrix()
    spacing = (0.8, 1.1, 2.7)
    straight = region_image(ball_region(spacing), frame(), margin=8.0).distance
    turned = region_image(ball_region(spacing, rotation=rotation), frame(rotation), margin=8.0).distance
    np.testing.assert_allclose(turned.ijk_to_ras, straight.ijk_to_ras, atol=1e-9)
    # Rounding may tip single voxels at exactly one half, each by one step of the grid.
    assert np.mean(np.abs(turned.array - straight.array) > 1e-9) < 0.01


def test_a_speck_is_refused():
    mask = np.zeros((20, 20, 20), dtype=bool)
    mask[10, 10, 10] = True
    matrix = np.diag([0.05, 0.05, 0.05, 1.0])
    region = region_from_mask(Image(np.zeros(mask.shape), matrix), mask)
    with pytest.raises(ValueError, match=r"The region holds 0\.00 ml, too little or too thin for a surface; check"):
        region_image(region, np.eye(4), margin=10.0)
