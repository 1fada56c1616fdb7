"""No fit ends with a folded surface: the region's own closed surface is the last resort."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import dilate
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration import organ as organ_module
from VICRegistrationLib.registration.choices import Choice
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.region_image import region_image
from VICRegistrationLib.registration.region_surface import closed_surface
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.registration.verdict import verdict_of

HALF = 30


def image_of(mask):
    matrix = np.eye(4)
    matrix[:3, 3] = -HALF
    noise = 5.0 * np.random.default_rng(0).standard_normal(mask.shape)
    return Image(np.where(mask, 200.0, 50.0) + noise, matrix)


@pytest.fixture(scope="module")
def hook():
    """A ball with a bent arm, which no ray from its middle sees whole."""
    k, j, i = np.indices((2 * HALF + 1,) * 3) - HALF
    ball = k**2 + j**2 + i**2 < 14.0**2
    arm = np.zeros_like(ball)
    for t in np.linspace(0.0, 1.0, 40):
        arm |= (k - 4) ** 2 + (j - 22.0 * np.sin(3.0 * t)) ** 2 + (i - 24.0 * t) ** 2 < 4.0**2
    return ball | arm


def test_a_regions_own_surface_is_a_valid_solid(hook):
    distance = region_image(region_from_mask(image_of(hook), hook), np.eye(4), margin=8.0).distance
    surface = closed_surface(distance, (17, 11), "smooth")
    assert check_surface(surface) == ()
    assert 0.5 < surface.volume() / hook.sum() < 1.5


def test_a_ball_is_met(hook):
    k, j, i = np.indices(hook.shape) - HALF
    ball = k**2 + j**2 + i**2 < 15.0**2
    distance = region_image(region_from_mask(image_of(ball), ball), np.eye(4), margin=8.0).distance
    surface = closed_surface(distance, (9, 7), "smooth")
    radii = np.linalg.norm(surface.points(*surface.midpoints(20, 10)), axis=1)
    np.testing.assert_allclose(radii, 15.0, atol=0.4)


def test_a_fit_that_would_end_folded_ends_with_it_and_says_so(hook, monkeypatch):
    mask = dilate(hook, np.eye(3), 1.0)
    image = image_of(mask)

    def folded(found, *_):
        net = found.surface.control_net.copy()
        net[2:4] = 3.0 * net[2:4].mean(axis=(0, 1)) - 2.0 * net[2:4]
        wrong = BSplineSurface(found.surface.degrees, found.surface.knots_u, found.surface.knots_v, net)
        step = replace(found, surface=wrong)
        yield step
        return step, (Choice("net", "9x7", ()),)

    monkeypatch.setattr(organ_module, "fit_finer", folded)
    fit = finish(fit_region(image, region_from_mask(image, mask)))
    assert fit.problems == ()
    assert fit.history[-1].stage == "closed surface of the region kept"
    held = [choice for choice in fit.choices if choice.option == "drift limit"][-1]
    assert [reason.code for reason in held.reasons] == ["no_valid_solid", "surface_kept"]
    assert verdict_of(fit, ()).word == "poor"
