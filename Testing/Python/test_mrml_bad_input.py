"""What cannot be used is refused in one sentence: what was given, what is needed, what to do; and nothing is added."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from small_phantom import CENTER

from VICRegistrationLib.imaging.image import Image

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


@pytest.fixture
def refused(logic, scene):
    """Fit what must be refused; returns the message after looking that the scene is as it was."""

    def fit(*arguments, **options):
        parameters = logic.getParameterNode()
        before = mrml_scenes.content(scene)
        current = parameters.current
        with pytest.raises(ValueError, match=r"\S") as caught:
            logic.fit(*arguments, **options)
        assert mrml_scenes.content(scene) == before
        assert len(logic.organs()) == len([node for node in parameters.organs if node is not None])
        assert logic.getParameterNode().current is current
        message = str(caught.value)
        # One or two sentences in plain words.
        assert message[0].isupper() or message.startswith("mri: ")
        assert message.endswith(".")
        assert "Traceback" not in message
        return message

    return fit


def test_no_volume(refused):
    assert "No volume is chosen" in refused(None, [CENTER])


def test_a_volume_that_was_removed(refused, scene):
    volume = mrml_scenes.add_volume()
    scene.RemoveNode(volume)
    assert "No volume is chosen" in refused(volume, [CENTER])


def test_a_volume_without_voxels(refused, scene):
    volume = scene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "mri")
    assert "volume mri holds no voxels" in refused(volume, [CENTER])


def test_a_volume_of_colours(refused, scene):
    colours = np.zeros((4, 5, 6, 3), dtype=np.uint8)
    volume = slicer.util.addVolumeFromArray(colours, name="mri", nodeClassName="vtkMRMLVectorVolumeNode")
    message = refused(volume, [CENTER])
    assert "3 values in every voxel" in message
    assert "Vector to Scalar Volume" in message


@pytest.mark.parametrize("node", ["vtkMRMLModelNode", "vtkMRMLTransformNode", "vtkMRMLMarkupsFiducialNode"])
def test_a_node_that_is_no_volume(refused, scene, node):
    assert "The input thing is no volume" in refused(scene.AddNewNodeByClass(node, "thing"), [CENTER])


def test_the_name_of_a_volume_instead_of_its_node(refused):
    assert "input 'mri' is no volume" in refused("mri", [CENTER])


def test_a_single_slice(refused):
    image = mrml_scenes.mri()
    volume = slicer.util.addVolumeFromArray(image.array[11:12].copy(), ijkToRAS=image.ijk_to_ras, name="mri")
    assert "52 x 56 x 1 voxels" in refused(volume, [CENTER])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_voxels_that_are_no_numbers(refused, value):
    image = mrml_scenes.mri()
    volume = mrml_scenes.add_volume(Image(image.array.astype(float), image.ijk_to_ras))
    slicer.util.arrayFromVolume(volume)[3, 4, 5] = value
    message = refused(volume, [CENTER])
    assert message.startswith("mri: 1 of the image's")
    assert "Replace them" in message


def test_a_seed_outside_of_the_volume(refused):
    assert "lies outside the volume" in refused(mrml_scenes.add_volume(), [CENTER, CENTER + 100.0])


@pytest.mark.parametrize("seeds", [[], np.empty((0, 3)), None])
def test_no_seeds(refused, seeds):
    assert "organ has no seed. Place a point" in refused(mrml_scenes.add_volume(), seeds)


def test_a_list_without_placed_points(refused, scene):
    volume = mrml_scenes.add_volume()
    markups = scene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode")
    assert "has no seed" in refused(volume, markups)


@pytest.mark.parametrize(
    "seeds", [[[1, 2]], [1, 2, 3, 4], "seed", [[np.nan, 0, 0]], [[[1, 2, 3]]], [["a", "b", "c"]], 7]
)
def test_seeds_that_are_no_points(refused, seeds):
    assert "each needs three finite coordinates in RAS mm" in refused(mrml_scenes.add_volume(), seeds)


@pytest.mark.parametrize("thresholds", [(1000, 600), (600,), (1, 2, 3), "ab", 5, (np.nan, 1000), (None, None)])
def test_thresholds_that_are_no_range(refused, thresholds):
    message = refused(mrml_scenes.add_volume(), [CENTER], thresholds)
    assert f"The threshold is {thresholds!r}; it must be two numbers LOW,HIGH" in message


def test_a_threshold_without_the_seed(refused):
    assert "threshold" in refused(mrml_scenes.add_volume(), [CENTER], (0, 300))


@pytest.mark.parametrize("erosion", [-1.0, 25.0, np.nan, "much"])
def test_an_erosion_that_makes_no_sense(refused, erosion):
    message = refused(mrml_scenes.add_volume(), [CENTER], erosion=erosion)
    assert f"The erosion is {erosion!r}; it must be a number from 0 to 20 mm." in message


@pytest.mark.parametrize("points", [[[1, 2]], "wall", [[np.inf, 0, 0]]])
def test_boundary_points_that_are_no_points(refused, points):
    assert "three finite coordinates" in refused(mrml_scenes.add_volume(), [CENTER], boundaryPoints=points)


def test_a_refusal_keeps_the_organs_there_are(logic, refused):
    volume = mrml_scenes.add_volume()
    kept = [logic.fit(volume, [CENTER], name=name) for name in ("bladder", "vagina")]
    logic.getParameterNode().current = kept[0].parameterNode
    nets = [logic.surface(organ).control_net for organ in kept]
    refused(volume, [CENTER + 100.0])
    assert [organ.label for organ in logic.organs()] == ["bladder", "vagina"]
    for organ, net in zip(kept, nets):
        np.testing.assert_array_equal(logic.surface(organ).control_net, net)
        assert mrml_scenes.segment_voxels(organ, volume).any()


def test_a_surface_is_asked_for_before_there_is_one(logic):
    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER])
    with pytest.raises(ValueError, match="no surface yet.*Fit it first"):
        logic.surface(organ)


def test_a_model_that_carries_no_surface(logic, scene):
    from VICRegistrationLib.mrml.surfaces import surfaceFromModel

    model = scene.AddNewNodeByClass("vtkMRMLModelNode", "mesh")
    with pytest.raises(ValueError, match="model mesh is empty"):
        surfaceFromModel(model)
    model.SetAndObservePolyData(mrml_scenes.true_triangles(np.asarray))
    with pytest.raises(ValueError, match="model mesh lacks degrees.*fit the organ"):
        surfaceFromModel(model)


def test_a_refit_without_a_volume(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER])
    slicer.mrmlScene.RemoveNode(logic.getParameterNode().volume)
    with pytest.raises(ValueError, match="No volume is chosen"):
        logic.refit(organ)


def test_deviations_without_a_volume_are_none(logic):
    from VICRegistrationLib.mrml.fitting import boundaryDeviations

    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], boundaryPoints=[CENTER])
    assert len(boundaryDeviations(organ, None)) == 0
