"""The drift limit: surfaces that fold or leave the region are refused, and fitted again closer to it."""

from __future__ import annotations

import numpy as np
import pytest
from hippocampus import ellipsoid_in_box
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration import drift_limit
from VICRegistrationLib.registration.drift_limit import drift
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.region_image import RegionImage
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.registration.verdict import verdict_of


def drifted(surface):
    """Whether a surface has drifted from the region of the small phantom's ellipsoid."""
    matrix = np.eye(4)
    matrix[:3, 3] = CENTER - 35.0
    k, j, i = np.indices((71, 71, 71))
    points = np.stack([i, j, k], axis=-1) - 35.0
    # Near the boundary about the signed distance from it.
    distance = 18.0 * (np.linalg.norm(points / [14.0, 18.0, 22.0], axis=-1) - 1.0)
    return drift(surface, RegionImage(Image(distance, matrix), float(np.abs(distance).max())))


def test_a_surface_in_its_place_is_within_the_limit():
    assert drifted(ellipsoid()) is None


@pytest.mark.parametrize(
    ("shift", "why"),
    [(12.0, "far_from_region"), (60.0, "left_surroundings")],
)
def test_a_surface_far_away_is_beyond_it(shift, why):
    matrix = np.array([[1, 0, 0, shift], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    assert drifted(ellipsoid().transformed(matrix)).code == why


def test_a_folded_surface_is_refused():
    net = ellipsoid().control_net.copy()
    net[:, [2, 4]] = net[:, [4, 2]]
    assert drifted(ellipsoid().with_control_net(net)).code == "no_valid_solid"


def tissue():
    """Blotches of 6 mm, no organ."""
    random = np.random.default_rng(5).choice([60.0, 100.0, 160.0], (12, 12, 12))
    array = np.kron(random, np.ones((5, 5, 5))) + np.random.default_rng(4).normal(0.0, 5.0, (60, 60, 60))
    return Image(array, np.eye(4))


def fitted_to_tissue():
    return finish(fit_region(tissue(), ellipsoid_in_box(tissue(), [[18.0, 16.0, 14.0], [42.0, 44.0, 46.0]])))


def held_closer(fit):
    """Nets of the surfaces that were refused, and held closer to the region."""
    limited = [choice for choice in fit.choices if choice.option == "drift limit"]
    assert all(choice.value.endswith("times closer") for choice in limited)
    assert all(choice.reasons[-1].code == "held_closer" for choice in limited)
    return [choice.reasons[-1].values["net"] for choice in limited]


def test_an_image_of_nothing_but_tissue_does_not_tear_a_surface_apart():
    fit = fitted_to_tissue()
    assert fit.problems == ()
    center, radii = np.array([30.0, 30.0, 30.0]), np.array([12.0, 14.0, 16.0])
    reach = np.linalg.norm((fit.confidence.points - center) / radii, axis=-1)
    # At most half a radius out of the box.
    assert reach.min() > 0.3
    assert reach.max() < 1.7
    assert held_closer(fit)
    assert "held_closer" in {reason.code for reason in verdict_of(fit, ()).reasons}
    assert fit.confidence.unsupported_share > 0.3


def test_surfaces_of_two_nets_that_are_held_closer_have_stages_of_their_own(monkeypatch):
    """Each stage has a name of its own, by which its steps are put together."""
    refused = set()

    def first_of_its_net(surface, region):
        before = len(refused)
        refused.add(surface.control_net.shape)
        return None if len(refused) == before else Diagnostic("left_surroundings")

    monkeypatch.setattr(drift_limit, "drift", first_of_its_net)
    fit = fitted_to_tissue()
    assert held_closer(fit) == ["9x7", "17x11"]
    names = [step.stage for step in fit.history]
    runs = [name for before, name in zip(["", *names], names) if name != before]
    assert len(runs) == len(set(runs))
