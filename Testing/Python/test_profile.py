"""The intensity profile across a surface (equation 3)."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.registration.profile import IntensityProfile, cosine_ramp, linear_ramp


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
