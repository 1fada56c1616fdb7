"""A threshold is found from seeds alone, for bright and dark organs, and does not depend on the grid."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.segmentation.ray_edges import find_edges
from VICRegistrationLib.segmentation.threshold import threshold_between

SPACING = np.array([0.8, 0.8, 3.0])
RADII = np.array([22.0, 16.0, 18.0])


def suggest_threshold(image, seeds):
    return threshold_between(find_edges(image, seeds))


def organ_image(inside, outside, *, noise=0.05, bias=0.0, dtype=float):
    """Return an ellipsoid around the origin; noise and bias are shares of the inside level."""
    shape = (20, 72, 80)
    matrix = np.diag([*SPACING, 1.0])
    matrix[:3, 3] = -SPACING * (np.array(shape[::-1]) - 1) / 2 + [0.1, 0.2, 0.3]
    k, j, i = np.indices(shape)
    ras = np.stack([i, j, k], axis=-1) * SPACING + matrix[:3, 3]
    distance = (np.linalg.norm(ras / RADII, axis=-1) - 1) * RADII.min()
    levels = outside + (inside - outside) * np.clip(0.5 - distance / 1.5, 0, 1)
    levels *= 1 + bias * ras[..., 0] / RADII[0]
    levels += np.random.default_rng(0).normal(0, noise * inside, shape)
    return Image(np.clip(levels, 0, None).astype(dtype), matrix)


@pytest.mark.parametrize(
    ("inside", "outside", "dtype"), [(200, 80, np.uint8), (50, 170, np.int16), (120, 30, np.float32)]
)
@pytest.mark.parametrize("seed", [[0, 0, 0], [15, 3, -4], [-4, -9, 8]])
def test_the_limit_is_half_way_between_organ_and_surroundings(dtype, inside, outside, seed):
    low, high = suggest_threshold(organ_image(inside, outside, dtype=dtype), [seed])
    limit = low if inside > outside else high
    # The outside level is the farthest of several noisy samples, which draws the limit outwards a little.
    assert limit == pytest.approx((inside + outside) / 2, abs=0.15 * abs(inside - outside))
    assert low + 0.3 * abs(inside - outside) < inside < high - 0.3 * abs(inside - outside)


@pytest.mark.parametrize(("inside", "outside"), [(200, 80), (60, 170)])
def test_a_bias_of_20_percent_does_not_hide_the_organ(inside, outside):
    image = organ_image(inside, outside, bias=0.2)
    low, high = suggest_threshold(image, [[10.0, 0, 0]])
    k, j, i = np.indices(image.array.shape)
    ras = image.to_ras(np.stack([i, j, k], axis=-1).reshape(-1, 3)).reshape(*image.array.shape, 3)
    organ = np.linalg.norm(ras / RADII, axis=-1) < 0.9
    chosen = (image.array >= low) & (image.array <= high)
    assert chosen[organ].mean() > 0.98


def test_brighter_tissue_elsewhere_lies_above_the_upper_limit():
    image = organ_image(120, 30, noise=0.03)
    _, high = suggest_threshold(image, [[0, 0, 0]])
    assert high < 2.1 * 120


def test_several_seeds_agree_with_one():
    image = organ_image(200, 80)
    one = suggest_threshold(image, [[0, 0, 0]])
    several = suggest_threshold(image, [[0, 0, 0], [12, 0, 0], [-5, 5, 9]])
    np.testing.assert_allclose(several, one, rtol=0.05)


def test_a_rotated_and_flipped_copy_has_the_same_threshold():
    image = organ_image(200, 80)
    seed = np.array([7.0, -3.0, 5.0])
    expected = suggest_threshold(image, seed)
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = turn, [30, -20, 10]
    flip = np.diag([-1.0, 1, 1, 1])
    flip[0, 3] = image.size[0] - 1
    copy = Image(image.array[:, :, ::-1].transpose(1, 0, 2), turned @ image.ijk_to_ras @ flip[:, [0, 2, 1, 3]])
    # Equal but for the rounding of the sampled positions.
    np.testing.assert_allclose(suggest_threshold(copy, turn @ seed + turned[:3, 3]), expected, rtol=1e-6)


@pytest.mark.parametrize("seed", [[0, 0, 0], [12, 5, -6]])
def test_the_rays_span_the_volume_of_the_organ(seed):
    edges = find_edges(organ_image(200, 80), seed)
    assert edges.found.all()
    # Rays are a coarse sampling of the sphere of directions, and stop at the foot of a blurred edge.
    assert edges.volume == pytest.approx(4 / 3 * np.pi * RADII.prod(), rel=0.2)
    ends = np.linalg.norm(edges.points / RADII, axis=-1)
    assert np.median(ends) == pytest.approx(1.0, abs=0.05)
