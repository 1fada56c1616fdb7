"""What is chosen for the fit of a generic model in the scene: its organs and landmarks, and the model itself."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


@pytest.fixture
def chosen(slicer_module):
    from VICRegistrationLib.mrml import generic_model

    return generic_model


def organ_of(logic, name):
    return next(organ for organ in logic.organs() if organ.label == name)


def test_one_organ_is_too_few(logic, fit_model, demo_volume, model_nodes):
    logic.organs().remove(organ_of(logic, "vagina"))
    with pytest.raises(ValueError, match="at least 2 are needed to place the model"):
        fit_model()
    assert model_nodes.findModel(demo_volume) is None


def test_an_organ_without_a_seed_is_refused_by_its_name(logic, fit_model):
    logic.organs().add("rectum")
    with pytest.raises(ValueError, match="rectum has no seed"):
        fit_model()


def test_an_organ_of_another_name_is_paired(logic, fit_model, demo_volume, chosen):
    organs, model = list(logic.organs()), chosen.modelNamed("pelvis")
    logic.organs().rename(organs[0], "Blase")
    assert set(chosen.pairedOrgans(model, organs)) == {"vagina"}
    chosen.pairOrgan("bladder", organs[0], organs, model)
    assert chosen.pairedOrgans(model, organs)["bladder"].label == "Blase"
    assert set(fit_model().organs) == {"bladder", "vagina"}


def test_an_organ_that_is_there_is_predicted_where_that_is_chosen(logic, demo_volume, chosen):
    organs, model = list(logic.organs()), chosen.modelNamed("pelvis")
    chosen.pairOrgan("bladder", None, organs, model)
    assert set(chosen.pairedOrgans(model, organs)) == {"vagina"}
    chosen.pairOrgan("rectum", organs[0], organs, model)
    assert {name: organ.label for name, organ in chosen.pairedOrgans(model, organs).items()} == {
        "vagina": "vagina",
        "rectum": "bladder",
    }


def test_capital_letters_make_no_difference(logic, demo_volume, chosen):
    organs, model = list(logic.organs()), chosen.modelNamed("pelvis")
    logic.organs().rename(organs[0], "Bladder")
    assert set(chosen.pairedOrgans(model, organs)) == {"bladder", "vagina"}


def test_the_net_of_an_organ_is_that_of_the_model(logic, fit_model):
    organ = organ_of(logic, "bladder")
    organ.netAutomatic, organ.netRows = False, 21
    assert fit_model().organs["bladder"].options.net == (17, 13)


def test_a_list_of_landmarks_has_their_names_and_no_places(demo_volume, chosen):
    model = chosen.modelNamed("pelvis")
    node = chosen.createLandmarks(model, demo_volume)
    labels = [node.GetNthControlPointLabel(index) for index in range(node.GetNumberOfControlPoints())]
    assert labels == list(model.landmarks)
    assert len(labels) == 6
    assert node.GetNumberOfUndefinedControlPoints() == 6
    assert chosen.placedLandmarks(node, demo_volume) == {}
    # Both are in the selector.
    assert chosen.createLandmarks(model, demo_volume).GetName() != node.GetName()


def test_landmarks_that_are_skipped_are_not_taken(demo_volume, chosen):
    node = chosen.createLandmarks(chosen.modelNamed("pelvis"), demo_volume)
    chosen.skipLandmark(node)
    assert chosen.nextLandmark(node) == 1
    node.SetNthControlPointPositionWorld(1, 1.0, 2.0, 3.0)
    assert list(chosen.placedLandmarks(node, demo_volume)) == [node.GetNthControlPointLabel(1)]
    for _ in range(9):
        chosen.skipLandmark(node)
    assert chosen.nextLandmark(node) is None
    assert chosen.landmarksText(node) == "1 of 6 placed, 5 skipped"


def test_landmarks_that_are_placed_pull_the_model(fit_model, demo_volume, chosen):
    model = chosen.modelNamed("pelvis")
    node, away = chosen.createLandmarks(model, demo_volume), np.array([0.0, -8.0, -6.0])
    node.SetNthControlPointPositionWorld(1, *(model.landmarks["coccyx, tip"] + away))
    found = fit_model(landmarks=node)
    assert list(found.landmarks) == ["coccyx, tip"]
    assert found.landmarks["coccyx, tip"] < 1.0


def test_landmarks_are_taken_in_the_frame_of_the_volume(demo_volume, chosen):
    matrix = motion(30, (1, 2, 3), (5, -8, 12))
    demo_volume.SetAndObserveTransformNodeID(mrml_scenes.add_linear_transform(matrix).GetID())
    node = chosen.createLandmarks(chosen.modelNamed("pelvis"), demo_volume)
    node.SetNthControlPointPositionWorld(0, *(matrix[:3, :3] @ [1.0, 2.0, 3.0] + matrix[:3, 3]))
    np.testing.assert_allclose(
        chosen.placedLandmarks(node, demo_volume)["symphysis, lower margin"], [1, 2, 3], atol=1e-9
    )


def test_a_landmark_that_is_none_of_the_model_s_is_refused(fit_model, demo_volume):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", "other")
    node.AddControlPoint(0.0, 0.0, 0.0, "hip")
    with pytest.raises(ValueError, match="no landmark 'hip'"):
        fit_model(landmarks=node)
    node.AddControlPoint(1.0, 0.0, 0.0, "hip")
    with pytest.raises(ValueError, match="landmark hip twice"):
        fit_model(landmarks=node)


@pytest.mark.parametrize(
    ("name", "message"), [("", "No file is chosen"), ("/nowhere/model.json", "choose a model file that exists")]
)
def test_a_model_that_is_not_there(fit_model, name, message):
    with pytest.raises(ValueError, match=message):
        fit_model(model=name)
