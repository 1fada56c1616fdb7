"""A generic model in the demo's MRI, whose organs are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from VICRegistrationLib.analysis.distances import deviation
from VICRegistrationLib.multipatch.carrying import CarryingMap
from VICRegistrationLib.multipatch.check import check_model
from VICRegistrationLib.multipatch.fit import fit_model
from VICRegistrationLib.multipatch.pelvis import pelvis as generic_pelvis
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.steps import finish


@pytest.fixture(scope="module")
def generic():
    return generic_pelvis()


@pytest.fixture(scope="module")
def fitted(pelvis, pelvis_regions, generic):
    """All steps of the fit of three organs, and what they came to."""
    seen = []
    found = finish(fit_model(pelvis.image, generic, pelvis_regions), seen.append)
    return seen, found


def test_organs_are_as_near_to_the_truth_as_when_each_is_fitted_alone(pelvis, fitted):
    _, found = fitted
    for name, truth in pelvis.surfaces.items():
        off = deviation(found.organs[name].surface, truth, n_points=2000)
        # The figures: 0.12 mm in the mean, and 1.5 mm at the worst point.
        assert off.mean < 0.12
        assert off.maximum < 1.5
        assert found.organs[name].problems == ()


def test_deformed_as_one_they_are_near_already(pelvis, fitted):
    _, found = fitted
    for name, truth in pelvis.surfaces.items():
        # Measured: 0.08 to 0.10 mm.
        assert deviation(found.together[name], truth, n_points=2000).mean < 0.15


def test_every_step_shows_all_organs(fitted):
    steps, found = fitted
    assert all(list(step.surfaces) == list(found.organs) for step in steps)
    stages = list(dict.fromkeys(step.stage for step in steps))
    assert stages[:3] == ["region", "grey levels, coarse", "grey levels, fine"]
    own = ("region", "grey levels, coarse", "grey levels, fine")
    assert stages[3:] == [f"{name}, own control points, {stage}" for name in found.organs for stage in own]
    assert all(np.isfinite(step.cost) for step in steps)


def test_each_organ_is_a_fit_with_its_own_history(fitted):
    _, found = fitted
    for fit in found.organs.values():
        assert [step.stage for step in fit.history][-1] == "own control points, grey levels, fine"
        assert fit.history[-1].surface is fit.surface
        assert fit.converged
        assert fit.cost_final < fit.cost_initial
        assert [choice.option for choice in fit.choices] == ["net", "tau", "smoothness"]
        assert fit.options.net == (17, 13)


def test_the_demo_s_patient_is_the_model_itself(fitted):
    placement = fitted[1].placement
    assert placement.scale == pytest.approx(1.0, abs=0.02)
    assert placement.degrees < 3.0


def test_patches_that_share_points_share_them_afterwards(fitted, generic):
    carried = fitted[1].model
    assert carried.points.shape == generic.points.shape
    assert all(np.array_equal(a.indices, b.indices) for a, b in zip(carried.patches, generic.patches))
    for organ, fit in fitted[1].organs.items():
        place, matrix = carried.ranges()[organ], carried.organ_matrix(organ)
        assert np.array_equal(carried.points[place], matrix @ fit.surface.control_net.reshape(-1, 3))


def test_nothing_is_wrong_with_the_carried_model(fitted):
    assert check_model(fitted[1].model) == ()


def test_what_the_image_does_not_show_is_called_estimated(fitted, generic):
    found = fitted[1]
    others = tuple(part.name for part in generic.parts if part.kind != "organ")
    assert found.predicted == ()
    assert found.estimated == others
    assert {name for name in others if not found.model.part(name).estimated} == set()
    assert [diagnostic.code for diagnostic in found.diagnostics] == ["parts_estimated", "header_trusted"]
    assert "levator ani" in found.diagnostics[0].sentence()
    assert "header of the image is trusted" in found.diagnostics[1].sentence()


def test_ligaments_and_floor_of_the_model_s_own_pelvis_stay_where_they_are(fitted, generic):
    # The organs differ from the model's by their dents, of up to 9 mm; measured: 1.0 mm in the mean.
    off = np.linalg.norm(fitted[1].model.points - generic.points, axis=1)
    assert off[generic.first_free :].mean() < 2.0


def test_the_smallest_determinant_is_told_with_its_part(fitted):
    smallest, part = fitted[1].smallest_determinant
    assert 0.5 < smallest < 1.0
    assert part in [part.name for part in fitted[1].model.parts]


def test_attachments_slide_less_than_the_organs_own_control_points_move(fitted):
    sliding = fitted[1].sliding
    assert set(sliding) == set(fitted[1].estimated)
    # Measured: up to 0.6 mm.
    assert 0.0 < max(sliding.values()) < 0.8


@pytest.mark.long
def test_the_fine_model_is_fitted_as_exactly(pelvis, pelvis_regions):
    found = finish(fit_model(pelvis.image, generic_pelvis(fine=True), pelvis_regions))
    for name, fit in found.organs.items():
        # Measured: 0.03 to 0.10 mm.
        assert deviation(fit.surface, pelvis.surfaces[name], n_points=2000).mean < 0.12
        assert fit.problems == ()
    assert check_model(found.model) == ()


@pytest.fixture(scope="module")
def without_rectum(pelvis, pelvis_regions, generic):
    regions = {name: region for name, region in pelvis_regions.items() if name != "rectum"}
    return finish(fit_model(pelvis.image, generic, regions))


def test_an_organ_that_is_missing_is_predicted_and_called_so(pelvis, without_rectum):
    assert without_rectum.predicted == ("rectum",)
    assert without_rectum.model.part("rectum").labelled() == "rectum (estimated)"
    assert (
        without_rectum.diagnostics[0]
        .sentence()
        .startswith("The organ rectum was not given. The generic model predicts it")
    )
    assert without_rectum.model.parents["rectum"].closed
    # Measured: 0.5 mm here, where the patient is the model but for dents.
    assert deviation(without_rectum.model.parents["rectum"], pelvis.surfaces["rectum"], n_points=1000).mean < 1.5


def test_the_other_organs_do_not_suffer_from_a_missing_one(pelvis, without_rectum):
    for name, fit in without_rectum.organs.items():
        assert deviation(fit.surface, pelvis.surfaces[name], n_points=2000).mean < 0.12


def test_landmarks_pull_the_floor(pelvis, pelvis_regions, generic):
    away = np.array([0.0, -8.0, -6.0])
    marks = {name: point + away for name, point in generic.landmarks.items()}
    regions = {name: pelvis_regions[name] for name in ("bladder", "vagina")}
    found = finish(fit_model(pelvis.image, generic, regions, landmarks=marks))
    assert list(found.landmarks) == list(marks)
    assert max(found.landmarks.values()) < 5.0
    for name, point in marks.items():
        assert np.linalg.norm(found.model.landmarks[name] - point) == pytest.approx(found.landmarks[name])


def refused(pelvis, generic, regions, match, **options):
    with pytest.raises(ValueError, match=match):
        finish(fit_model(pelvis.image, generic, regions, **options))


def test_one_organ_is_too_few(pelvis, pelvis_regions, generic):
    refused(pelvis, generic, {"bladder": pelvis_regions["bladder"]}, "at least 2 are needed to place the model")


def test_an_organ_that_the_model_has_not_is_refused(pelvis, pelvis_regions, generic):
    regions = {**pelvis_regions, "uterus": pelvis_regions["rectum"]}
    refused(pelvis, generic, regions, "no organ 'uterus'; it has bladder, vagina, rectum")


def test_a_net_of_one_s_own_is_refused(pelvis, pelvis_regions, generic):
    options = {"bladder": FitOptions(net=(9, 7))}
    refused(pelvis, generic, pelvis_regions, "bladder: the option net was given", options=options)


def test_a_model_in_another_unit_is_refused(pelvis, pelvis_regions, generic):
    centimetres = {
        name: surface.transformed(np.diag([0.1, 0.1, 0.1, 1.0])) for name, surface in generic.parents.items()
    }
    model = generic.carried(centimetres, lambda points: 0.1 * points)
    refused(pelvis, model, pelvis_regions, r"10 times as large as the model's.*unit \(mm\)")


def test_a_model_in_lps_is_refused(pelvis, pelvis_regions, generic):
    turned = {name: surface.transformed(np.diag([-1.0, -1.0, 1.0, 1.0])) for name, surface in generic.parents.items()}
    model = generic.carried(turned, lambda points: points * (-1.0, -1.0, 1.0))
    refused(pelvis, model, pelvis_regions, "turned by 180 degrees against the model.*RAS or LPS")


def test_a_landmark_far_off_is_refused(pelvis, pelvis_regions, generic):
    marks = {"coccyx, tip": np.array([0.0, 64.0, -46.0])}
    refused(pelvis, generic, pelvis_regions, "'coccyx, tip' is 1[23][0-9] mm from", landmarks=marks)


def test_an_unknown_landmark_is_refused_with_the_known_names(pelvis, pelvis_regions, generic):
    marks = {"navel": np.zeros(3)}
    refused(pelvis, generic, pelvis_regions, "no landmark 'navel'; it has: symphysis, lower margin;", landmarks=marks)


def test_a_map_that_squeezes_space_is_told(fitted, generic):
    flat = {name: surface.transformed(np.diag([1.0, 1.0, 0.08, 1.0])) for name, surface in generic.parents.items()}
    squeezed = replace(fitted[1], carry=CarryingMap(generic.parents, flat))
    codes = [diagnostic.code for diagnostic in squeezed.diagnostics]
    assert "map_compresses" in codes
    assert "by the factor 0.08" in squeezed.diagnostics[codes.index("map_compresses")].sentence()


def test_a_cord_that_pierces_an_organ_is_told(fitted):
    found = fitted[1]
    points = found.model.points.copy()
    end = found.model.fixed["sacrum"]
    points[end] = points[end] * (0.0, 1.0, 1.0) + (0.0, 25.0, -20.0)
    pierced = replace(found, model=replace(found.model, points=points))
    sentences = [diagnostic.sentence() for diagnostic in pierced.diagnostics]
    assert any("uterosacral ligament passes through rectum" in sentence for sentence in sentences)
