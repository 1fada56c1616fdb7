"""Nodes of a fitted generic model: its parts, their colours, transforms above them, saved scenes and files."""

from __future__ import annotations

import mrml_boot
import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from vtk.util.numpy_support import vtk_to_numpy

from VICRegistrationLib.geometry.surface_file import read_surface
from VICRegistrationLib.multipatch.colours import patch_colours
from VICRegistrationLib.multipatch.file import read_model

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")


@pytest.fixture
def chosen(slicer_module):
    from VICRegistrationLib.mrml import generic_model

    return generic_model


def test_every_part_is_a_model_in_one_folder(fit_model, demo_volume, model_nodes):
    found = fit_model()
    text = model_nodes.findModel(demo_volume)
    hierarchy = slicer.mrmlScene.GetSubjectHierarchyNode()
    folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(text))
    assert hierarchy.GetItemName(folder) == text.GetName() == "mri (generic model)"
    parts = model_nodes.partsOf(demo_volume)
    assert {hierarchy.GetItemParent(hierarchy.GetItemByDataNode(node)) for node in parts} == {folder}
    assert hierarchy.GetNumberOfItemChildren(folder) == 1 + len(found.model.parts)


def test_what_the_image_does_not_show_is_called_so_and_translucent(fit_model, demo_volume, model_nodes):
    fit_model()
    parts = {node.GetName(): node for node in model_nodes.partsOf(demo_volume)}
    seen = {name for name in parts if "(" not in name}
    assert seen == {"bladder", "vagina"}
    assert {"rectum (predicted)", "levator ani (estimated)"} < set(parts)
    opaque = {name for name, node in parts.items() if node.GetDisplayNode().GetOpacity() == 1.0}
    assert opaque == seen


def test_the_scene_holds_the_model_bit_for_bit(fit_model, demo_volume, model_nodes):
    found = fit_model()
    held = model_nodes.modelOfVolume(demo_volume)
    assert held.points.tobytes() == found.model.points.tobytes()
    assert [part.labelled() for part in held.parts] == [part.labelled() for part in found.model.parts]


def test_parts_lie_on_their_patches(fit_model, demo_volume, model_nodes):
    found = fit_model()
    node = next(node for node in model_nodes.partsOf(demo_volume) if node.GetName() == "bladder")
    points = slicer.util.arrayFromModelPoints(node)
    net = found.model.parents["bladder"].control_net.reshape(-1, 3)
    assert np.all(points >= net.min(axis=0) - 1e-6)
    assert np.all(points <= net.max(axis=0) + 1e-6)
    assert node.GetPolyData().GetPointData().GetNormals() is not None


def test_patches_are_coloured_on_demand(fit_model, demo_volume, model_nodes):
    found = fit_model()
    assert not model_nodes.isColoredByPatch(demo_volume)
    model_nodes.colorByPatch(demo_volume, True)
    assert model_nodes.isColoredByPatch(demo_volume)
    display = next(node for node in model_nodes.partsOf(demo_volume) if node.GetName() == "bladder").GetDisplayNode()
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
    fit_model()
    assert model_nodes.isColoredByPatch(demo_volume)
    model_nodes.colorByPatch(demo_volume, False)
    assert not model_nodes.isColoredByPatch(demo_volume)


def test_a_deleted_table_of_colours_is_not_complained_of(fit_model, demo_volume, model_nodes, scene, vtk_messages):
    fit_model()
    model_nodes.colorByPatch(demo_volume, True)
    (part, *_others) = model_nodes.partsOf(demo_volume)
    assert part.GetDisplayNode().GetScalarRange() == (0.0, scene_colors(part).GetNumberOfColors() - 1)
    scene.RemoveNode(scene_colors(part))
    part.GetDisplayNode().Modified()
    part.Modified()
    assert vtk_messages() == ""


def scene_colors(part):
    """Table that a part is coloured by."""
    return part.GetDisplayNode().GetColorNode()


def test_a_scene_that_is_saved_holds_everything(fit_model, demo_volume, model_nodes, chosen, logic, scene, tmp_path):
    node = chosen.createLandmarks(chosen.modelNamed("pelvis"), demo_volume)
    node.SetNthControlPointPositionWorld(1, 0.0, -66.0, -48.0)
    organs = list(logic.organs())
    chosen.pairOrgan("rectum", None, organs, chosen.modelNamed("pelvis"))
    found, message = fit_model(landmarks=node), model_nodes.messageOf(demo_volume)
    model_nodes.colorByPatch(demo_volume, True)
    slicer.util.saveScene(str(tmp_path / "scene.mrb"))
    mrml_boot.clear(scene)
    slicer.util.loadScene(str(tmp_path / "scene.mrb"))
    loaded = slicer.util.getNode("mri")
    assert model_nodes.modelOfVolume(loaded).points.tobytes() == found.model.points.tobytes()
    assert model_nodes.messageOf(loaded) == message
    assert model_nodes.isColoredByPatch(loaded)
    table = model_nodes.partsOf(loaded)[0].GetDisplayNode().GetColorNode()
    assert table.GetNumberOfColors() == 1 + len(found.model.patches)
    wanted = list(patch_colours(found.model).values())
    kept = [table.GetLookupTable().GetTableValue(number)[:3] for number in range(1, table.GetNumberOfColors())]
    np.testing.assert_allclose(kept, wanted, atol=1.0 / 255.0)
    assert table.GetLookupTable().GetRange() == (0.0, len(found.model.patches))
    assert len(model_nodes.partsOf(loaded)) == len(found.model.parts)
    kept = chosen.GenericModelParameters(logic.getParameterNode().parameterNode)
    assert kept.modelName == "pelvis"
    assert kept.modelLandmarks.GetNumberOfUndefinedControlPoints() == 5
    assert list(chosen.placedLandmarks(kept.modelLandmarks, loaded)) == ["coccyx, tip"]
    assert set(chosen.pairedOrgans(chosen.modelNamed("pelvis"), logic.organs())) == {"bladder", "vagina"}


def test_files_are_those_of_the_command_line(fit_model, demo_volume, tmp_path):
    from VICRegistrationLib.mrml.generic_model_export import exportModel

    found = fit_model()
    paths, problem = exportModel(demo_volume, tmp_path / "new")
    assert problem == ""
    names = ["model.json", "model.step", "model.vtp", "bladder.json", "vagina.json"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(names)
    assert read_model(paths[0]).points.tobytes() == found.model.points.tobytes()
    assert read_surface(paths[3]).control_net.tobytes() == found.organs["bladder"].surface.control_net.tobytes()


def test_files_are_written_where_the_model_lies(fit_model, demo_volume, model_nodes):
    found, matrix = fit_model(), motion(30, (1, 2, 3), (5, -8, 12))
    transform = mrml_scenes.add_linear_transform(matrix)
    demo_volume.SetAndObserveTransformNodeID(transform.GetID())
    model_nodes.followVolumeWithModel(demo_volume)
    wanted = found.model.points @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(model_nodes.modelOfVolume(demo_volume).points, wanted, atol=1e-9)
    # Hardened on the volume, the parts are moved for good, and the model with them.
    demo_volume.HardenTransform()
    model_nodes.followVolumeWithModel(demo_volume)
    assert model_nodes.partsOf(demo_volume)[0].GetParentTransformNode() is None
    np.testing.assert_allclose(model_nodes.modelOfVolume(demo_volume).points, wanted, atol=1e-3)


def test_a_transform_that_mirrors_or_bends_is_refused(fit_model, demo_volume, model_nodes):
    fit_model()
    demo_volume.SetAndObserveTransformNodeID(mrml_scenes.add_linear_transform(np.diag([-1.0, 1, 1, 1])).GetID())
    with pytest.raises(ValueError, match="mirroring"):
        model_nodes.modelOfVolume(demo_volume)
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    demo_volume.SetAndObserveTransformNodeID(bent.GetID())
    with pytest.raises(ValueError, match="nonlinear"):
        model_nodes.modelOfVolume(demo_volume)


def test_parts_that_another_module_has_changed_are_refused(fit_model, demo_volume, model_nodes):
    fit_model()
    part = model_nodes.partsOf(demo_volume)[0]
    slicer.util.arrayFromModelPoints(part)[:] *= 1.01
    with pytest.raises(ValueError, match="Fit the model again"):
        model_nodes.modelOfVolume(demo_volume)


def test_without_a_fit_nothing_is_exported(demo_volume, tmp_path, slicer_module):
    from VICRegistrationLib.mrml.generic_model_export import exportModel

    with pytest.raises(ValueError, match="no fitted model yet"):
        exportModel(demo_volume, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_volume_without_a_model_says_nothing(demo_volume, model_nodes):
    assert model_nodes.findModel(None) is None
    assert model_nodes.messageOf(demo_volume) == ""
    assert model_nodes.partsOf(None) == []


def test_a_scene_that_is_added_to_another_keeps_its_own_model(fit_model, demo_volume, model_nodes, tmp_path):
    found = fit_model()
    slicer.util.saveScene(str(tmp_path / "scene.mrb"))
    # The one that is there goes elsewhere, and the loaded one stays.
    demo_volume.SetName("first")
    demo_volume.SetAndObserveTransformNodeID(mrml_scenes.add_linear_transform(motion(10, (0, 0, 1), (9, 0, 0))).GetID())
    model_nodes.followVolumeWithModel(demo_volume)
    slicer.util.loadScene(str(tmp_path / "scene.mrb"))
    loaded = slicer.util.getNode("mri")
    assert loaded is not demo_volume
    assert model_nodes.findModel(loaded) is not model_nodes.findModel(demo_volume)
    assert model_nodes.modelOfVolume(loaded).points.tobytes() == found.model.points.tobytes()
    assert len(model_nodes.partsOf(loaded)) == len(model_nodes.partsOf(demo_volume)) == len(found.model.parts)
    model_nodes.colorByPatch(loaded, True)
    assert model_nodes.isColoredByPatch(loaded)
    assert not model_nodes.isColoredByPatch(demo_volume)
