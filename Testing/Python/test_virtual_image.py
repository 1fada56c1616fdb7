"""The virtual image: the intensity profile across a surface (equation 3), and its levels along it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.registration.edge_width import WIDTH_OF_BLUR, blur_covariance
from VICRegistrationLib.registration.virtual_image import (
    INSIDE_PROBES,
    PROBE_DEPTHS,
    IntensityProfile,
    Shares,
    VirtualImage,
    cosine_ramp,
    linear_ramp,
)

# ------------------------------------------------------------------ the profile


def test_the_published_profile_puts_the_surface_at_the_inner_foot_of_the_ramp():
    profile = IntensityProfile(inside=130.0, outside=25.0, width=3.0, centered=False)
    # Equation 3 at d = 0, tau/4, tau/2, 3/4 tau, tau, written out.
    root = np.sqrt(0.5)
    expected = [130.0, 25.0 + 52.5 * (1.0 + root), 77.5, 25.0 + 52.5 * (1.0 - root), 25.0]
    np.testing.assert_allclose(profile.value(np.array([0.0, 0.75, 1.5, 2.25, 3.0])), expected, rtol=1e-14)


def test_the_centred_profile_puts_the_surface_at_half_height():
    profile = IntensityProfile(inside=130.0, outside=25.0, width=3.0)
    np.testing.assert_allclose(profile.value(np.array([-1.5, 0.0, 1.5])), [130.0, 77.5, 25.0], rtol=1e-14)


def test_the_centred_profile_is_the_published_one_moved_inward_by_half_the_ramp():
    distance = np.linspace(-5.0, 5.0, 101)
    published = IntensityProfile(inside=900.0, outside=200.0, width=2.4, centered=False)
    centred = IntensityProfile(inside=900.0, outside=200.0, width=2.4)
    np.testing.assert_allclose(centred.value(distance), published.value(distance + 1.2), rtol=1e-12)


@pytest.mark.parametrize("centered", [True, False])
@pytest.mark.parametrize(("inside", "outside"), [(130.0, 25.0), (25.0, 130.0), (0.0, -40.0)])
def test_levels_are_flat_beyond_the_ramp_and_monotonic_across_it(inside, outside, centered):
    profile = IntensityProfile(inside=inside, outside=outside, width=2.0, centered=centered)
    values = profile.value(np.linspace(-10.0, 10.0, 401))
    assert values[0] == inside
    assert values[-1] == outside
    assert (np.diff(values) * np.sign(outside - inside) >= 0.0).all()


@pytest.mark.parametrize("ramp", [cosine_ramp, linear_ramp])
def test_both_ramps_fall_from_one_to_zero_over_one_width(ramp):
    np.testing.assert_allclose(ramp(np.array([-9.0, -0.5, 0.0, 0.5, 9.0])), [1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-15)
    published = ramp(np.array([-9.0, 0.0, 0.5, 1.0, 9.0]), centered=False)
    np.testing.assert_allclose(published, [1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan, np.inf])
def test_a_ramp_without_a_width_is_refused(width):
    with pytest.raises(ValueError, match="finite grey levels and a positive width are needed"):
        IntensityProfile(inside=1.0, outside=0.0, width=width)


def test_levels_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="A profile from nan to 0 over 2 mm was given"):
        IntensityProfile(inside=np.nan, outside=0.0, width=2.0)


def test_the_ramp_may_be_linear():
    profile = IntensityProfile(10.0, 0.0, 2.0, ramp="linear")
    np.testing.assert_allclose(profile.value([-1.0, -0.5, 0.0, 1.0]), [10.0, 7.5, 5.0, 0.0])


@pytest.mark.parametrize("centered", [True, False])
def test_depths_lie_about_the_middle_of_the_ramp(centered):
    profile = IntensityProfile(1.0, 0.0, 4.0, centered=centered)
    depths = profile.depths(0.5, 5)
    np.testing.assert_allclose(depths - (0.0 if centered else 2.0), [-2.0, -1.0, 0.0, 1.0, 2.0])
    np.testing.assert_allclose(profile.value(depths[[0, 2, 4]]), [1.0, 0.5, 0.0], atol=1e-15)


# ------------------------------------------------------------------ the levels

SHAPE = (24, 16)
N = SHAPE[0] * SHAPE[1]
NORMALS = np.tile([1.0, 0.0, 0.0], (N, 1))
AREA = np.ones(N)


def virtual(inside, outside, width, **options):
    return VirtualImage(IntensityProfile(inside, outside, width), **options)


def lines(inside, outside):
    """Sharp edges at depth 0 from levels (n,) or scalars to others."""
    inside, outside = np.broadcast_to(inside, N), np.broadcast_to(outside, N)
    return np.where(PROBE_DEPTHS < 0.0, inside[:, None], outside[:, None]).astype(float)


def estimated(image, values, valid=None, normals=NORMALS, shares=None):
    valid = np.ones(values.shape, dtype=bool) if valid is None else valid
    shares = np.where(INSIDE_PROBES, 1.0, np.zeros(values.shape)) if shares is None else shares
    return image.estimate(values, valid, shares, normals, AREA, SHAPE)


@pytest.mark.parametrize("mode", ["local", "organ"])
@pytest.mark.parametrize(("inside", "outside"), [(900.0, 200.0), (100.0, 400.0)])
def test_even_levels_are_found_exactly_whichever_side_is_brighter(mode, inside, outside):
    # What was expected is off by 50 on both sides: it may tell the sign only.
    image = virtual(inside + 50.0, outside - 50.0, 2.0, mode=mode)
    found = estimated(image, lines(inside, outside))
    np.testing.assert_allclose(found[0], inside, rtol=1e-12)
    np.testing.assert_allclose(found[1], outside, rtol=1e-12)


def test_local_levels_follow_surroundings_that_change_and_the_organ_has_one_pair():
    around = np.repeat(np.arange(SHAPE[0]) / SHAPE[0], SHAPE[1])
    true = 300.0 + 100.0 * np.cos(2.0 * np.pi * around)
    _, local = estimated(virtual(900.0, 300.0, 2.0, mode="local"), lines(900.0, true))
    _, organ = estimated(virtual(900.0, 300.0, 2.0, mode="organ"), lines(900.0, true))
    # A Gaussian of 0.1 turns leaves exp(-(0.1 * 2 pi)^2 / 2) = 0.821 of one wave, the organ's mean takes 5 % more.
    np.testing.assert_allclose(local, 300.0 + 0.821 / 1.05 * (true - 300.0), atol=1.0)
    np.testing.assert_allclose(organ, 300.0, rtol=1e-12)


def test_the_wall_counts_as_outside_even_if_something_bright_lies_behind_it():
    values = lines(900.0, 150.0)
    values[:, PROBE_DEPTHS > 1.0] = 800.0
    inside, outside = estimated(virtual(900.0, 150.0, 2.0, mode="organ"), values)
    np.testing.assert_allclose(inside, 900.0)
    np.testing.assert_allclose(outside, 150.0)


def test_places_outside_of_the_volume_have_no_say():
    values = lines(900.0, 200.0)
    valid = np.ones(values.shape, dtype=bool)
    values[: N // 2], valid[: N // 2] = 0.0, False
    for mode in ("local", "organ"):
        inside, outside = estimated(virtual(800.0, 300.0, 2.0, mode=mode), values, valid)
        np.testing.assert_allclose(inside, 900.0, rtol=1e-9)
        np.testing.assert_allclose(outside, 200.0, rtol=1e-9)


def test_without_any_valid_place_the_expected_levels_remain():
    values = np.zeros((N, len(PROBE_DEPTHS)))
    inside, outside = estimated(virtual(800.0, 300.0, 2.0, mode="organ"), values, np.zeros(values.shape, dtype=bool))
    np.testing.assert_allclose(inside, 800.0)
    np.testing.assert_allclose(outside, 300.0)


def test_lines_across_thick_slices_count_less():
    values = lines(900.0, 200.0)
    normals = NORMALS.copy()
    # Every other line runs across the slices, and is blurred.
    normals[::2] = [0.0, 0.0, 1.0]
    values[::2] = 550.0
    equal, _ = estimated(virtual(900.0, 200.0, 2.0, mode="organ"), values, normals=normals)
    voxel = np.diag([0.6, 0.6, 3.0])
    sharp, _ = estimated(virtual(900.0, 200.0, 2.0, mode="organ", voxel=voxel), values, normals=normals)
    np.testing.assert_allclose(equal, 725.0)
    # Five times as long a voxel: a twenty-fifth of the weight.
    np.testing.assert_allclose(sharp, (900.0 * 25.0 + 550.0) / 26.0)


def test_what_the_voxels_do_not_explain_of_an_edges_width_is_blur_in_all_directions():
    voxel = np.diag([0.6, 0.6, 4.0])
    sharp, wide = 0.3 * WIDTH_OF_BLUR, 0.5 * WIDTH_OF_BLUR
    np.testing.assert_allclose(blur_covariance(voxel, sharp), np.diag([0.09, 0.09, 4.0]), atol=1e-12)
    np.testing.assert_allclose(blur_covariance(voxel, wide), np.diag([0.25, 0.25, 4.16]))
    np.testing.assert_array_equal(blur_covariance(voxel, 0.1), np.diag([0.09, 0.09, 4.0]))


def test_a_ramp_as_wide_as_a_blur_says_is_as_steep_as_the_blurred_step():
    depth = np.array([-1e-4, 1e-4])
    blurred = np.diff(ndtr(-depth / 0.7))
    np.testing.assert_allclose(np.diff(cosine_ramp(depth / (0.7 * WIDTH_OF_BLUR))), blurred, rtol=1e-6)


def test_what_the_blur_carries_across_the_edge_is_taken_off_the_levels():
    # A wall as thick as 1.5 times the blurred edge is wide: no place in it is as dark as it is.
    width, wall = 2.0, 3.0
    deviation = width / WIDTH_OF_BLUR
    depths = width * PROBE_DEPTHS
    values = 900.0 + (150.0 - 900.0) * ndtr(depths / deviation) + (600.0 - 150.0) * ndtr((depths - wall) / deviation)
    values = np.tile(values, (N, 1))
    image = virtual(880.0, 200.0, width, mode="organ")
    _, plain = estimated(image, values)
    _, outside = estimated(image, values, shares=np.tile(ndtr(-depths / deviation), (N, 1)))
    np.testing.assert_allclose(outside, 150.0, atol=1.0)
    assert plain.min() > 151.0


def test_a_blur_as_wide_as_the_probes_reach_leaves_both_levels():
    # Across thick slices no place is all inside or all outside.
    shares = np.tile(ndtr(-PROBE_DEPTHS / 1.2), (N, 1))
    inside, outside = estimated(virtual(700.0, 300.0, 2.0), 900.0 * shares + 150.0 * (1.0 - shares), shares=shares)
    np.testing.assert_allclose(inside, 900.0, atol=2.0)
    np.testing.assert_allclose(outside, 150.0, atol=2.0)


def with_wall(image, values, valid, wall=3.0):
    """Levels of lines with a blur of 2 mm, as across thick slices."""
    depths = image.probes(wall)
    inside, behind = ndtr(-depths / 2.0), ndtr((depths - wall) / 2.0)
    shares = Shares(np.tile(inside, (N, 1)), np.tile(behind, (N, 1)), wall)
    greys = shares.all @ values
    return image.levels(greys, np.full(greys.shape, valid), shares, NORMALS, AREA, SHAPE)


@pytest.mark.parametrize("mode", ["local", "organ"])
def test_levels_of_an_organ_its_thin_wall_and_what_lies_behind_it_are_told_apart(mode):
    found = with_wall(virtual(880.0, 200.0, 2.0, mode=mode), np.array([900.0, 150.0, 550.0]), valid=True)
    for level, expected in zip(found, (900.0, 150.0, 550.0)):
        np.testing.assert_allclose(level, expected, rtol=1e-5)


@pytest.mark.parametrize("mode", ["local", "organ"])
def test_where_no_place_is_valid_the_expected_levels_remain_with_a_wall(mode):
    found = with_wall(virtual(880.0, 200.0, 2.0, mode=mode), np.array([900.0, 150.0, 550.0]), valid=False)
    for level, expected in zip(found, (880.0, 200.0, 200.0)):
        np.testing.assert_allclose(level, expected)


def test_without_partial_volumes_shares_are_those_of_the_ramp():
    axes, depths = (np.arange(3.0), np.arange(2.0)), np.array([-1.0, 0.0, 1.0])
    shares = virtual(900.0, 100.0, 2.0).shares(closed_organ(), axes, depths).inside
    np.testing.assert_allclose(shares, np.tile([1.0, 0.5, 0.0], (6, 1)), atol=1e-15)


def test_the_published_profile_keeps_its_ramp():
    profile = IntensityProfile(900.0, 100.0, 2.0, centered=False)
    image = VirtualImage(profile, partial_volumes=lambda *arguments: np.zeros((6, 3)))
    axes, depths = (np.arange(3.0), np.arange(2.0)), np.array([0.0, 1.0, 2.0])
    np.testing.assert_allclose(
        image.shares(closed_organ(), axes, depths).inside, np.tile([1.0, 0.5, 0.0], (6, 1)), atol=1e-15
    )


def test_without_a_voxel_all_lines_are_equally_sharp():
    np.testing.assert_array_equal(virtual(1.0, 0.0, 2.0).blur(NORMALS), 1.0)


def test_contrast_is_the_mean_difference_but_never_vanishes():
    image = virtual(900.0, 100.0, 2.0)
    assert image.contrast(np.array([900.0, 700.0]), np.array([100.0, 300.0]), np.ones(2)) == pytest.approx(600.0)
    # Where estimates meet, a twentieth of the expected contrast remains, so that residuals stay finite.
    assert image.contrast(np.array([500.0]), np.array([500.0]), np.ones(1)) == pytest.approx(40.0)


def test_one_level_for_both_sides_is_refused():
    with pytest.raises(ValueError, match=r"The grey level 1 was given for both sides .* two different levels"):
        virtual(inside=1.0, outside=1.0, width=2.0)
