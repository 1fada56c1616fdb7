"""The demo's organs in thick slices and noise: how far the fitted surfaces are from the truth."""

from __future__ import annotations

import numpy as np
import pytest
from phantom_volumes import painted_with, volume_errors
from robustness import ALLOWED_MM, trials

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.phantoms.pelvis import pelvis_phantom
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.growing import grown_region

ORGANS = ("bladder", "vagina", "rectum")
# Asked for: 0.2 mm in the mean for the bladder, 0.3 mm for the others, 0.8 mm at 95 %. Measured: 0.07 to 0.08 and 0.11
# to 0.13 mm; at 95 %, 0.20 to 0.21 and 0.35 to 0.44 mm; signed, -0.05 to +0.01 mm.
MEAN_MM, SIGNED_MM = 0.16, 0.07
BLADDER_MEAN_MM = 0.12
P95_MM = {"bladder": 0.3, "vagina": 0.5, "rectum": 0.5}


def mostly_long(shorter, *others):
    """All organs, each with other parameters; all but one are left to the long tests."""
    return [pytest.param(organ, *others, marks=[pytest.mark.long] if organ != shorter else []) for organ in ORGANS]


@pytest.mark.parametrize("organ", ORGANS)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_an_organ_is_found_to_a_fraction_of_a_pixel(pelvis, pelvis_fit, organ, seed):
    # Another seed is other noise and other tissue.
    truth = pelvis_phantom(seed=seed) if seed else pelvis
    fit = finish(fit_organ(truth.image, truth.seeds[organ])) if seed else pelvis_fit(organ)
    found = deviation(fit.surface, truth.surfaces[organ])
    assert found.mean <= (BLADDER_MEAN_MM if organ == "bladder" else MEAN_MM)
    assert abs(found.mean_signed) <= SIGNED_MM
    assert found.p95 <= P95_MM[organ]
    # Half the organs' surface lies in slices of 4 mm; nowhere is it missed by half a slice. Measured: up to 1.12 mm.
    assert found.maximum <= 1.6
    assert fit.converged
    assert fit.problems == ()


@pytest.mark.parametrize(
    ("pixel", "slices", "percent"),
    [(0.7, 5.0, 0.9), *(pytest.param(*sizes, 0.7, marks=pytest.mark.long) for sizes in ((0.9, 2.0), (0.7, 4.0)))],
)
def test_volumes_do_not_depend_on_the_voxels(pixel, slices, percent):
    errors = volume_errors(painted_with(pixel, slices))
    # Measured: -0.5 to 0.1 %, and up to -0.8 % in slices of 5 mm; +0.9 % there without the fat behind walls. With a
    # ramp in place of partial volumes up to -1.3 % in slices of 4 mm.
    assert {organ for organ, error in errors.items() if abs(error) > percent} == set()


@pytest.mark.parametrize("organ", ORGANS)
def test_other_seeds_and_grey_levels_give_the_same_surface(pelvis, pelvis_fit, organ):
    found = trials(pelvis, organ, 2, np.random.default_rng(7), pelvis_fit(organ))
    assert found.failures == ()
    # Measured in 120 trials: 0.006 mm in the median, 0.041 mm at most.
    assert found.changes.max() < ALLOWED_MM


@pytest.mark.parametrize(
    ("organ", "options"),
    [*mostly_long("rectum", {"closure": "paper"}), *mostly_long("vagina", {"net": (17, 13)})],
)
def test_the_paper_s_closure_and_another_net_do_as_well(pelvis, organ, options):
    fit = finish(fit_organ(pelvis.image, pelvis.seeds[organ], FitOptions(**options)))
    found = deviation(fit.surface, pelvis.surfaces[organ], n_points=3000)
    # Measured: up to 0.13 mm with the paper's closure, 15 x 11; 0.12 with 17 x 13; -0.04 to +0.01 mm signed.
    assert found.mean <= MEAN_MM
    assert abs(found.mean_signed) <= SIGNED_MM
    assert fit.problems == ()


@pytest.mark.parametrize("organ", mostly_long("bladder"))
def test_the_paper_s_solver_does_as_well(pelvis, organ):
    fit = finish(fit_organ(pelvis.image, pelvis.seeds[organ], FitOptions(solver="gradient-descent")))
    found = deviation(fit.surface, pelvis.surfaces[organ], n_points=3000)
    # Descent stops a little short of the minimum along weakly determined directions. Measured: up to 0.13 mm, -0.08 mm.
    assert found.mean <= MEAN_MM
    assert abs(found.mean_signed) <= 0.11
    assert fit.problems == ()


@pytest.mark.parametrize("organ", mostly_long("vagina"))
def test_the_paper_s_settings_put_the_surface_at_the_inner_foot_of_the_ramp(pelvis, organ):
    fit = finish(fit_organ(pelvis.image, pelvis.seeds[organ], FitOptions.as_published()))
    found = deviation(fit.surface, pelvis.surfaces[organ], n_points=3000)
    # Half a ramp of 3 pixels of 0.59 mm is 0.89 mm. Measured: -1.01 mm signed in the vagina, as the paper's ramp does
    # not know that blur moves a curved edge inward.
    assert found.mean_signed == pytest.approx(-fit.options.tau / 2.0, abs=0.15)
    assert found.mean <= 1.05
    assert found.p95 <= 1.5
    assert fit.problems == ()
    assert fit.converged
    # As in the paper: nothing else ends a stage, and the control points take 38 to 150 iterations.
    last = [step for step in fit.history if step.stopped_by]
    assert [step.stopped_by for step in last] == ["parameters", "displacement", "displacement", "displacement"]
    assert 30 <= last[-1].iteration <= 300
    assert (fit.options.closure, fit.options.solver, fit.options.levels) == ("paper", "gradient-descent", "organ")


def test_the_grey_levels_of_a_refusal_are_in_the_image(pelvis):
    assert pelvis.image.array.min() >= 0.0
    with pytest.raises(ValueError, match="that is no organ") as refusal:
        grown_region(pelvis.image, np.array([[-30.0, 60.0, 20.0]]))
    assert "The grey levels 0 to " in str(refusal.value)
