"""The stand-ins of Slicer's widgets on the real scene, bound to parameters, and in a scripted module."""

from __future__ import annotations

import enum
from typing import Annotated, Optional

import pytest

slicer = pytest.importorskip("slicer", reason="slicer-core is not installed")

from recorded_widgets.listening import add, heard  # noqa: E402


class Kind(enum.Enum):
    """Chosen in a combo box."""

    LIVER = "liver"
    KIDNEY = "kidney"

    def label(self):
        return self.value.capitalize()


# --- Slicer's widgets ------------------------------------------------------------------------------------------------


@pytest.fixture
def combo(recorded, scene):
    """A selector of scalar volumes, label maps excluded."""
    combo = slicer.qMRMLNodeComboBox()
    combo.nodeTypes = ["vtkMRMLScalarVolumeNode"]
    combo.showChildNodeTypes = False
    combo.noneEnabled = True
    combo.setMRMLScene(scene)
    return combo


def test_a_node_selector_lists_nodes_of_its_types(combo):
    volume = add("vtkMRMLScalarVolumeNode", "mri")
    add("vtkMRMLLabelMapVolumeNode", "labels")
    add("vtkMRMLModelNode", "model")
    assert (combo.nodeCount(), combo.nodeFromIndex(0)) == (1, volume)
    assert combo.currentNode() is None


def test_a_node_selector_tells_choice_and_follows_removal(combo, scene):
    volume = add("vtkMRMLScalarVolumeNode", "mri")
    nodes, there = heard(combo, "currentNodeChanged(vtkMRMLNode*)"), heard(combo, "currentNodeChanged(bool)")
    combo.setCurrentNode(volume)
    combo.setCurrentNode(volume)
    assert combo.currentNodeID == volume.GetID()
    scene.RemoveNode(volume)
    assert combo.currentNode() is None
    assert nodes == [(volume,), (None,)]
    assert there == [(True,), (False,)]


def test_a_node_selector_does_not_take_what_it_does_not_list(combo):
    model = add("vtkMRMLModelNode", "model")
    combo.setCurrentNode(model)
    assert combo.currentNode() is None
    with pytest.raises(AssertionError, match="does not list"):
        combo._choose(model)


def test_a_node_selector_without_a_scene_lists_nothing(recorded):
    combo = slicer.qMRMLNodeComboBox()
    combo.nodeTypes = ["vtkMRMLScalarVolumeNode"]
    add("vtkMRMLScalarVolumeNode", "mri")
    assert combo.mrmlScene() is None
    assert combo.nodeCount() == 0


def test_a_node_selector_without_none_takes_the_first_node(combo, scene):
    combo.noneEnabled = False
    first, second = (add("vtkMRMLScalarVolumeNode", name) for name in ("one", "two"))
    assert combo.currentNode() is first
    scene.RemoveNode(first)
    assert combo.currentNode() is second


def test_a_node_selector_knows_attributes_and_hidden_nodes(recorded, scene):
    combo = slicer.qMRMLNodeComboBox()
    combo.nodeTypes, combo.showHidden = ["vtkMRMLScriptedModuleNode"], True
    combo.addAttribute("vtkMRMLScriptedModuleNode", "VIC.type", "organ")
    combo.setMRMLScene(scene)
    organ = add("vtkMRMLScriptedModuleNode", "organ", **{"VIC.type": "organ"})
    organ.SetHideFromEditors(True)
    add("vtkMRMLScriptedModuleNode", "other")
    assert [combo.nodeFromIndex(i) for i in range(combo.nodeCount())] == [organ]


def test_a_segment_selector_tells_segmentation_and_segment(recorded, scene):
    selector = slicer.qMRMLSegmentSelectorWidget()
    selector.setMRMLScene(scene)
    node = add("vtkMRMLSegmentationNode", "regions")
    for name in ("a", "b"):
        node.GetSegmentation().AddEmptySegment(name, name.upper(), [1, 0, 0])
    segments = heard(selector, "currentSegmentChanged(QString)")
    selector.setCurrentNode(node)
    selector.setCurrentSegmentID("b")
    selector.setCurrentSegmentID("no such")
    assert segments == [("a",), ("b",)]
    assert selector.segmentIDs() == ["a", "b"]
    scene.RemoveNode(node)
    assert (selector.currentNode(), selector.currentSegmentID()) == (None, "")


@pytest.fixture
def place(recorded, scene):
    """A place widget with a list of points."""
    place = slicer.qSlicerMarkupsPlaceWidget()
    place.setMRMLScene(scene)
    place.setCurrentNode(add("vtkMRMLMarkupsFiducialNode", "seeds"))
    return place


def test_points_are_placed_in_place_mode_only(place):
    with pytest.raises(AssertionError, match="place mode .* is off"):
        place._place(1, 2, 3)
    place.placeMultipleMarkups = slicer.qSlicerMarkupsPlaceWidget.ForcePlaceMultipleMarkups
    place.placeButton().click()
    assert place.placeModeEnabled
    place._place(1, 2, 3)
    place._place(4, 5, 6)
    assert place.currentNode().GetNumberOfDefinedControlPoints() == 2
    place.deleteLastPoint()
    assert place.currentNode().GetNumberOfDefinedControlPoints() == 1


def test_place_mode_is_that_of_the_application(place):
    interaction = slicer.app.applicationLogic().GetInteractionNode()
    modes = heard(place, "activeMarkupsPlaceModeChanged(bool)")
    place.setPlaceModeEnabled(True)
    assert interaction.GetCurrentInteractionMode() == interaction.Place
    place.setPlaceModeEnabled(False)
    assert interaction.GetCurrentInteractionMode() == interaction.ViewTransform
    assert modes == [(True,), (False,)]


def test_one_point_ends_the_mode_of_a_single_point(place):
    place.placeMultipleMarkups = slicer.qSlicerMarkupsPlaceWidget.ForcePlaceSingleMarkup
    place.placeModeEnabled = True
    place._place(1, 2, 3)
    assert not place.placeModeEnabled


def test_a_removed_list_of_points_ends_the_mode_and_stays_current(place, scene):
    node = place.currentNode()
    place.placeModeEnabled = True
    scene.RemoveNode(node)
    assert not place.placeModeEnabled
    # As in Slicer; whoever uses the widget has to set None.
    assert place.currentNode() is node


# --- parameters and widgets ------------------------------------------------------------------------------------------


@pytest.fixture
def organ(recorded, scene):
    """A parameter node with what widgets can show."""
    from slicer.parameterNodeWrapper import Default, FloatRange, RangeBounds, WithinRange, parameterNodeWrapper

    hints = {
        "label": str,
        "automatic": bool,
        "rows": Annotated[int, WithinRange(5, 65)],
        "erosion": Annotated[float, WithinRange(0, 20)],
        "threshold": Annotated[FloatRange, RangeBounds(-1000, 1000), Default(FloatRange(0, 300))],
        "kind": Kind,
        "volume": Optional[slicer.vtkMRMLScalarVolumeNode],
    }
    cls = type("Organ", (), {"__annotations__": hints, "__module__": __name__, "rows": 9, "erosion": 2.0})
    return parameterNodeWrapper(cls)(add("vtkMRMLScriptedModuleNode", "organ"))


def test_widgets_and_parameters_follow_each_other(qt, ctk, organ, combo):
    volume = add("vtkMRMLScalarVolumeNode", "mri")
    widgets = {
        "label": qt.QLineEdit(),
        "automatic": qt.QCheckBox(),
        "rows": qt.QSpinBox(),
        "erosion": ctk.ctkSliderWidget(),
        "threshold": ctk.ctkRangeWidget(),
        "kind": qt.QComboBox(),
        "volume": combo,
    }
    organ.connectParametersToGui(widgets)
    assert (widgets["rows"].value, widgets["erosion"].maximum, widgets["kind"].count) == (9, 20, 2)
    assert widgets["kind"].currentText == "Liver"
    widgets["label"]._type("bladder")
    widgets["automatic"].click()
    widgets["rows"]._type(70)
    widgets["erosion"]._type(3.5)
    widgets["threshold"]._type(33, 44)
    widgets["kind"]._choose(1)
    widgets["volume"]._choose(volume)
    assert (organ.label, organ.automatic, organ.rows, organ.erosion) == ("bladder", True, 65, 3.5)
    assert (organ.threshold.minimum, organ.threshold.maximum, organ.kind) == (33, 44, Kind.KIDNEY)
    assert organ.volume is volume
    organ.erosion, organ.kind, organ.volume = 1.0, Kind.LIVER, None
    assert (widgets["erosion"].value, widgets["kind"].currentIndex, combo.currentNode()) == (1.0, 0, None)


def test_disconnected_widgets_leave_the_parameters_alone(ctk, organ):
    slider = ctk.ctkSliderWidget()
    tag = organ.connectParametersToGui({"erosion": slider})
    organ.disconnectGui(tag)
    slider.value = 7
    organ.erosion = 5.0
    assert slider.value == 7


def test_connect_gui_gives_no_tag_as_in_older_slicers(qt, organ):
    from types import SimpleNamespace

    check = qt.QCheckBox()
    check.setProperty("SlicerParameterName", "automatic")
    assert organ.connectGui(SimpleNamespace(check=check)) is None
    check.click()
    assert organ.automatic


def test_parameters_that_a_widget_cannot_show_are_refused(qt, ctk, organ):
    with pytest.raises(RuntimeError, match="GUI connector"):
        organ.connectParametersToGui({"threshold": qt.QSpinBox()})
    with pytest.raises(ValueError, match="eroson"):
        organ.connectParametersToGui({"eroson": ctk.ctkSliderWidget()})


# --- modules ---------------------------------------------------------------------------------------------------------

MODULE = """
import qt, slicer
from slicer.ScriptedLoadableModule import *
class BenchModule(ScriptedLoadableModule):
    def __init__(self, parent):
        ScriptedLoadableModule.__init__(self, parent)
        parent.title = "Bench"
class BenchModuleWidget(ScriptedLoadableModuleWidget):
    calls = []
    def setup(self):
        self.calls.append("setup")
        self.layout.addWidget(qt.QLabel("ANSWER"))
    def enter(self): self.calls.append("enter")
    def exit(self): self.calls.append("exit")
    def cleanup(self): self.calls.append("cleanup")
"""


@pytest.fixture
def module(recorded, tmp_path):
    """A small scripted module, forgotten at the end."""
    import sys

    from slicer_stand_ins.bench import loadModule

    (tmp_path / "BenchModule.py").write_text(MODULE)
    yield loadModule(tmp_path / "BenchModule.py")
    slicer.modules.benchmodule.unload()
    for name in ("benchmodule", "BenchModuleInstance"):
        delattr(slicer.modules, name)
    sys.path.remove(str(tmp_path))
    del sys.modules["BenchModule"]


def test_a_module_is_set_up_entered_left_and_cleaned_up_in_that_order(module):
    assert slicer.modules.BenchModuleInstance.parent.title == "Bench"
    widget = module.enter()
    assert slicer.util.getModuleWidget("BenchModule") is widget
    assert widget.parent.isEntered
    module.exit()
    assert not widget.parent.isEntered
    module.unload()
    assert widget.calls == ["setup", "enter", "exit", "cleanup"]


def test_reloading_a_module_makes_a_new_widget_of_the_new_code(module, qt):
    old = module.enter()
    text = MODULE.replace("ANSWER", "forty-two")
    with open(module.path, "w") as file:
        file.write(text)
    old.onReload()
    new = slicer.util.getModuleWidget("BenchModule")
    assert old.calls == ["setup", "enter", "cleanup"]
    # Slicer does not enter it again.
    assert new.calls == ["setup"]
    assert [label.text for label in new.parent.findChildren(qt.QLabel) if label.visible] == ["forty-two"]
