"""The one-dimensional example of the paper's figures 5 and 6."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.validation import one_dimensional as example


def test_the_example_has_the_numbers_of_the_paper():
    assert (example.PROFILE.inside, example.PROFILE.outside, example.PROFILE.width) == (130.0, 25.0, 3.0)
    assert not example.PROFILE.centered
    assert example.TRUE_SHIFT == 2.6


def test_the_pixels_are_the_profile_at_whole_numbers():
    pixels = example.row_of_pixels()
    assert pixels.shape == (10,)
    # Pixels 0 to 2 lie before the edge at 2.6, pixels from 6 on behind its ramp of 3 pixels.
    np.testing.assert_array_equal(pixels[:3], 130.0)
    np.testing.assert_array_equal(pixels[6:], 25.0)
    assert pixels[3] == pytest.approx(25.0 + 52.5 * (1.0 + np.cos(np.pi * 0.4 / 3.0)), rel=1e-12)


@pytest.mark.parametrize("shift", [2.6, 1.0, 1.3, 3.0, 3.5, 4.25, 5.7])
def test_the_minimum_lies_at_the_true_shift(shift):
    found = example.best_shift(example.row_of_pixels(shift))
    # Asked for are 0.02 pixel; interpolation between the pixels of a ramp of three costs up to 0.002.
    assert found == pytest.approx(shift, abs=0.005)


def test_the_minimum_is_the_least_of_the_whole_curve():
    pixels = example.row_of_pixels()
    best = example.best_shift(pixels)
    curve = example.cost(np.linspace(0.0, 6.0, 601), pixels)
    assert example.cost(best, pixels)[0] <= curve.min()
    assert curve.min() > 0.0


def test_the_cost_is_equation_4_written_out():
    pixels = example.row_of_pixels()
    samples = np.linspace(0.0, 3.0, 31)
    grey = example.interpolated(pixels, 1.7 + samples)
    virtual = 25.0 + 52.5 * (1.0 + np.cos(np.pi * samples / 3.0))
    assert example.cost(1.7, pixels) == pytest.approx(np.sum((grey - virtual) ** 2), rel=1e-12)


def test_the_interpolation_passes_through_the_pixels():
    pixels = example.row_of_pixels()
    np.testing.assert_allclose(example.interpolated(pixels, np.arange(10.0)), pixels, rtol=1e-12)
