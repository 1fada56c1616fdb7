"""What a fit chooses by itself, and why: the width of the edge and the smoothness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_phantom import CENTER
from test_nets import choices, painted

from VICRegistrationLib.geometry import models
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.registration.edge_width import edge_width
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish


def test_what_is_asked_for_is_done(small_image):
    fit = finish(fit_organ(small_image, CENTER[None], FitOptions(net=(9, 7), tau=2.5, smoothness=1e-4)))
    assert fit.options == replace(fit.options, net=(9, 7), tau=2.5, smoothness=1e-4)
    assert [choice.reasons for choice in fit.choices] == 3 * [(Diagnostic("option_given"),)]
    assert not [step for step in fit.history if "17x11" in step.stage]


@pytest.mark.parametrize(("width", "dark"), [(3.0, False), (5.0, True)])
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


def test_tau_is_held_within_what_suits_mri(small_fit):
    assert 2.0 * 1.2 <= small_fit.options.tau <= 3.0 * 1.2
    assert choices(small_fit)["tau"].value == f"{small_fit.options.tau:.2f} mm"
    assert choices(small_fit)["tau"].reasons[0].code.startswith("edge_width")


def test_more_noise_is_more_stiffness():
    organ = models.closed_organ(axes=np.diag([20.0, 20.0, 24.0]))
    quiet, noisy = (
        finish(fit_organ(painted(organ, noise=noise), [[0.0, 0.0, 0.0]], FitOptions(net=(9, 7))))
        for noise in (5.0, 90.0)
    )
    assert noisy.options.smoothness > quiet.options.smoothness
    assert [reason.code for reason in choices(noisy)["smoothness"].reasons] == ["noise_along_edge"]
