"""The stand-ins of Qt's and Slicer's widgets: strict as the record, and where Slicer surprises, as surprising."""

from __future__ import annotations

import gc
import json
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from recorded_widgets import record

slicer = pytest.importorskip("slicer", reason="slicer-core is not installed")

SOURCE = Path(__file__).resolve().parents[3] / "shared" / "slicer-api"


def emissions(widget, signature):
    """List that gets the arguments of every emission of a signal such as ``"clicked(bool)"``."""
    calls = []
    widget.connect(signature, lambda *arguments: calls.append(arguments))
    return calls


def add(className, name):
    return slicer.mrmlScene.AddNewNodeByClass(className, name)


# --- the record ------------------------------------------------------------------------------------------------------


def test_the_record_has_every_class_that_the_panel_and_the_stand_ins_use():
    # Enums and the cursor, which are no widgets.
    others = {"QApplication", "Qt"}
    assert record.panel_classes() | record.stand_in_classes() <= set(record.load()) | others


@pytest.mark.skipif(not SOURCE.is_dir(), reason="the full record is not beside the project")
def test_the_record_is_a_part_of_the_full_one():
    full, entries = record.read(SOURCE), json.loads(record.FILE.read_text())
    for name, found in record.unpack(entries).items():
        module, expected = full[name]
        assert entries[name]["module"] == module
        assert found["properties"] == expected.get("properties", {})
        for part in ("signals", "slots", "members"):
            assert found[part] == set(expected.get(part, ())), f"{part} of {name}"


@pytest.mark.parametrize(
    ("module", "cls", "name"),
    [
        ("qt", "QLabel", "txt"),
        ("qt", "QTableWidgetItem", "setName"),
        ("qt", "QHeaderView", "setResizeMode"),
        ("ctk", "ctkSliderWidget", "setRange"),
        ("slicer", "qMRMLNodeComboBox", "currentNodeName"),
    ],
)
def test_a_name_that_a_class_does_not_have_is_an_attribute_error(recorded, module, cls, name):
    made = getattr(sys.modules[module], cls)()
    with pytest.raises(AttributeError, match=f"'{cls}' has no attribute '{name}'"):
        getattr(made, name)
    with pytest.raises(AttributeError, match=f"'{cls}' has no attribute '{name}'"):
        setattr(made, name, 1)


def test_unknown_classes_enum_members_and_signals_are_attribute_errors(qt):
    with pytest.raises(AttributeError, match="QPushButon"):
        qt.QPushButon  # noqa: B018
    with pytest.raises(AttributeError, match="Strech"):
        qt.QHeaderView.Strech  # noqa: B018
    with pytest.raises(AttributeError, match=r"QPushButton.*signal 'clicked\(int\)'"):
        qt.QPushButton().connect("clicked(int)", print)
    with pytest.raises(AttributeError, match="clickd"):
        qt.QPushButton().clickd.connect(print)


def test_properties_are_no_methods_and_refuse_values_of_another_type(qt):
    label, spin = qt.QLabel(), qt.QSpinBox()
    with pytest.raises(TypeError):
        label.text()
    with pytest.raises(AttributeError, match="'text' of type 'QString'"):
        label.text = 3
    with pytest.raises(AttributeError, match="'value' of type 'int'"):
        spin.value = 2.5
    with pytest.raises(AttributeError, match="'maximum' of type 'int'"):
        spin.maximum = np.int64(3)


def test_a_member_that_the_stand_in_cannot_do_says_so(qt):
    with pytest.raises(NotImplementedError, match=r"QComboBox.completer exists in Slicer"):
        qt.QComboBox().completer()


# --- Qt and ctk ------------------------------------------------------------------------------------------------------


def test_handlers_get_as_many_arguments_as_they_take_and_their_errors_reach_the_test(qt):
    button, calls = qt.QPushButton(), []
    button.checkable = True
    button.connect("clicked(bool)", lambda checked: calls.append(("bool", checked)))
    button.clicked.connect(lambda: calls.append(("short",)))
    button.click()
    assert calls == [("bool", True), ("short",)]
    button.connect("clicked()", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        button.click()


def test_a_disabled_or_disconnected_button_does_nothing(qt):
    panel = qt.QWidget()
    button = qt.QPushButton(panel)
    clicks = emissions(button, "clicked()")
    panel.enabled = False
    button.click()
    panel.enabled = True
    button.blockSignals(True)
    button.click()
    button.blockSignals(False)
    assert clicks == []
    button.click()
    assert clicks == [()]


def test_numbers_stay_in_their_range_and_only_changes_are_emitted(qt):
    spin = qt.QSpinBox()
    values = emissions(spin, "valueChanged(int)")
    for _ in range(2):
        spin.value = 500
    spin.maximum = 50
    assert values == [(99,), (50,)]


def test_only_the_widgets_of_qt_round_to_their_decimals(qt, ctk):
    for make, kept in ((qt.QDoubleSpinBox, 2.3), (ctk.ctkSliderWidget, 2.345)):
        widget = make()
        widget.decimals, widget.minimum, widget.maximum = 1, -5, 5
        widget.value = 2.345
        assert widget.value == kept


def test_the_order_of_a_range_s_ends_counts_and_too_long_a_step_is_refused(ctk):
    widget = ctk.ctkRangeWidget()
    values = emissions(widget, "valuesChanged(double,double)")
    widget.setRange(0, 1000)
    for _ in range(2):
        widget.setValues(33, 44)
    widget.setRange(40, 1000)
    assert values == [(33, 44), (40, 44)]
    fresh = ctk.ctkRangeWidget()
    fresh.minimumValue, fresh.maximum = 100, 1000
    assert (fresh.minimumValue, fresh.maximumValue) == (99, 99)
    fresh.setRange(0, 1)
    fresh.singleStep = 4.0
    assert fresh.singleStep == 1.0


def test_a_table_emits_changes_and_destroys_removed_items(qt):
    table = qt.QTableWidget()
    table.setColumnCount(1)
    table.setRowCount(2)
    for row, name in enumerate(("bladder", "rectum")):
        table.setItem(row, 0, qt.QTableWidgetItem(name))
    names, selections = [], emissions(table, "itemSelectionChanged()")
    table.itemChanged.connect(lambda item: names.append(item.text()))
    second = table.item(1, 0)
    second.setText("uterus")
    table._edit(1, 0, "colon")
    table._return()
    table.selectRow(1)
    assert names == ["uterus", "colon"]
    assert len(selections) == 1
    second.setFlags(qt.Qt.ItemIsSelectable | qt.Qt.ItemIsEnabled)
    with pytest.raises(AssertionError, match="cannot edit"):
        table._edit(1, 0, "other")
    table.setRowCount(1)
    with pytest.raises(ValueError, match="destroyed QTableWidgetItem"):
        second.text()
    assert (table.item(0, 0).text(), table.currentRow()) == ("bladder", 0)


# --- the event loop --------------------------------------------------------------------------------------------------


def test_timers_fire_in_later_rounds_in_the_order_of_time_unless_they_are_dropped(qt, recorded):
    ran, timer, dropped = [], qt.QTimer(), qt.QTimer()
    for each, name, milliseconds in ((timer, "late", 10), (dropped, "dropped", 5)):
        each.setSingleShot(True)
        each.setInterval(milliseconds)
        each.connect("timeout()", lambda name=name: ran.append(name))
        each.start()
    del dropped, each
    gc.collect()
    qt.QTimer.singleShot(0, lambda: (ran.append("first"), qt.QTimer.singleShot(0, lambda: ran.append("next"))))
    assert (ran, timer.isActive()) == ([], True)
    slicer.app.processEvents()
    assert ran == ["first"]
    recorded.loop.waitFor(lambda: not timer.isActive())
    assert ran == ["first", "next", "late"]
    with pytest.raises(AssertionError, match="no timer is waiting"):
        recorded.loop.waitFor(lambda: False)


# --- Slicer's widgets on the scene -----------------------------------------------------------------------------------


@pytest.fixture
def combo(recorded, scene):
    """A selector of scalar volumes, label maps excluded."""
    combo = slicer.qMRMLNodeComboBox()
    combo.nodeTypes = ["vtkMRMLScalarVolumeNode"]
    combo.showChildNodeTypes = False
    combo.noneEnabled = True
    combo.setMRMLScene(scene)
    return combo


def test_a_node_selector_lists_nodes_of_its_types_and_follows_removal(combo, scene):
    volume = add("vtkMRMLScalarVolumeNode", "mri")
    add("vtkMRMLLabelMapVolumeNode", "labels")
    model = add("vtkMRMLModelNode", "model")
    assert (combo._listed(), combo.currentNode()) == ([volume], None)
    nodes = emissions(combo, "currentNodeChanged(vtkMRMLNode*)")
    for node in (model, volume, volume):
        combo.setCurrentNode(node)
    scene.RemoveNode(volume)
    assert nodes == [(volume,), (None,)]


def test_a_node_selector_without_none_takes_the_first_node(combo, scene):
    combo.noneEnabled = False
    first, second = (add("vtkMRMLScalarVolumeNode", name) for name in ("one", "two"))
    assert combo.currentNode() is first
    scene.RemoveNode(first)
    assert combo.currentNode() is second


def test_a_segment_selector_takes_the_first_segment_and_ignores_unknown_ones(recorded, scene):
    selector = slicer.qMRMLSegmentSelectorWidget()
    selector.setMRMLScene(scene)
    node = add("vtkMRMLSegmentationNode", "regions")
    for name in ("a", "b"):
        node.GetSegmentation().AddEmptySegment(name, name.upper(), [1, 0, 0])
    segments = emissions(selector, "currentSegmentChanged(QString)")
    selector.setCurrentNode(node)
    selector.setCurrentSegmentID("b")
    selector.setCurrentSegmentID("no such")
    assert segments == [("a",), ("b",)]
    scene.RemoveNode(node)
    assert (selector.currentNode(), selector.currentSegmentID()) == (None, "")


def test_the_place_mode_is_that_of_the_application_and_outlives_another_choice(recorded, scene):
    first, second = (slicer.qSlicerMarkupsPlaceWidget() for _ in range(2))
    lists = [add("vtkMRMLMarkupsFiducialNode", name) for name in ("seeds", "wall")]
    for place, node in zip((first, second), lists):
        place.setMRMLScene(scene)
        place.setCurrentNode(node)
    interaction = slicer.app.applicationLogic().GetInteractionNode()
    first.setPlaceModeEnabled(True)
    second.setPlaceModeEnabled(True)
    assert (first.placeModeEnabled, second.placeModeEnabled) == (False, True)
    second.setCurrentNode(None)
    assert not second.placeModeEnabled
    second.setCurrentNode(lists[1])
    scene.RemoveNode(lists[1])
    assert not second.placeModeEnabled
    # As in Slicer; whoever uses the widget has to set None, and has to end the mode.
    assert second.currentNode() is lists[1]
    assert interaction.GetCurrentInteractionMode() == interaction.Place


def test_the_last_of_a_fixed_number_of_points_is_taken_back(recorded, scene):
    place, points = slicer.qSlicerMarkupsPlaceWidget(), add("vtkMRMLMarkupsFiducialNode", "landmarks")
    place.setMRMLScene(scene)
    for _ in range(2):
        points.AddControlPoint(0.0, 0.0, 0.0)
    points.SetFixedNumberOfControlPoints(True)
    place.setCurrentNode(points)
    assert place.deleteButton().isHidden()
    place.unsetAllControlPointsOptionVisible = True
    assert not place.deleteButton().isHidden()
    place.deleteButton().click()
    assert points.GetNumberOfDefinedControlPoints() == 1


def test_a_path_that_fits_no_name_filter_is_not_told(ctk):
    edit = ctk.ctkPathLineEdit()
    paths = emissions(edit, "currentPathChanged(QString)")
    edit.currentPath = "any"
    edit.currentPath = ""
    edit.nameFilters = ("Models (*.json)",)
    for path in ("model.txt", "model.json", "model.json"):
        edit.currentPath = path
    assert paths == [("any",), ("model.json",)]


# --- parameters and widgets ------------------------------------------------------------------------------------------


def test_a_widget_that_slicer_does_not_connect_to_a_parameter_of_a_type_is_refused(qt, ctk, scene):
    from slicer.parameterNodeWrapper import WithinRange, parameterNodeWrapper

    hints = {"rows": Annotated[int, WithinRange(5, 65)], "erosion": Annotated[float, WithinRange(0, 20)]}
    cls = type("Organ", (), {"__annotations__": hints, "__module__": __name__, "rows": 9, "erosion": 2.0})
    organ = parameterNodeWrapper(cls)(add("vtkMRMLScriptedModuleNode", "organ"))
    # Only newer Slicers connect the second one.
    for name, widget in (("erosion", qt.QSpinBox()), ("rows", ctk.ctkSliderWidget())):
        with pytest.raises(RuntimeError, match="GUI connector"):
            organ.connectParametersToGui({name: widget})
