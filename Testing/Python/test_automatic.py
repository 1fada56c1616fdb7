"""What a fit chooses by itself, and why; and the leash that holds a surface where the image shows no edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import random_organs
from small_phantom import CENTER, ellipsoid, ellipsoid_image

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry import models, parametrization
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_box
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.drift_limit import astray
from VICRegistrationLib.registration.edge_width import edge_width
from VICRegistrationLib.registration.finer_nets import first_net, noise_share
from VICRegistrationLib.registration.nets import net_of
from VICRegistrationLib.registration.organ import FitOptions, finish, fit_organ, fit_region, refit
from VICRegistrationLib.segmentation.separation import separate


@pytest.fixture(scope="module")
def image():
    return ellipsoid_image()


def choices(fit):
    return {choice.option: choice for choice in fit.choices}


# ------------------------------------------------------------------ the net


def painted(surface, *, noise=10.0, seed=0):
    """An organ in even surroundings, pixels of 1.2 mm, slices of 3 mm."""
    return random_organs.painted(surface, spacing=(1.2, 1.2, 3.0), noise=noise, seed=seed)[0]


def with_dents(net, width):
    """An organ with two dents of 6 mm, so wide where half as deep."""
    model = models.closed_organ(net, axes=np.diag([20.0, 20.0, 24.0]))
    points = model.control_net
    push = np.zeros_like(points)
    for place in ([20.0, 0.0, 6.0], [-14.0, -14.0, -6.0]):
        near = 0.5 ** (np.square(points - place).sum(axis=-1, keepdims=True) / (width / 2.0) ** 2)
        push -= 6.0 * near * np.array(place) / 22.0
    smooth = parametrization.closed_organ(model)
    return smooth.deform(smooth.fit(points + push))


def angle_between(surface, truth):
    """Mean angle of the normals, degrees."""
    points = points_on(truth, 2000)
    normals = [each.normals(*closest_points(each, points).parameters.T) for each in (surface, truth)]
    return np.degrees(np.arccos(np.clip(np.einsum("nk,nk->n", *normals), -1.0, 1.0))).mean()


@pytest.fixture(scope="module")
def dented():
    """An organ with dents that 9x7 control points cannot follow."""
    return with_dents((17, 11), 13.0)


def test_detail_makes_the_net_finer_and_the_reason_is_told(dented):
    fit = finish(fit_organ(painted(dented), [[0.0, 0.0, 0.0]]))
    assert fit.options.net == (17, 11)
    net = choices(fit)["net"]
    assert net.value == "17x11"
    assert net.reasons[0].code == "finer_net_lowered_cost"
    assert net.reasons[0].values["change"] > net.reasons[0].values["explained"]


def test_noise_alone_is_worth_no_finer_net():
    smooth = models.closed_organ(axes=np.diag([30.0, 25.0, 22.0]))
    image, seed = random_organs.painted(smooth, spacing=(1.0, 1.0, 1.0), noise=60.0, seed=1)
    fit, finest = (finish(fit_organ(image, seed, FitOptions(net=net))) for net in (None, (33, 19)))
    assert fit.options.net == (9, 7)
    assert [reason.code for reason in choices(fit)["net"].reasons] == ["finer_net_raised_cost"]
    assert fit.history[-1].stage == "coarser net kept"
    assert fit.surface is fit.history[-1].surface
    assert fit.converged
    rough, even = (angle_between(found.surface, smooth) for found in (finest, fit))
    assert rough > 1.5 * even


def test_what_is_asked_for_is_done(image):
    fit = finish(fit_organ(image, CENTER[None], FitOptions(net=(9, 7), tau=2.5, smoothness=1e-4)))
    assert fit.options == replace(fit.options, net=(9, 7), tau=2.5, smoothness=1e-4)
    assert [choice.reasons for choice in fit.choices] == 3 * [(Diagnostic("option_given"),)]
    assert not [step for step in fit.history if "17x11" in step.stage]


def test_the_finer_net_keeps_the_smooth_closure(dented):
    fit = finish(fit_organ(painted(dented), [[0.0, 0.0, 0.0]]))
    parametrization.closed_organ(fit.surface, closure="smooth")
    again = finish(refit(painted(dented), fit.surface))
    assert again.options.closure == "smooth"
    assert again.options.net == (17, 11)


def test_a_notch_in_thin_slices_makes_the_net_as_fine_as_it_needs():
    notched = with_dents((33, 19), 7.0)
    image = random_organs.painted(notched, spacing=(0.8, 0.8, 1.0), noise=10.0, seed=0)[0]
    fit, coarser = (finish(fit_organ(image, [[0.0, 0.0, 0.0]], FitOptions(net=net))) for net in (None, (17, 11)))
    assert fit.options.net == (33, 19)
    assert [reason.code for reason in choices(fit)["net"].reasons] == 2 * ["finer_net_lowered_cost"]
    assert fit.problems == ()
    off, before = (deviation(found.surface, notched, n_points=3000) for found in (fit, coarser))
    assert off.p95 < 0.5 * before.p95
    assert off.maximum < 0.8 * before.maximum


def test_in_noise_a_net_that_promises_too_little_is_not_tried(dented):
    fit = finish(fit_organ(painted(dented, noise=40.0), [[0.0, 0.0, 0.0]]))
    assert fit.options.net == (17, 11)
    assert choices(fit)["net"].reasons[-1].code == "finer_net_not_tried"
    assert choices(fit)["net"].reasons[-1].values["net"] == "33x19"
    assert not [step for step in fit.history if "33x19" in step.stage]


@pytest.mark.parametrize("closure", ["smooth", "paper"])
def test_nets_are_begun_with_where_halving_spans_leads_to_them(closure):
    surface = models.closed_organ((9, 7), closure=closure)
    for _ in range(3):
        assert first_net(net_of(surface, closure), closure) == (9, 7)
        surface = surface.refined()
    for net in ((13, 9), (9, 13), (65, 49), (8, 7), (5, 5), (100_000, 7)):
        assert first_net(net, closure) == net
    assert first_net(None, closure) == (9, 7)


def test_a_given_net_is_fitted_as_one_that_was_chosen(dented):
    volume = painted(dented)
    chosen = finish(fit_organ(volume, [[0.0, 0.0, 0.0]]))
    assert chosen.options.net == (17, 11)
    given = finish(fit_organ(volume, [[0.0, 0.0, 0.0]], FitOptions(net=(17, 11))))
    assert choices(given)["net"].reasons == (Diagnostic("option_given"),)
    np.testing.assert_allclose(given.surface.control_net, chosen.surface.control_net, atol=1e-9)


def test_noise_takes_a_share_of_the_cost():
    # 300 degrees of freedom move 100 places along the normal.
    assert noise_share(300, 1000.0) == pytest.approx(0.1)
    assert noise_share(300, 500.0) == pytest.approx(0.2)


# ------------------------------------------------------------------ tau and smoothness


@pytest.mark.parametrize("width", [3.0, 4.0, 5.0])
@pytest.mark.parametrize("dark", [False, True])
def test_the_width_of_an_edge_is_measured(width, dark):
    matrix = np.eye(4)
    matrix[:3, 3] = -32.0
    k, j, i = np.indices((65, 65, 65)) - 32.0
    away = np.clip((np.sqrt(i**2 + j**2 + k**2) - 20.0) / width + 0.5, 0.0, 1.0)
    ramp = 0.5 * (1.0 + np.cos(np.pi * away))
    array = 50.0 + 100.0 * (1.0 - ramp if dark else ramp)
    sphere = models.closed_organ((17, 11), axes=np.diag([20.0] * 3))
    found = edge_width(Sampler(Image(array, matrix)), sphere, np.eye(3))
    # Interpolation between voxels widens it a little.
    assert found == pytest.approx(width, rel=0.2)


def test_where_there_is_no_edge_there_is_no_width():
    flat = Image(np.full((40, 40, 40), 7.0), np.diag([2.0, 2.0, 2.0, 1.0]))
    sphere = models.closed_organ(axes=np.diag([15.0] * 3), center=(40.0, 40.0, 40.0))
    assert edge_width(Sampler(flat), sphere, 2.0 * np.eye(3)) is None


def test_tau_is_held_within_what_suits_mri(image):
    fit = finish(fit_organ(image, CENTER[None]))
    assert 2.0 * 1.2 <= fit.options.tau <= 3.0 * 1.2
    assert choices(fit)["tau"].value == f"{fit.options.tau:.2f} mm"
    assert choices(fit)["tau"].reasons[0].code.startswith("edge_width")


def test_more_noise_is_more_stiffness(dented):
    quiet, noisy = (finish(fit_organ(painted(dented, noise=noise), [[0.0, 0.0, 0.0]])) for noise in (5.0, 90.0))
    assert noisy.options.smoothness > quiet.options.smoothness
    assert [reason.code for reason in choices(noisy)["smoothness"].reasons] == ["noise_along_edge"]


# ------------------------------------------------------------------ the drift limit


def judged(surface):
    """Whether a surface is astray of the region of the small phantom's ellipsoid."""
    matrix = np.eye(4)
    matrix[:3, 3] = CENTER - 35.0
    k, j, i = np.indices((71, 71, 71))
    points = np.stack([i, j, k], axis=-1) - 35.0
    # Near the boundary about the signed distance from it.
    distance = 18.0 * (np.linalg.norm(points / [14.0, 18.0, 22.0], axis=-1) - 1.0)
    return astray(surface, Sampler(Image(distance, matrix)), ellipsoid().volume())


def test_a_surface_in_its_place_is_not_astray():
    assert judged(ellipsoid()) is None


@pytest.mark.parametrize(
    ("shift", "why"),
    [(12.0, "far_from_region"), (60.0, "left_surroundings")],
)
def test_a_surface_far_away_is(shift, why):
    matrix = np.array([[1, 0, 0, shift], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    assert judged(ellipsoid().transformed(matrix)).code == why


def test_a_folded_surface_is():
    net = ellipsoid().control_net.copy()
    net[:, [2, 4]] = net[:, [4, 2]]
    assert judged(ellipsoid().with_control_net(net)).code == "no_valid_solid"


def test_an_image_of_nothing_but_tissue_does_not_tear_a_surface_apart():
    # Blotches of 6 mm, no organ.
    random = np.random.default_rng(3).choice([60.0, 100.0, 160.0], (12, 12, 12))
    array = np.kron(random, np.ones((5, 5, 5))) + np.random.default_rng(4).normal(0.0, 5.0, (60, 60, 60))
    image = Image(array, np.eye(4))
    fit = finish(fit_region(image, region_from_box(image, [[18.0, 16.0, 14.0], [42.0, 44.0, 46.0]])))
    assert fit.problems == ()
    center, radii = np.array([30.0, 30.0, 30.0]), np.array([12.0, 14.0, 16.0])
    reach = np.linalg.norm((fit.confidence.points - center) / radii, axis=-1)
    # At most half a radius out of the box.
    assert reach.min() > 0.3
    assert reach.max() < 1.7
    hold = choices(fit).get("hold")
    assert hold is not None
    assert hold.value.endswith("times tighter")
    assert hold.reasons[-1].code == "held_tighter"
    # Two nets are held here: each stage has a name of its own, by which its steps are put together.
    names = [step.stage for step in fit.history]
    runs = [name for before, name in zip(["", *names], names) if name != before]
    assert len(runs) == len(set(runs))
    assert fit.confidence.unsupported_share > 0.3


def test_a_box_is_an_ellipsoid():
    image = Image(np.zeros((40, 40, 40)), np.eye(4))
    region = region_from_box(image, [[30.0, 5.0, 8.0], [10.0, 25.0, 32.0]])
    assert region.volume_ml == pytest.approx(4.0 / 3.0 * np.pi * 10.0 * 10.0 * 12.0 / 1000.0, rel=0.02)


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ([[0, 0, 0], [0, 5, 5]], "with a length, a width and a height"),
        ([[0, 0, 0]], "two opposite corners R, A, S in mm are needed"),
        ([[500, 500, 500], [520, 520, 520]], "holds no voxel of the image"),
    ],
)
def test_a_box_that_is_none_is_refused(corners, message):
    with pytest.raises(ValueError, match=message):
        region_from_box(Image(np.zeros((9, 9, 9)), np.eye(4)), corners)


def test_the_region_of_a_leak_is_not_taken_for_the_organ(image):
    # A bridge as wide as the organ into tissue as bright: what the seed sees tells how large the organ is.
    leaky = image.array.copy()
    leaky[:, :6, :] = 800
    region = separate(Image(leaky, image.ijk_to_ras), CENTER)
    assert region.volume_ml == pytest.approx(ellipsoid().volume() / 1000.0, rel=0.1)
