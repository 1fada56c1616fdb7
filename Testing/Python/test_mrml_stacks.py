"""Further stacks on real MRML: which volumes they are, what is kept of them, their motion, and their contours."""

from __future__ import annotations

import itertools

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER
from stack_phantom import MOTION, dented, stack_of

from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.registration.options import FitOptions

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")

SHIFT = np.linalg.norm([2.0, -1.5, 1.5])
QUICK = FitOptions(net=(9, 7))
# The organ of these small stacks in 4 mm slices is placed within this, mm.
CLOSE = 0.5


@pytest.fixture(scope="module")
def images():
    truth = dented()
    return {
        "SAG": stack_of(truth, "sagittal"),
        "AX": stack_of(truth, "axial", motion=MOTION, seed=2),
        "COR": stack_of(truth, "coronal", seed=3),
    }


@pytest.fixture
def stacks(scene, images):
    """Three volumes of one patient, the axial one of which is moved."""
    return {name: mrml_scenes.add_volume(image, name) for name, image in images.items()}


@pytest.fixture
def kept(slicer_module):
    """The module of what is kept of stacks."""
    from VICRegistrationLib.mrml import stacks as module

    return module


def fit(logic, stacks, *further, **options):
    return logic.fit(stacks["SAG"], [CENTER], name="bladder", options=QUICK, further=list(further), **options)


def world_points(node):
    return mrml_scenes.hardened_points(node)


def distances(surface, points):
    return np.abs(closest_points(surface, points[::7]).distances)


def test_volumes_of_a_similar_place_are_found(scene, stacks, kept):
    far = mrml_scenes.add_volume(name="knee", under=mrml_scenes.add_linear_transform(motion(0, (1, 0, 0), (500, 0, 0))))
    scene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "without voxels")
    labels = scene.AddNewNodeByClass("vtkMRMLLabelMapVolumeNode", "labels")
    slicer.util.updateVolumeFromArray(labels, np.ones((60, 60, 60), np.uint8))
    assert kept.similarVolumes(stacks["SAG"]) == [stacks["AX"], stacks["COR"]]
    assert kept.similarVolumes(None) == kept.similarVolumes(far) == []
    far.SetAndObserveTransformNodeID(None)
    assert kept.similarVolumes(stacks["SAG"])[-1] is far


def test_a_fit_takes_further_stacks_and_keeps_the_motion(logic, stacks, kept):
    organ = fit(logic, stacks, stacks["AX"], stacks["COR"])
    found = kept.stacksOf(organ)
    assert list(found) == [stacks["AX"], stacks["COR"]]
    assert all(record.used and not record.reason for record in found.values())
    assert found[stacks["AX"]].shift == pytest.approx(SHIFT, abs=CLOSE)
    assert found[stacks["COR"]].shift < CLOSE
    assert np.allclose(
        kept.toStack(found[stacks["AX"]], stacks["SAG"], stacks["AX"]) @ [*CENTER, 1], MOTION @ [*CENTER, 1], atol=CLOSE
    )
    assert 0.9 < found[stacks["AX"]].seen <= 1.0
    assert list(logic.getParameterNode().furtherStacks) == [stacks["AX"], stacks["COR"]]


def test_without_further_stacks_nothing_is_kept(logic, stacks, kept):
    organ = fit(logic, stacks)
    assert (kept.stacksOf(organ), list(organ.stackContours)) == ({}, [])


def test_what_is_kept_is_saved_with_the_scene(logic, stacks, kept, scene, tmp_path):
    organ = fit(logic, stacks, stacks["AX"])
    record = kept.stacksOf(organ)[stacks["AX"]]
    points = slicer.util.arrayFromModelPoints(organ.contours()[0]).copy()
    path = str(tmp_path / "scene.mrb")
    assert slicer.util.saveScene(path)
    scene.Clear(0)
    slicer.util.loadScene(path)
    (loaded,) = logic.organs()
    ((node, again),) = kept.stacksOf(loaded).items()
    assert (node.GetName(), again.used, again.shift) == ("AX", True, record.shift)
    np.testing.assert_allclose(again.matrix, record.matrix, atol=1e-9)
    (contour,) = loaded.contours()
    np.testing.assert_allclose(slicer.util.arrayFromModelPoints(contour), points, atol=1e-3)
    assert list(logic.getParameterNode().furtherStacks) == [node]
    logic.refit(loaded, [CENTER + [18.0, 0.0, 0.0]])
    assert kept.stacksOf(loaded)[node].shift == pytest.approx(SHIFT, abs=CLOSE)


def test_a_refit_takes_the_stacks_of_the_fit(logic, stacks, kept):
    organ = fit(logic, stacks, stacks["AX"])
    first = kept.stacksOf(organ)[stacks["AX"]]
    logic.getParameterNode().furtherStacks = []
    (deviation,) = logic.refit(organ, [CENTER + [18.0, 0.0, 0.0]])
    assert abs(deviation) < 0.5
    again = kept.stacksOf(organ)[stacks["AX"]]
    assert again.used
    assert again.shift == pytest.approx(first.shift, abs=0.3)


@pytest.mark.parametrize("aligned", [False, True])
def test_a_boundary_point_belongs_to_the_stack_in_whose_view_it_is_placed(logic, stacks, kept, aligned):
    organ = fit(logic, stacks, stacks["AX"])
    record = kept.stacksOf(organ)[stacks["AX"]]
    # Five millimetres outside of the wall that the axial stack shows.
    wall = (MOTION @ [*(CENTER + [18.0, 0.0, 0.0]), 1])[:3]
    if aligned:
        kept.alignStack(record, stacks["SAG"], stacks["AX"])
        wall = (slicer.util.arrayFromTransformMatrix(stacks["AX"].GetParentTransformNode()) @ [*wall, 1])[:3]
    organ.boundaryPoints.AddControlPointWorld(*wall)
    organ.boundaryPoints.SetNthControlPointAssociatedNodeID(0, stacks["AX"].GetID())
    np.testing.assert_allclose(kept.wallPoints(organ, stacks["SAG"]), [CENTER + [18.0, 0.0, 0.0]], atol=CLOSE)
    (deviation,) = logic.refit(organ)
    assert abs(deviation) < 0.5
    assert abs(closest_points(logic.surface(organ), np.array([CENTER + [18.0, 0.0, 0.0]])).distances[0]) < 1.0
    # A copy of the stack shows the same wall.
    organ.boundaryPoints.SetNthControlPointAssociatedNodeID(0, cloned(stacks["AX"]).GetID())
    np.testing.assert_allclose(kept.wallPoints(organ, stacks["SAG"]), [CENTER + [18.0, 0.0, 0.0]], atol=CLOSE)
    # One that was placed where the volume itself is shown lies where it lies.
    organ.boundaryPoints.SetNthControlPointAssociatedNodeID(0, stacks["SAG"].GetID())
    np.testing.assert_allclose(kept.wallPoints(organ, stacks["SAG"]), [wall], atol=1e-6)


@pytest.mark.parametrize("how", ["below a transform", "hardened later"])
def test_a_stack_is_where_the_scene_shows_it(logic, stacks, kept, how):
    # Somebody has registered the axial stack: it moves no more.
    undone = mrml_scenes.add_linear_transform(np.linalg.inv(MOTION))
    stacks["AX"].SetAndObserveTransformNodeID(undone.GetID())
    organ = fit(logic, stacks, stacks["AX"])
    record = kept.stacksOf(organ)[stacks["AX"]]
    assert record.used
    assert record.shift < CLOSE
    if how == "hardened later":
        stacks["AX"].HardenTransform()
    relation = kept.toStack(record, stacks["SAG"], stacks["AX"]) @ [*CENTER, 1]
    expected = CENTER if how == "hardened later" else (MOTION @ [*CENTER, 1])[:3]
    assert np.allclose(relation[:3], expected, atol=CLOSE)


def test_stacks_below_one_transform_need_it_not_to_be_linear(logic, stacks, kept):
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    for name in ("SAG", "AX"):
        stacks[name].SetAndObserveTransformNodeID(bent.GetID())
    seed = mrml_scenes.through(mrml_scenes.thin_plate_spline(), CENTER)
    organ = logic.fit(stacks["SAG"], seed, name="bladder", options=QUICK, further=[stacks["AX"]])
    record = kept.stacksOf(organ)[stacks["AX"]]
    assert record.used
    assert record.shift == pytest.approx(SHIFT, abs=CLOSE)


def test_a_stack_below_a_nonlinear_transform_is_left_out(logic, stacks, kept):
    alone = logic.surface(fit(logic, stacks)).control_net
    bent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
    stacks["AX"].SetAndObserveTransformNodeID(bent.GetID())
    organ = fit(logic, stacks, stacks["AX"])
    record = kept.stacksOf(organ)[stacks["AX"]]
    assert not record.used
    assert "The transform between AX and SAG is nonlinear" in record.reason
    assert "The stack AX was left out. The transform between" in organ.message
    np.testing.assert_array_equal(logic.surface(organ).control_net, alone)
    assert not kept.canBeAligned(record, stacks["SAG"], stacks["AX"])


def test_a_volume_with_several_values_in_a_voxel_is_left_out(logic, stacks, kept):
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk

    data = vtk.vtkImageData()
    data.SetDimensions(8, 8, 8)
    data.GetPointData().SetScalars(numpy_to_vtk(np.zeros((512, 3), np.uint8), deep=True))
    stacks["COR"].SetAndObserveImageData(data)
    organ = fit(logic, stacks, stacks["COR"])
    record = kept.stacksOf(organ)[stacks["COR"]]
    assert not record.used
    assert "COR has 3 values in every voxel" in record.reason


def test_a_stack_of_something_else_is_left_out_and_why_is_kept(logic, stacks, kept):
    slicer.util.arrayFromVolume(stacks["AX"])[:] = 7
    organ = fit(logic, stacks, stacks["AX"])
    record = kept.stacksOf(organ)[stacks["AX"]]
    assert not record.used
    assert record.reason
    assert f"The stack AX was left out. {record.reason}" in organ.message
    assert list(organ.stackContours) == []


@pytest.mark.parametrize("above", ["nothing", "linear", "nonlinear"])
def test_the_motion_becomes_a_transform_of_the_volume(logic, stacks, kept, scene, above):
    axial, sagittal, seed = stacks["AX"], stacks["SAG"], CENTER
    parent = None
    if above == "linear":
        parent = mrml_scenes.add_linear_transform(motion(20, (1, 2, -1), (3, 2, -1)))
        axial.SetAndObserveTransformNodeID(parent.GetID())
        axial.ApplyTransformMatrix(slicer.util.vtkMatrixFromArray(np.linalg.inv(motion(20, (1, 2, -1), (3, 2, -1)))))
    elif above == "nonlinear":
        parent = mrml_scenes.add_nonlinear_transform(mrml_scenes.thin_plate_spline())
        for node in (axial, sagittal):
            node.SetAndObserveTransformNodeID(parent.GetID())
        seed = mrml_scenes.through(mrml_scenes.thin_plate_spline(), CENTER)[0]
    organ = logic.fit(sagittal, [seed], name="bladder", options=QUICK, further=[axial])
    record = kept.stacksOf(organ)[axial]
    assert kept.canBeAligned(record, sagittal, axial)
    made = kept.alignStack(record, sagittal, axial)
    assert made.GetName() == "AX motion"
    assert axial.GetParentTransformNode() is made
    assert made.GetParentTransformNode() is parent
    assert not kept.canBeAligned(record, sagittal, axial)
    # The organ of both stacks is in one place of the world now: its contour there and its surface.
    from VICRegistrationLib.mrml.stack_contours import followStacks

    followStacks(organ)
    (contour,) = organ.contours()
    np.testing.assert_allclose(world_points(contour), world_points(organ.surface), atol=0.02)
    # Once more: the node is changed, not doubled, and the fit goes on from there.
    assert kept.alignStack(record, sagittal, axial) is made
    count = scene.GetNumberOfNodesByClass("vtkMRMLTransformNode")
    logic.refit(organ)
    again = kept.stacksOf(organ)[axial]
    assert again.used
    assert again.shift < CLOSE
    assert scene.GetNumberOfNodesByClass("vtkMRMLTransformNode") == count


def add_view(scene, name, background):
    """A slice view that shows a volume."""
    node = scene.AddNewNodeByClass("vtkMRMLSliceNode", name)
    composite = scene.AddNewNodeByClass("vtkMRMLSliceCompositeNode", name)
    node.SetLayoutName(name)
    composite.SetLayoutName(name)
    composite.SetBackgroundVolumeID(background.GetID())
    return node, composite


def seen_in(model, view):
    display = model.GetDisplayNode()
    return bool(display.GetVisibility() and display.GetVisibility2D() and display.IsDisplayableInView(view.GetID()))


def test_volumes_are_shown_by_the_views_of_the_layout(stacks, scene):
    from VICRegistrationLib.mrml.volumes import shownVolumes

    assert shownVolumes() == []
    add_view(scene, "Red", stacks["AX"])
    yellow, composite = add_view(scene, "Yellow", stacks["SAG"])
    assert shownVolumes() == [stacks["AX"], stacks["SAG"]]
    # Red is not in the layout, and has kept the volume that it showed there.
    yellow.SetMappedInLayout(True)
    assert shownVolumes() == [stacks["SAG"]]
    composite.SetBackgroundVolumeID(None)
    assert shownVolumes() == [stacks["AX"]]
    composite.SetBackgroundVolumeID(scene.AddNewNodeByClass("vtkMRMLLabelMapVolumeNode").GetID())
    assert shownVolumes() == [stacks["AX"]]


def test_every_view_shows_the_contour_at_the_position_of_its_stack(logic, stacks, scene):
    from VICRegistrationLib.mrml.stack_contours import chooseViews

    (red, _), (yellow, composite) = (
        add_view(scene, name, stacks[stack]) for name, stack in (("Red", "AX"), ("Yellow", "SAG"))
    )
    space = scene.AddNewNodeByClass("vtkMRMLViewNode", "1")
    organ = fit(logic, stacks, stacks["AX"])
    (contour,) = organ.contours()
    assert contour.GetName() == "bladder in AX"
    assert [seen_in(node, red) for node in (organ.surface, contour)] == [False, True]
    assert [seen_in(node, yellow) for node in (organ.surface, contour)] == [True, False]
    assert organ.surface.GetDisplayNode().IsDisplayableInView(space.GetID())
    assert not contour.GetDisplayNode().GetVisibility3D()
    moved = dented().transformed(MOTION)
    assert distances(moved, slicer.util.arrayFromModelPoints(contour)).mean() < CLOSE
    assert distances(moved, slicer.util.arrayFromModelPoints(organ.surface)).mean() > 1.0
    # The views change places.
    composite.SetBackgroundVolumeID(stacks["AX"].GetID())
    chooseViews()
    assert [seen_in(node, yellow) for node in (organ.surface, contour)] == [False, True]
    # Without the stack, and for another fit, everything is as it was.
    fitted_alone = fit(logic, stacks)
    assert seen_in(fitted_alone.surface, red)
    logic.organs().remove(organ)
    assert slicer.util.getNodesByClass("vtkMRMLModelNode") == [fitted_alone.surface]


def cloned(node):
    """What "Clone" in Slicer's module Data makes of a node."""
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    item = hierarchy.GetItemByDataNode(node)
    return hierarchy.GetItemDataNode(
        slicer.vtkSlicerSubjectHierarchyModuleLogic.CloneSubjectHierarchyItem(hierarchy, item)
    )


def test_clones_of_stacks_show_their_contours_and_clones_of_contours_are_seen(logic, stacks, scene):
    from VICRegistrationLib.mrml.stack_contours import chooseViews

    red, composite = add_view(scene, "Red", stacks["AX"])
    yellow, _ = add_view(scene, "Yellow", stacks["SAG"])
    organ = fit(logic, stacks, stacks["AX"])
    (contour,) = organ.contours()
    copy = cloned(contour)
    composite.SetBackgroundVolumeID(cloned(stacks["AX"]).GetID())
    chooseViews()
    assert [seen_in(node, red) for node in (organ.surface, contour, copy)] == [False, True, True]
    assert [seen_in(node, yellow) for node in (organ.surface, contour, copy)] == [True, False, True]
    composite.SetBackgroundVolumeID(cloned(stacks["SAG"]).GetID())
    chooseViews()
    assert [seen_in(node, red) for node in (organ.surface, contour)] == [True, False]
    logic.organs().remove(organ)
    assert slicer.util.getNodesByClass("vtkMRMLModelNode") == [copy]


def test_a_copy_of_an_aligned_stack_is_aligned_too(logic, stacks, scene, kept):
    from VICRegistrationLib.mrml.stack_contours import chooseViews, followStacks

    red, composite = add_view(scene, "Red", stacks["AX"])
    add_view(scene, "Yellow", stacks["SAG"])
    organ = fit(logic, stacks, stacks["AX"])
    made = kept.alignStack(kept.stacksOf(organ)[stacks["AX"]], stacks["SAG"], stacks["AX"])
    followStacks(organ)
    copy = cloned(stacks["AX"])
    composite.SetBackgroundVolumeID(copy.GetID())
    kept.alignCopy(copy)
    chooseViews()
    assert copy.GetParentTransformNode() is made
    assert [seen_in(node, red) for node in (organ.surface, organ.contours()[0])] == [False, True]
    # A copy of the copy has no transform either.
    again = cloned(copy)
    kept.alignCopy(again)
    assert again.GetParentTransformNode() is made


def test_only_copies_of_aligned_stacks_are_moved(logic, stacks, kept):
    organ = fit(logic, stacks, stacks["AX"])
    unaligned = cloned(stacks["AX"])
    kept.alignCopy(unaligned)
    assert unaligned.GetParentTransformNode() is None
    kept.alignStack(kept.stacksOf(organ)[stacks["AX"]], stacks["SAG"], stacks["AX"])
    # Another series with the same grid, and a copy that somebody has put elsewhere.
    series, placed = cloned(stacks["AX"]), cloned(stacks["AX"])
    slicer.util.arrayFromVolume(series)[0, 0, 0] += 1
    elsewhere = mrml_scenes.add_linear_transform(motion(0, (1, 0, 0), (5, 0, 0)))
    placed.SetAndObserveTransformNodeID(elsewhere.GetID())
    for node in (series, placed, stacks["COR"]):
        kept.alignCopy(node)
    assert [node.GetParentTransformNode() for node in (series, placed, stacks["COR"])] == [None, elsewhere, None]


def test_contours_are_hidden_when_their_surface_is_deleted(logic, stacks, scene):
    from VICRegistrationLib.mrml.stack_contours import chooseViews

    red, _ = add_view(scene, "Red", stacks["AX"])
    organ = fit(logic, stacks, stacks["AX"])
    (contour,) = organ.contours()
    assert seen_in(contour, red)
    scene.RemoveNode(organ.surface)
    chooseViews()
    assert not seen_in(contour, red)


def test_contours_of_a_deleted_stack_are_hidden_in_views_of_other_volumes(logic, stacks, scene):
    from VICRegistrationLib.mrml.stack_contours import chooseViews

    red, composite = add_view(scene, "Red", stacks["AX"])
    (contour,) = fit(logic, stacks, stacks["AX"]).contours()
    composite.SetBackgroundVolumeID(scene.AddNewNodeByClass("vtkMRMLScalarVolumeNode").GetID())
    scene.RemoveNode(stacks["AX"])
    chooseViews()
    assert not seen_in(contour, red)


def test_contours_are_renamed_painted_hidden_and_removed_with_their_organ(logic, stacks, scene):
    from VICRegistrationLib.mrml.organ_nodes import paint, setVisible

    organ = fit(logic, stacks, stacks["AX"])
    logic.organs().rename(organ, "bladder 7")
    (contour,) = organ.contours()
    assert contour.GetName() == "bladder 7 in AX"
    organ.color = (0.1, 0.2, 0.3)
    paint(organ)
    assert contour.GetDisplayNode().GetColor() == (0.1, 0.2, 0.3)
    setVisible(organ, False)
    assert not contour.GetDisplayNode().GetVisibility()
    logic.organs().remove(organ)
    assert not slicer.util.getNodesByClass("vtkMRMLModelNode")


def test_a_fit_that_is_not_given_a_stack_any_more_removes_its_contour(logic, stacks, kept):
    from VICRegistrationLib.mrml.fitting import fitSteps

    organ = fit(logic, stacks, stacks["AX"], stacks["COR"])
    assert len(organ.contours()) == 2
    for _step in fitSteps(organ, stacks["SAG"], [stacks["COR"]]):
        pass
    assert list(kept.stacksOf(organ)) == [stacks["COR"]]
    (contour,) = organ.contours()
    assert contour.GetName() == "bladder in COR"


@pytest.mark.parametrize("kind", ["fit", "refit"])
def test_a_stack_that_is_deleted_under_way_ends_the_fit_with_one_message(logic, stacks, scene, kind):
    from VICRegistrationLib.mrml import fitting

    organ = fit(logic, stacks, stacks["AX"])
    organ.boundaryPoints.AddControlPointWorld(*(CENTER + [18.0, 0.0, 0.0]))
    net, data = logic.surface(organ).control_net, organ.surface.GetPolyData()
    steps = {
        "fit": lambda: fitting.fitSteps(organ, stacks["SAG"], [stacks["AX"]]),
        "refit": lambda: fitting.refitSteps(organ, stacks["SAG"]),
    }[kind]()
    for _step in itertools.islice(steps, 2):
        pass
    scene.RemoveNode(stacks["AX"])
    with pytest.raises(
        ValueError, match="^The stack AX was deleted, but it is needed for the fit. Fit again without it."
    ):
        next(steps)
    assert "The stack AX was deleted" in organ.message
    assert organ.surface.GetPolyData() is data
    np.testing.assert_array_equal(logic.surface(organ).control_net, net)
    # What is left of it goes, and work goes on.
    from VICRegistrationLib.mrml.stack_contours import followStacks
    from VICRegistrationLib.mrml.stacks import forgetRemovedStacks, stacksOf

    forgetRemovedStacks(organ)
    followStacks(organ)
    assert (stacksOf(organ), list(organ.stackVolumes), organ.contours()) == ({}, [], [])
    logic.refit(organ)
    assert organ.state.value == "fitted"


def test_a_stack_that_was_deleted_before_is_not_looked_for(logic, stacks, scene, kept):
    organ = fit(logic, stacks, stacks["AX"], stacks["COR"])
    scene.RemoveNode(stacks["AX"])
    logic.refit(organ)
    assert list(kept.stacksOf(organ)) == [stacks["COR"]]
    assert [contour.GetName() for contour in organ.contours()] == ["bladder in COR"]
