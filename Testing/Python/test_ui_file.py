"""The panel's .ui file asks only for what Slicer has; Slicer itself would pass over mistakes in silence."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from recorded_widgets import record
from recorded_widgets.ui_loader import readUi

from VICRegistrationLib.gui.option_texts import ELSEWHERE, WIDGETS, optionTexts
from VICRegistrationLib.registration.options import OPTIONS

MODULE = Path(__file__).resolve().parents[2] / "VICRegistration"
UI = MODULE / "Resources" / "UI" / "VICRegistration.ui"

# What a user can click or type into.
INPUTS = (
    *(
        "QCheckBox",
        "QComboBox",
        "QDoubleSpinBox",
        "QLineEdit",
        "QPushButton",
        "QSpinBox",
        "QTableWidget",
        "QToolButton",
    ),
    *("ctkRangeWidget", "ctkSliderWidget", "qMRMLNodeComboBox", "qMRMLSegmentSelectorWidget"),
    "qSlicerMarkupsPlaceWidget",
)

# Those that have to be told the scene.
FOLLOWING = ("qMRMLNodeComboBox", "qMRMLSegmentSelectorWidget", "qSlicerMarkupsPlaceWidget")


@pytest.fixture(scope="module")
def ui():
    """The file, read; two widgets of one name would be an error here."""
    return readUi(UI)


def test_the_widgets_that_the_code_uses_are_there(ui):
    files = [MODULE / "VICRegistration.py", *(MODULE / "VICRegistrationLib" / "gui").glob("*.py")]
    files += (MODULE.parent / "Testing" / "Slicer").glob("*.py")
    used = {name for path in files for name in re.findall(r"\bui\.(\w+)", path.read_text(encoding="utf-8"))}
    assert len(used) > 50
    assert used <= set(ui.widgets)


def test_names_do_not_hide_inner_parts_of_slicers_widgets(ui):
    inner = {"Slider", "SpinBox", "MinimumSpinBox", "MaximumSpinBox", "PlaceButton", "DeleteButton", "MoreButton"}
    assert not inner & set(ui.widgets)


def test_every_input_has_a_tooltip(ui):
    told = {name for name, member, element in ui.properties if member == "toolTip" and element.findtext("string")}
    labels, from_the_table = optionTexts()
    assert {name for name, cls in ui.widgets.items() if cls in INPUTS} - told == set(from_the_table)
    # Each text stands in one place.
    written = {name for name, member, element in ui.properties if member == "text" and element.findtext("string")}
    assert {name for name, cls in ui.widgets.items() if cls == "QLabel"} - written >= set(labels)


def test_the_tab_key_leaves_tables(ui):
    # It goes from cell to cell otherwise, and never to the next widget.
    leaving = {name for name, member, element in ui.properties if member == "tabKeyNavigation"}
    assert leaving == {name for name, cls in ui.widgets.items() if cls == "QTableWidget"}


def test_ranges_are_those_of_the_options(ui):
    limits = {"minimum": 0, "maximum": 1}
    for option, _, widget in (*WIDGETS, *ELSEWHERE):
        for name, member, element in ui.properties:
            if name == widget and member in limits and option != "smoothness":
                number = float(element.findtext("double") or element.findtext("number"))
                assert number == OPTIONS[option].limits[limits[member]], widget


def test_widgets_that_need_the_scene_are_connected_to_it(ui):
    need = {name for name, cls in ui.widgets.items() if "setMRMLScene(vtkMRMLScene*)" in record.load()[cls].slots}
    wired = {
        receiver
        for sender, signal, receiver, slot in ui.connections
        if (sender, signal, slot)
        == ("VICRegistration", "mrmlSceneChanged(vtkMRMLScene*)", "setMRMLScene(vtkMRMLScene*)")
    }
    assert need - wired == {"VICRegistration"}


def test_parameters_are_not_bound_by_the_file(ui):
    # One panel shows one organ after the other; connectGui would take all widgets at once.
    assert [name for name, member, _ in ui.properties if member == "SlicerParameterName"] == []


def test_custom_widgets_are_told_to_qt_with_headers(ui):
    assert {cls for cls in ui.widgets.values() if record.load()[cls].module != "qt"} == set(ui.customs)
    assert {cls: header for cls, header in ui.customs.items() if header != f"{cls}.h"} == {}


def test_maxima_come_before_values_which_they_would_cut(ui):
    order = {}
    for name, member, _ in ui.properties:
        order.setdefault(name, []).append(member)
    for name, members in order.items():
        for limit, value in (("maximum", "value"), ("minimum", "value"), ("decimals", "value")):
            if limit in members and value in members:
                assert members.index(limit) < members.index(value), name


def test_the_panel_is_built_from_the_file(recorded, scene, ui):
    import slicer

    panel = recorded.load_ui(UI)
    names = vars(slicer.util.childWidgetVariables(panel))
    assert set(ui.widgets) <= set(names)
    panel.setMRMLScene(scene)
    for name, cls in ui.widgets.items():
        assert cls not in FOLLOWING or names[name]._scene is scene, name


@pytest.mark.parametrize(
    ("content", "missing"),
    [
        ('<widget class="QPushButon" name="fit"/>', "QPushButon"),
        ('<widget class="QLabel" name="fit"><property name="txt"><string/></property></widget>', "txt"),
        (
            "<connection><sender>Panel</sender><signal>moved()</signal><receiver>Panel</receiver>"
            "<slot>show()</slot></connection>",
            "moved",
        ),
    ],
)
def test_what_slicer_does_not_have_is_not_built(recorded, tmp_path, content, missing):
    path = tmp_path / "panel.ui"
    path.write_text(f'<ui><widget class="QWidget" name="Panel">{content}</widget></ui>')
    with pytest.raises((KeyError, AttributeError), match=missing):
        recorded.load_ui(path)
