"""Control nets: where they begin, how fine they become, and why."""

from __future__ import annotations

import numpy as np
import pytest
import random_organs

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry import models, parametrization
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.finer_nets import first_net, noise_share
from VICRegistrationLib.registration.nets import net_of
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.steps import finish

pytestmark = pytest.mark.usefixtures("grown_regions")


def choices(fit):
    return {choice.option: choice for choice in fit.choices}


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


@pytest.fixture(scope="module")
def volume(dented):
    return painted(dented)


@pytest.fixture(scope="module")
def chosen(volume):
    """A fit to that organ, whose net is chosen."""
    return finish(fit_organ(volume, [[0.0, 0.0, 0.0]]))


def test_detail_makes_the_net_finer_and_the_reason_is_told(chosen):
    assert chosen.options.net == (17, 11)
    net = choices(chosen)["net"]
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


def test_the_finer_net_keeps_the_smooth_closure(volume, chosen):
    parametrization.closed_organ(chosen.surface, closure="smooth")
    again = finish(refit(volume, chosen.surface))
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


def test_a_given_net_is_fitted_as_one_that_was_chosen(volume, chosen):
    given = finish(fit_organ(volume, [[0.0, 0.0, 0.0]], FitOptions(net=(17, 11))))
    assert choices(given)["net"].reasons == (Diagnostic("option_given"),)
    np.testing.assert_allclose(given.surface.control_net, chosen.surface.control_net, atol=1e-9)


def test_noise_takes_a_share_of_the_cost():
    # 300 degrees of freedom move 100 places along the normal.
    assert noise_share(300, 1000.0) == pytest.approx(0.1)
    assert noise_share(300, 500.0) == pytest.approx(0.2)
