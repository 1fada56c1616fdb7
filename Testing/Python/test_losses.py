"""A robust loss: samples on another structure count less."""

from __future__ import annotations

import numpy as np
import pytest
from test_confidence import RADIUS, ball

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_box
from VICRegistrationLib.registration.losses import sample_shares
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import finish, fit_region


def test_squares_leave_all_weights():
    np.testing.assert_array_equal(sample_shares("squares", np.array([[0.0, 9.0]]), np.ones((1, 2))), 1.0)


def test_huber_takes_from_the_large_ones():
    residuals = np.array([0.1, -0.1, 0.1, -0.1, 0.1, 1.0, -2.0])[:, None]
    shares = sample_shares("huber", residuals, np.ones_like(residuals))[:, 0]
    np.testing.assert_array_equal(shares[:5], 1.0)
    # Twice the scaled median, over the size.
    assert shares[5] == pytest.approx(2.0 * 1.4826 * 0.1)
    assert shares[6] == pytest.approx(shares[5] / 2.0)


def test_samples_without_weight_do_not_set_the_scale():
    residuals, weights = np.array([[0.1, 0.1, 5.0, 5.0, 5.0]]), np.array([[1.0, 1.0, 0.0, 0.0, 0.0]])
    assert sample_shares("huber", residuals, weights)[0, 0] == 1.0
    assert sample_shares("huber", residuals, weights)[0, 2] < 0.1
    assert np.isfinite(sample_shares("huber", residuals, np.zeros_like(weights))).all()


def test_small_clots_at_the_wall_dent_the_surface_less():
    image = ball()
    k, j, i = np.indices(image.array.shape)
    points = image.to_ras(np.stack([i, j, k], axis=-1))
    array = image.array.copy()
    for turn in np.arange(6) * np.pi / 3.0:
        array[np.linalg.norm(points - [18.0 * np.cos(turn), 18.0 * np.sin(turn), 0.0], axis=-1) < 2.5] = 60.0
    clotted = Image(array, image.ijk_to_ras)
    region = region_from_box(clotted, [[-RADIUS] * 3, [RADIUS] * 3])
    means = {}
    for loss in ("squares", "huber"):
        fit = finish(fit_region(clotted, region, FitOptions(loss=loss)))
        assert fit.problems == ()
        means[loss] = np.abs(np.linalg.norm(fit.confidence.points, axis=2) - RADIUS).mean()
    # Measured: 0.12 and 0.08 mm.
    assert means["huber"] < 0.85 * means["squares"]


def test_other_losses_are_refused():
    with pytest.raises(ValueError, match="The option loss is 'cauchy'; choose one of squares, huber"):
        FitOptions(loss="cauchy")
