"""A generic model in the demo's MRI, whose organs are known."""

from __future__ import annotations

import numpy as np
import pytest
from model_organs import plain_organs

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.multipatch.organs import fit_organs
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.segmentation.separation import separate


@pytest.fixture(scope="session")
def pelvis_regions(pelvis):
    """Separated organs of the demo."""
    return {name: separate(pelvis.image, seeds) for name, seeds in pelvis.seeds.items()}


@pytest.fixture(scope="module")
def fitted(pelvis, pelvis_regions):
    """All steps of the fit of three organs, and what they came to."""
    steps = fit_organs(pelvis.image, plain_organs(), pelvis_regions, {name: FitOptions() for name in pelvis_regions})
    seen = []
    while True:
        try:
            seen.append(next(steps))
        except StopIteration as end:
            return seen, end.value


def test_organs_are_as_near_to_the_truth_as_when_each_is_fitted_alone(pelvis, fitted):
    _, found = fitted
    for name, truth in pelvis.surfaces.items():
        off = deviation(found.fits[name].surface, truth, n_points=2000)
        # The figures: 0.12 mm in the mean, and 1.5 mm at the worst point.
        assert off.mean < 0.12
        assert off.maximum < 1.5
        assert found.fits[name].problems == ()


def test_deformed_as_one_they_are_near_already(pelvis, fitted):
    _, found = fitted
    for name, truth in pelvis.surfaces.items():
        # Measured: 0.08 to 0.10 mm.
        assert deviation(found.together[name], truth, n_points=2000).mean < 0.15


def test_every_step_shows_all_organs(fitted):
    steps, found = fitted
    assert all(list(step.surfaces) == list(found.fits) for step in steps)
    stages = list(dict.fromkeys(step.stage for step in steps))
    assert stages[:3] == ["region", "grey levels, coarse", "grey levels, fine"]
    assert stages[3:] == [f"{name}, own control points" for name in found.fits]
    assert all(np.isfinite(step.cost) for step in steps)


def test_each_organ_is_a_fit_with_its_own_history(fitted):
    _, found = fitted
    for fit in found.fits.values():
        assert [step.stage for step in fit.history][-1] == "own control points"
        assert fit.history[-1].surface is fit.surface
        assert fit.converged
        assert fit.cost_final < fit.cost_initial
        assert [choice.option for choice in fit.choices] == ["net", "tau", "smoothness"]
        assert fit.options.net == (17, 13)


def test_the_demo_s_patient_is_the_model_itself(fitted):
    placement = fitted[1].placement
    assert placement.scale == pytest.approx(1.0, abs=0.02)
    assert placement.degrees < 3.0
