"""An image on another grid, and distances from the boundary of a mask."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.resampling import resampled, signed_distances
from VICRegistrationLib.imaging.sampling import Sampler


def grid(spacing, degrees, origin):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0.6, -0.8, 0.0])).as_matrix() * spacing
    matrix[:3, 3] = origin
    return matrix


@pytest.mark.parametrize("flip", [1.0, -1.0])
@pytest.mark.parametrize("kind", [bool, np.int16, np.float32])
def test_it_is_what_a_sampler_finds_at_the_voxels_centres(flip, kind):
    array = (np.random.default_rng(0).normal(size=(7, 9, 11)) > 0.0).astype(kind)
    image = Image(array, grid((0.5, 0.7, flip * 3.0), 20.0, (-2.0, 1.0, 4.0)))
    # Reaches beyond the volume on all sides.
    other, size = grid((0.9, 0.9, 0.9), -35.0, (0.0, 0.0, 0.0)), np.array([14, 28, 35])
    other[:3, 3] = image.to_ras(np.array([5.0, 4.0, 3.0])) - other[:3, :3] @ (size / 2.0)
    found = resampled(image, other, size)
    k, j, i = np.indices(size[::-1])
    values, valid = Sampler(image).values(found.to_ras(np.stack([i, j, k], axis=-1).reshape(-1, 3)))
    assert 100 < np.count_nonzero(valid) < 0.9 * len(valid)
    np.testing.assert_allclose(found.array.ravel(), values, atol=1e-9)
    np.testing.assert_array_equal(found.ijk_to_ras, other)


@pytest.mark.parametrize("seed", range(3))
def test_distances_are_exact_and_negative_inside(seed):
    mask = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(20, 25, 30)), 3) > 0.02
    mask[[0, -1]] = mask[:, [0, -1]] = mask[:, :, [0, -1]] = False
    depth, away = (ndimage.distance_transform_edt(part) for part in (mask, ~mask))
    expected = 0.7 * np.where(mask, 0.5 - depth, away - 0.5)
    np.testing.assert_allclose(signed_distances(mask, 0.7), expected, atol=1e-5)
    # Half a voxel on both sides of the boundary.
    assert np.abs(signed_distances(mask, 0.7)).min() == pytest.approx(0.35, abs=1e-6)
