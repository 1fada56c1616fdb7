"""A generic model in the scene: what it is fitted to, its parts, and what becomes of it."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mrml_boot
import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.geometry.surface_file import read_surface
from VICRegistrationLib.multipatch.colours import patch_colours
from VICRegistrationLib.multipatch.file import read_model, write_model
from VICRegistrationLib.multipatch.pelvis import pelvis as generic_pelvis

pytestmark = pytest.mark.usefixtures("cached_fits")


@pytest.fixture
def volume(logic, pelvis):
    """The demo's MRI with two of its organs in the table; nothing is separated yet."""
    from VICRegistrationLib.mrml.organ_nodes import seedsOf
    from VICRegistrationLib.mrml.points import addPoints

    node = mrml_scenes.add_volume(pelvis.image)
    logic.getParameterNode().volume = node
    for name in ("bladder", "vagina"):
        addPoints(seedsOf(logic.organs().add(name), node), pelvis.seeds[name])
    return node


@pytest.fixture
def parameters(logic):
    from VICRegistrationLib.mrml.generic_model import GenericModelParameters

    return GenericModelParameters(logic.getParameterNode().parameterNode)


@pytest.fixture
def fit(logic, volume):
    """Function that fits the model that ships."""
    from VICRegistrationLib.mrml.generic_model_fit import fitModel

    return lambda **choices: fitModel(logic.getParameterNode(), volume, **choices)


@pytest.fixture
def steps(logic, volume, parameters):
    """Function that begins a fit."""
    from VICRegistrationLib.mrml.generic_model_fit import modelSteps

    return lambda: modelSteps(parameters, logic.organs(), volume)


@pytest.fixture
def nodes(slicer_module):
    from VICRegistrationLib.mrml import generic_model_nodes

    return generic_model_nodes


@pytest.fixture
def chosen(slicer_module):
    from VICRegistrationLib.mrml import generic_model

    return generic_model


def run_until(steps, words):
    """Run a fit until a step says these words."""
    while words not in next(steps):
        pass


def organ_of(logic, name):
    return next(organ for organ in logic.organs() if organ.label == name)


def test_every_part_is_a_model_in_one_folder(fit, volume, nodes):
    found = fit()
    text = nodes.findModel(volume)
    hierarchy = slicer.mrmlScene.GetSubjectHierarchyNode()
    folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(text))
    assert hierarchy.GetItemName(folder) == text.GetName() == "mri (generic model)"
    parts = nodes.partsOf(volume)
    assert {hierarchy.GetItemParent(hierarchy.GetItemByDataNode(node)) for node in parts} == {folder}
    assert hierarchy.GetNumberOfItemChildren(folder) == 1 + len(found.model.parts)


def test_what_the_image_does_not_show_is_called_so_and_translucent(fit, volume, nodes):
    fit()
    parts = {node.GetName(): node for node in nodes.partsOf(volume)}
    seen = {name for name in parts if "(" not in name}
    assert seen == {"bladder", "vagina"}
    assert {"rectum (predicted)", "levator ani (estimated)"} < set(parts)
    opaque = {name for name, node in parts.items() if node.GetDisplayNode().GetOpacity() == 1.0}
    assert opaque == seen


def test_the_message_has_figures_and_what_to_know(fit, volume, nodes):
    found = fit()
    lines = nodes.messageOf(volume).split("\n")
    assert lines[0].startswith("Model fitted to bladder, vagina in ")
    assert f"{found.smallest_determinant[0]:.2f}, near {found.smallest_determinant[1]}" in lines[1]
    assert sum("organ rectum was not given; it is predicted" in line for line in lines) == 1
    assert sum(line.startswith("Estimated by the generic model, not seen in the image") for line in lines) == 1


def test_points_on_the_wall_are_said_not_to_be_used(fit, logic, volume, nodes):
    from VICRegistrationLib.mrml.organ_nodes import boundaryPointsOf

    fit()
    assert "not used" not in nodes.messageOf(volume)
    boundaryPointsOf(organ_of(logic, "vagina"), volume).AddControlPointWorld(0.0, 0.0, 0.0)
    fit()
    lines = nodes.messageOf(volume).split("\n")
    assert "vagina: its points on the wall are not used by the fit of a model." in lines


def test_organs_are_fitted_to_further_stacks(fit, logic, volume, nodes, pelvis):
    brighter = dataclasses.replace(pelvis.image, array=pelvis.image.array + 1)
    logic.getParameterNode().furtherStacks = [mrml_scenes.add_volume(brighter, name="again")]
    found = fit()
    # The same image a second time, brighter, for the very same would be refused: nothing has moved.
    for organ in found.organs.values():
        (stack,) = organ.stacks
        assert stack.used
        assert np.linalg.norm(stack.translation_mm) < 0.1
    # Measured: 0.1 degrees for the bladder, which is nearly round.
    assert re.search(r"bladder 0\.0 mm, 0\.[01] degrees in again", nodes.messageOf(volume))


def test_a_stack_under_a_transform_that_bends_is_left_out(fit, logic, volume, nodes, pelvis):
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    logic.getParameterNode().furtherStacks = [mrml_scenes.add_volume(pelvis.image, name="bent", under=bent)]
    assert fit().organs["bladder"].stacks == ()
    assert "The stack bent was left out." in nodes.messageOf(volume)


def test_a_stack_is_deleted_meanwhile(logic, steps, pelvis, scene):
    stack = mrml_scenes.add_volume(pelvis.image, name="again")
    logic.getParameterNode().furtherStacks = [stack]
    running = steps()
    run_until(running, "vagina: separating")
    scene.RemoveNode(stack)
    with pytest.raises(ValueError, match="stack again was deleted"):
        next(running)


def test_the_fills_of_its_organs_are_hidden(fit, logic):
    fit()
    for organ in logic.organs():
        assert not organ.regions.GetDisplayNode().GetSegmentVisibility(organ.regionSegmentId)


def test_the_scene_holds_the_model_bit_for_bit(fit, volume, nodes):
    found = fit()
    held = nodes.modelOfVolume(volume)
    assert held.points.tobytes() == found.model.points.tobytes()
    assert [part.labelled() for part in held.parts] == [part.labelled() for part in found.model.parts]


def test_parts_lie_on_their_patches(fit, volume, nodes):
    found = fit()
    node = next(node for node in nodes.partsOf(volume) if node.GetName() == "bladder")
    points = slicer.util.arrayFromModelPoints(node)
    net = found.model.parents["bladder"].control_net.reshape(-1, 3)
    assert np.all(points >= net.min(axis=0) - 1e-6)
    assert np.all(points <= net.max(axis=0) + 1e-6)
    assert node.GetPolyData().GetPointData().GetNormals() is not None


def test_fitting_again_replaces_what_the_folder_holds(fit, volume, nodes, scene):
    fit()
    content = mrml_scenes.content(scene)
    nodes.removeNodes(nodes.partsOf(volume)[3:4])
    fit()
    assert len(mrml_scenes.content(scene)) == len(content)
    assert len(nodes.partsOf(volume)) == len(generic_pelvis().parts)


def test_parts_outlive_their_text_and_are_taken_again(fit, volume, nodes):
    found = fit()
    nodes.removeNodes([nodes.findModel(volume)])
    with pytest.raises(ValueError, match="no fitted model yet"):
        nodes.modelOfVolume(volume)
    fit()
    assert len(nodes.partsOf(volume)) == len(found.model.parts)


def test_another_model_leaves_no_part_of_the_one_before(fit, volume, nodes, tmp_path):
    fit()
    model = generic_pelvis()
    write_model(_without(model, "levator ani"), tmp_path / "smaller & other.json")
    fit(model=str(tmp_path / "smaller & other.json"))
    names = [node.GetName() for node in nodes.partsOf(volume)]
    assert len(names) == len(model.parts) - 1
    assert "levator ani (estimated)" not in names


def _without(model, name):
    from dataclasses import replace

    patches = tuple(patch for patch in model.patches if patch.part != name)
    return replace(model, patches=patches, parts=tuple(part for part in model.parts if part.name != name))


@pytest.mark.parametrize("words", ["vagina: separating", "region", "own control points", "Determinant", "Showing"])
def test_a_fit_that_is_cancelled_leaves_the_earlier_result(fit, steps, volume, nodes, scene, words):
    fit()
    text, content = nodes.findModel(volume).GetText(), mrml_scenes.content(scene)
    before = [node.GetPolyData() for node in nodes.partsOf(volume)]
    running = steps()
    run_until(running, words)
    running.close()
    assert nodes.findModel(volume).GetText() == text
    assert mrml_scenes.content(scene) == content
    assert [node.GetPolyData() for node in nodes.partsOf(volume)] == before


@pytest.mark.parametrize("words", ["vagina: separating", "grey levels, fine", "Sliding"])
def test_an_organ_is_deleted_meanwhile(logic, steps, volume, nodes, scene, words):
    running = steps()
    run_until(running, words)
    logic.organs().remove(organ_of(logic, "vagina"))
    content = mrml_scenes.content(scene)
    with pytest.raises(ValueError, match=r"organ vagina was deleted.*Fit the model again"):
        next(running)
    assert nodes.findModel(volume) is None
    assert mrml_scenes.content(scene) == content


def test_the_volume_is_deleted_meanwhile(steps, volume, scene):
    running = steps()
    run_until(running, "region")
    scene.RemoveNode(volume)
    with pytest.raises(ValueError, match="volume mri was deleted"):
        next(running)


def test_one_organ_is_too_few(logic, fit, volume, nodes):
    logic.organs().remove(organ_of(logic, "vagina"))
    with pytest.raises(ValueError, match="at least 2 are needed to place the model"):
        fit()
    assert nodes.findModel(volume) is None


def test_an_organ_without_a_seed_is_refused_by_its_name(logic, fit):
    logic.organs().add("rectum")
    with pytest.raises(ValueError, match="rectum has no seed"):
        fit()


def test_an_organ_of_another_name_is_paired(logic, fit, volume, chosen, parameters):
    organs, model = list(logic.organs()), chosen.modelNamed("pelvis")
    logic.organs().rename(organs[0], "Blase")
    assert set(chosen.pairedOrgans(model, organs)) == {"vagina"}
    chosen.pairOrgan("bladder", organs[0], organs, model)
    assert chosen.pairedOrgans(model, organs)["bladder"].label == "Blase"
    assert set(fit().organs) == {"bladder", "vagina"}


def test_an_organ_that_is_there_is_predicted_where_that_is_chosen(logic, volume, chosen):
    organs, model = list(logic.organs()), chosen.modelNamed("pelvis")
    chosen.pairOrgan("bladder", None, organs, model)
    assert set(chosen.pairedOrgans(model, organs)) == {"vagina"}
    chosen.pairOrgan("rectum", organs[0], organs, model)
    assert {name: organ.label for name, organ in chosen.pairedOrgans(model, organs).items()} == {
        "vagina": "vagina",
        "rectum": "bladder",
    }


def test_capital_letters_make_no_difference(logic, volume, chosen):
    organs, model = list(logic.organs()), chosen.modelNamed("pelvis")
    logic.organs().rename(organs[0], "Bladder")
    assert set(chosen.pairedOrgans(model, organs)) == {"bladder", "vagina"}


def test_the_net_of_an_organ_is_that_of_the_model(logic, fit):
    organ = organ_of(logic, "bladder")
    organ.netAutomatic, organ.netRows = False, 21
    assert fit().organs["bladder"].options.net == (17, 13)


def test_a_list_of_landmarks_has_their_names_and_no_places(volume, chosen):
    model = chosen.modelNamed("pelvis")
    node = chosen.createLandmarks(model, volume)
    labels = [node.GetNthControlPointLabel(index) for index in range(node.GetNumberOfControlPoints())]
    assert labels == list(model.landmarks)
    assert len(labels) == 6
    assert node.GetNumberOfUndefinedControlPoints() == 6
    assert chosen.placedLandmarks(node, volume) == {}
    # Both are in the selector.
    assert chosen.createLandmarks(model, volume).GetName() != node.GetName()


def test_landmarks_that_are_skipped_are_not_taken(volume, chosen):
    node = chosen.createLandmarks(chosen.modelNamed("pelvis"), volume)
    chosen.skipLandmark(node)
    assert chosen.nextLandmark(node) == 1
    node.SetNthControlPointPositionWorld(1, 1.0, 2.0, 3.0)
    assert list(chosen.placedLandmarks(node, volume)) == [node.GetNthControlPointLabel(1)]
    for _ in range(9):
        chosen.skipLandmark(node)
    assert chosen.nextLandmark(node) is None
    assert chosen.landmarksText(node) == "1 of 6 placed, 5 skipped"


def test_landmarks_that_are_placed_pull_the_model(fit, volume, chosen):
    model = chosen.modelNamed("pelvis")
    node, away = chosen.createLandmarks(model, volume), np.array([0.0, -8.0, -6.0])
    node.SetNthControlPointPositionWorld(1, *(model.landmarks["coccyx, tip"] + away))
    found = fit(landmarks=node)
    assert list(found.landmarks) == ["coccyx, tip"]
    assert found.landmarks["coccyx, tip"] < 1.0


def test_landmarks_are_taken_in_the_frame_of_the_volume(volume, chosen):
    matrix = motion(30, (1, 2, 3), (5, -8, 12))
    volume.SetAndObserveTransformNodeID(mrml_scenes.add_linear_transform(matrix).GetID())
    node = chosen.createLandmarks(chosen.modelNamed("pelvis"), volume)
    node.SetNthControlPointPositionWorld(0, *(matrix[:3, :3] @ [1.0, 2.0, 3.0] + matrix[:3, 3]))
    np.testing.assert_allclose(chosen.placedLandmarks(node, volume)["symphysis, lower margin"], [1, 2, 3], atol=1e-9)


def test_a_landmark_that_is_none_of_the_model_s_is_refused(fit, volume):
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", "other")
    node.AddControlPoint(0.0, 0.0, 0.0, "hip")
    with pytest.raises(ValueError, match="no landmark 'hip'"):
        fit(landmarks=node)
    node.AddControlPoint(1.0, 0.0, 0.0, "hip")
    with pytest.raises(ValueError, match="landmark hip twice"):
        fit(landmarks=node)


def test_patches_are_coloured_on_demand(fit, volume, nodes):
    found = fit()
    assert not nodes.isColoredByPatch(volume)
    nodes.colorByPatch(volume, True)
    assert nodes.isColoredByPatch(volume)
    display = next(node for node in nodes.partsOf(volume) if node.GetName() == "bladder").GetDisplayNode()
    table = display.GetColorNode()
    names = [table.GetColorName(number) for number in range(1, table.GetNumberOfColors())]
    assert names == [patch.name for patch in found.model.patches]
    data = display.GetInputMesh().GetCellData()
    numbers = np.unique(vtk_to_numpy(data.GetArray(display.GetActiveScalarName())))
    assert [names[number - 1].split()[0] for number in numbers] == ["bladder"] * 30
    # Or organs would be drawn as translucent.
    assert table.GetLookupTable().IsOpaque()
    # Shades repeat, but not for neighbours.
    shades = {tuple(table.GetLookupTable().GetTableValue(int(number))) for number in numbers}
    assert 2 <= len(shades) < 30
    # A new fit is shown as the one before.
    fit()
    assert nodes.isColoredByPatch(volume)
    nodes.colorByPatch(volume, False)
    assert not nodes.isColoredByPatch(volume)


def test_a_deleted_table_of_colours_is_not_complained_of(fit, volume, nodes, scene, vtk_messages):
    fit()
    nodes.colorByPatch(volume, True)
    (part, *_others) = nodes.partsOf(volume)
    assert part.GetDisplayNode().GetScalarRange() == (0.0, scene_colors(part).GetNumberOfColors() - 1)
    scene.RemoveNode(scene_colors(part))
    part.GetDisplayNode().Modified()
    part.Modified()
    assert vtk_messages() == ""


def scene_colors(part):
    """Table that a part is coloured by."""
    return part.GetDisplayNode().GetColorNode()


def test_a_scene_that_is_saved_holds_everything(fit, volume, nodes, chosen, logic, scene, tmp_path):
    node = chosen.createLandmarks(chosen.modelNamed("pelvis"), volume)
    node.SetNthControlPointPositionWorld(1, 0.0, -66.0, -48.0)
    organs = list(logic.organs())
    chosen.pairOrgan("rectum", None, organs, chosen.modelNamed("pelvis"))
    found, message = fit(landmarks=node), nodes.messageOf(volume)
    nodes.colorByPatch(volume, True)
    slicer.util.saveScene(str(tmp_path / "scene.mrb"))
    mrml_boot.clear(scene)
    slicer.util.loadScene(str(tmp_path / "scene.mrb"))
    loaded = slicer.util.getNode("mri")
    assert nodes.modelOfVolume(loaded).points.tobytes() == found.model.points.tobytes()
    assert nodes.messageOf(loaded) == message
    assert nodes.isColoredByPatch(loaded)
    table = nodes.partsOf(loaded)[0].GetDisplayNode().GetColorNode()
    assert table.GetNumberOfColors() == 1 + len(found.model.patches)
    wanted = list(patch_colours(found.model).values())
    kept = [table.GetLookupTable().GetTableValue(number)[:3] for number in range(1, table.GetNumberOfColors())]
    np.testing.assert_allclose(kept, wanted, atol=1.0 / 255.0)
    assert table.GetLookupTable().GetRange() == (0.0, len(found.model.patches))
    assert len(nodes.partsOf(loaded)) == len(found.model.parts)
    kept = chosen.GenericModelParameters(logic.getParameterNode().parameterNode)
    assert kept.modelName == "pelvis"
    assert kept.modelLandmarks.GetNumberOfUndefinedControlPoints() == 5
    assert list(chosen.placedLandmarks(kept.modelLandmarks, loaded)) == ["coccyx, tip"]
    assert set(chosen.pairedOrgans(chosen.modelNamed("pelvis"), logic.organs())) == {"bladder", "vagina"}


def test_files_are_those_of_the_command_line(fit, volume, tmp_path):
    from VICRegistrationLib.mrml.generic_model_export import exportModel

    found = fit()
    paths, problem = exportModel(volume, tmp_path / "new")
    assert problem == ""
    names = ["model.json", "model.step", "model.vtp", "bladder.json", "vagina.json"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(names)
    assert read_model(paths[0]).points.tobytes() == found.model.points.tobytes()
    assert read_surface(paths[3]).control_net.tobytes() == found.organs["bladder"].surface.control_net.tobytes()


def test_files_are_written_where_the_model_lies(fit, volume, nodes):
    found, matrix = fit(), motion(30, (1, 2, 3), (5, -8, 12))
    transform = mrml_scenes.add_linear_transform(matrix)
    volume.SetAndObserveTransformNodeID(transform.GetID())
    nodes.followVolumeWithModel(volume)
    wanted = found.model.points @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(nodes.modelOfVolume(volume).points, wanted, atol=1e-9)
    # Hardened on the volume, the parts are moved for good, and the model with them.
    volume.HardenTransform()
    nodes.followVolumeWithModel(volume)
    assert nodes.partsOf(volume)[0].GetParentTransformNode() is None
    np.testing.assert_allclose(nodes.modelOfVolume(volume).points, wanted, atol=1e-3)


def test_a_transform_that_mirrors_or_bends_is_refused(fit, volume, nodes):
    fit()
    volume.SetAndObserveTransformNodeID(mrml_scenes.add_linear_transform(np.diag([-1.0, 1, 1, 1])).GetID())
    with pytest.raises(ValueError, match="mirrors"):
        nodes.modelOfVolume(volume)
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    volume.SetAndObserveTransformNodeID(bent.GetID())
    with pytest.raises(ValueError, match="bends"):
        nodes.modelOfVolume(volume)


def test_parts_that_another_module_has_changed_are_refused(fit, volume, nodes):
    fit()
    part = nodes.partsOf(volume)[0]
    slicer.util.arrayFromModelPoints(part)[:] *= 1.01
    with pytest.raises(ValueError, match="Fit the model again"):
        nodes.modelOfVolume(volume)


def test_without_a_fit_nothing_is_exported(volume, tmp_path, slicer_module):
    from VICRegistrationLib.mrml.generic_model_export import exportModel

    with pytest.raises(ValueError, match="no fitted model yet"):
        exportModel(volume, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("name", "message"), [("", "No file is chosen"), ("/nowhere/model.json", "choose a model file that exists")]
)
def test_a_model_that_is_not_there(fit, name, message):
    with pytest.raises(ValueError, match=message):
        fit(model=name)


def test_a_volume_without_a_model_says_nothing(volume, nodes):
    assert nodes.findModel(None) is None
    assert nodes.messageOf(volume) == ""
    assert nodes.partsOf(None) == []


def test_the_lines_for_the_python_console(slicer_module, pelvis, monkeypatch, capsys):
    monkeypatch.setattr("VICRegistrationLib.phantoms.pelvis.pelvis_phantom", lambda: pelvis)
    page = (Path(__file__).resolve().parents[2] / "docs" / "generic-model.md").read_text(encoding="utf-8")
    (block,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "fitModel" in block)
    exec(block, {})
    assert capsys.readouterr().out.startswith("ModelFit(2 organs fitted, 1 predicted, 11 parts estimated")


def test_a_scene_that_is_added_to_another_keeps_its_own_model(fit, volume, nodes, tmp_path):
    found = fit()
    slicer.util.saveScene(str(tmp_path / "scene.mrb"))
    # The one that is there goes elsewhere, and the loaded one stays.
    volume.SetName("first")
    volume.SetAndObserveTransformNodeID(mrml_scenes.add_linear_transform(motion(10, (0, 0, 1), (9, 0, 0))).GetID())
    nodes.followVolumeWithModel(volume)
    slicer.util.loadScene(str(tmp_path / "scene.mrb"))
    loaded = slicer.util.getNode("mri")
    assert loaded is not volume
    assert nodes.findModel(loaded) is not nodes.findModel(volume)
    assert nodes.modelOfVolume(loaded).points.tobytes() == found.model.points.tobytes()
    assert len(nodes.partsOf(loaded)) == len(nodes.partsOf(volume)) == len(found.model.parts)
    nodes.colorByPatch(loaded, True)
    assert nodes.isColoredByPatch(loaded)
    assert not nodes.isColoredByPatch(volume)
