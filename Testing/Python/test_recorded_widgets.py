"""The stand-ins of Qt's and Slicer's widgets: strict as the record, and lively enough to press their buttons."""

from __future__ import annotations

import gc

import numpy as np
import pytest

slicer = pytest.importorskip("slicer", reason="slicer-core is not installed")

from recorded_widgets.listening import heard  # noqa: E402

# --- strictness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("module", "cls", "name"),
    [
        ("qt", "QLabel", "txt"),
        ("qt", "QPushButton", "setColour"),
        ("qt", "QTableWidget", "setResizeMode"),
        ("qt", "QTableWidgetItem", "setName"),
        ("qt", "QSlider", "decimals"),
        ("qt", "QHeaderView", "setResizeMode"),
        ("ctk", "ctkSliderWidget", "setRange"),
        ("ctk", "ctkRangeWidget", "lowerValue"),
        ("slicer", "qMRMLNodeComboBox", "currentNodeName"),
        ("slicer", "qSlicerMarkupsPlaceWidget", "startPlacing"),
        ("slicer", "qSlicerSimpleMarkupsWidget", "undo"),
    ],
)
def test_a_name_that_a_class_does_not_have_is_an_attribute_error(recorded, module, cls, name):
    import sys

    made = getattr(sys.modules[module], cls)()
    with pytest.raises(AttributeError, match=f"'{cls}' has no attribute '{name}'"):
        getattr(made, name)
    with pytest.raises(AttributeError, match=f"'{cls}' has no attribute '{name}'"):
        setattr(made, name, 1)


def test_a_class_that_is_not_recorded_is_an_attribute_error(qt, ctk):
    for module, name in ((qt, "QPushButon"), (ctk, "ctkRangeSpin"), (slicer, "qMRMLOrganTable")):
        with pytest.raises(AttributeError, match=name):
            getattr(module, name)


def test_unknown_enum_members_and_signals_are_attribute_errors(qt):
    with pytest.raises(AttributeError, match="Strech"):
        qt.QHeaderView.Strech  # noqa: B018
    with pytest.raises(AttributeError, match="UsrRole"):
        qt.Qt.UsrRole  # noqa: B018
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
    with pytest.raises(AttributeError, match="'enabled' of type 'bool'"):
        label.enabled = None
    with pytest.raises(AttributeError, match="'maximum' of type 'int'"):
        spin.maximum = np.int64(3)


def test_numbers_of_numpy_are_taken_as_far_as_they_are_floats(ctk):
    widget = ctk.ctkRangeWidget()
    widget.setValues(np.float64(3), 5)
    assert widget.minimumValue == 3
    with pytest.raises(ValueError, match="matching overload"):
        widget.setValues(np.float32(3), 5)
    with pytest.raises(AttributeError, match="'decimals'"):
        widget.decimals = np.float64(2)


def test_a_member_that_the_stand_in_cannot_do_says_so(qt):
    with pytest.raises(NotImplementedError, match=r"QComboBox.completer exists in Slicer"):
        qt.QComboBox().completer()


def test_a_class_without_behaviour_of_its_own_keeps_its_properties(recorded):
    widget = slicer.qMRMLSliderWidget()
    widget.suffix = " mm"
    assert widget.suffix == " mm"
    assert widget.property("suffix") == " mm"


# --- Qt --------------------------------------------------------------------------------------------------------------


def test_handlers_get_as_many_arguments_as_they_take(qt):
    button, calls = qt.QPushButton("Fit"), []
    button.checkable = True
    button.connect("clicked()", lambda *arguments: calls.append(("none", arguments)))
    button.connect("clicked(bool)", lambda checked: calls.append(("bool", checked)))
    button.clicked.connect(lambda: calls.append(("short",)))
    button.click()
    assert calls == [("none", ()), ("bool", True), ("short",)]


def test_a_disabled_button_cannot_be_clicked(qt):
    panel = qt.QWidget()
    button = qt.QPushButton(panel)
    clicks = heard(button, "clicked()")
    panel.enabled = False
    assert not button.enabled
    button.click()
    panel.enabled = True
    button.click()
    assert len(clicks) == 1


def test_errors_in_handlers_reach_the_test(qt):
    button = qt.QPushButton()
    button.connect("clicked()", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        button.click()


def test_what_was_disconnected_or_blocked_is_not_called(qt):
    check, calls = qt.QCheckBox(), []
    check.toggled.connect(calls.append)
    was = check.blockSignals(True)
    check.checked = True
    check.blockSignals(was)
    check.toggled.disconnect(calls.append)
    check.checked = False
    assert calls == []


def test_a_check_box_tells_a_change_once(qt):
    check = qt.QCheckBox("Show")
    toggles, states = heard(check, "toggled(bool)"), heard(check, "stateChanged(int)")
    for _ in range(2):
        check.checked = True
    assert toggles == [(True,)]
    assert states == [(2,)]
    check.click()
    assert not check.checked


@pytest.mark.parametrize(("cls", "big", "cut"), [("QSpinBox", 500, 99), ("QDoubleSpinBox", 500.0, 99.99)])
def test_numbers_stay_in_their_range_and_are_told_once(qt, cls, big, cut):
    spin = getattr(qt, cls)()
    values = heard(spin, f"valueChanged({'int' if cls == 'QSpinBox' else 'double'})")
    for _ in range(2):
        spin.value = big
    assert values == [(cut,)]
    spin.setRange(0, 50)
    assert values[1:] == [(50,)]


def test_a_spin_box_shows_special_text_and_suffix(qt):
    spin = qt.QSpinBox()
    spin.specialValueText, spin.suffix = "automatic", " steps"
    assert spin.text == "automatic"
    spin.value = 3
    assert spin.text == "3 steps"


def test_only_the_widgets_of_qt_round_to_their_decimals(qt, ctk):
    for make, kept in ((qt.QDoubleSpinBox, 2.3), (ctk.ctkDoubleSpinBox, 2.345), (ctk.ctkSliderWidget, 2.345)):
        widget = make()
        widget.decimals, widget.minimum, widget.maximum = 1, -5, 5
        widget.value = 2.345
        assert widget.value == kept


def test_a_step_longer_than_the_range_is_refused(ctk):
    widget = ctk.ctkRangeWidget()
    widget.setRange(0, 1)
    widget.singleStep = 0.1
    widget.singleStep = 4.0
    assert widget.singleStep == 0.1


def test_a_range_is_told_once_and_the_order_of_its_ends_counts(ctk):
    widget = ctk.ctkRangeWidget()
    values = heard(widget, "valuesChanged(double,double)")
    widget.setRange(0, 1000)
    widget.setValues(33, 44)
    widget.setValues(33, 44)
    assert values == [(33, 44)]
    widget.setRange(40, 1000)
    assert values[1:] == [(40, 44)]
    fresh = ctk.ctkRangeWidget()
    fresh.minimumValue, fresh.maximum = 100, 1000
    assert (fresh.minimumValue, fresh.maximumValue) == (99, 99)


def test_a_combo_box_keeps_data_and_tells_index_and_text(qt):
    combo = qt.QComboBox()
    combo.addItem("Bladder", "bladder")
    combo.addItems(["Rectum"])
    assert (combo.count, combo.currentIndex, combo.currentText, combo.currentData) == (2, 0, "Bladder", "bladder")
    numbers, texts = heard(combo, "currentIndexChanged(int)"), heard(combo, "currentIndexChanged(QString)")
    combo.currentIndex = 1
    combo.setCurrentText("no such")
    assert (numbers, texts) == ([(1,)], [("Rectum",)])
    assert (combo.findText("Rectum"), combo.findData("bladder"), combo.itemData(0)) == (1, 0, "bladder")
    combo.clear()
    assert (combo.currentIndex, combo.currentText) == (-1, "")


def test_a_progress_bar_ignores_values_out_of_its_range(qt):
    bar = qt.QProgressBar()
    bar.setValue(50)
    bar.setValue(101)
    assert bar.value == 50


def test_hidden_parents_and_folded_sections_hide_what_is_in_them(qt, ctk):
    section = ctk.ctkCollapsibleButton()
    label = qt.QLabel("inside")
    layout = qt.QFormLayout(section)
    layout.addRow("Volume:", label)
    assert label.parent() is section
    assert label.visible
    folded = heard(section, "contentsCollapsed(bool)")
    section.collapsed = True
    assert not label.visible
    assert folded == [(True,)]
    section.collapsed = False
    section.hide()
    assert not label.visible
    assert not label.isHidden()


def test_children_are_found_by_class_and_name(qt):
    panel, box = qt.QWidget(), qt.QVBoxLayout()
    inner = qt.QHBoxLayout()
    panel.setLayout(box)
    box.addLayout(inner)
    button = qt.QPushButton("Fit")
    button.objectName = "fitButton"
    inner.addWidget(button)
    assert panel.findChild(qt.QPushButton, "fitButton") is button
    assert slicer.util.childWidgetVariables(panel).fitButton is button
    assert panel.layout() is box


def test_menus_trigger_their_actions(qt):
    menu, calls = qt.QMenu(), []
    action = menu.addAction("Remove", lambda: calls.append("remove"))
    chosen = heard(menu, "triggered(QAction*)")
    action.trigger()
    assert calls == ["remove"]
    assert chosen == [(action,)]


def test_colours_survive_the_way_through_a_button(qt, ctk):
    button = ctk.ctkColorPickerButton()
    colors = heard(button, "colorChanged(QColor)")
    button.color = qt.QColor.fromRgbF(0.2, 0.4, 0.6)
    button.color = qt.QColor("#336699")
    assert len(colors) == 1
    # Qt keeps 16 bit per channel.
    assert button.color.greenF() == pytest.approx(0.4, abs=1e-5)
    assert button.color.name() == "#336699"
    with pytest.raises(AttributeError, match="getRgbF"):
        button.color.getRgbF()


def test_enums_add_up_and_are_reached_by_either_way(qt):
    assert qt.Qt.ItemIsSelectable | qt.Qt.ItemIsEnabled == 33
    assert qt.QHeaderView.Stretch == qt.QHeaderView.ResizeMode.Stretch == 1
    assert qt.QAbstractItemView.DoubleClicked | qt.QAbstractItemView.EditKeyPressed == 10
    assert qt.QMessageBox.Ok != qt.QMessageBox.Cancel


# --- tables ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def table(qt):
    """Two rows with a name in the second column."""
    table = qt.QTableWidget()
    table.setColumnCount(2)
    table.setHorizontalHeaderLabels(["", "Name"])
    table.horizontalHeader().setSectionResizeMode(1, qt.QHeaderView.Stretch)
    table.verticalHeader().setVisible(False)
    table.setRowCount(2)
    for row, name in enumerate(("bladder", "rectum")):
        item = qt.QTableWidgetItem(name)
        item.setData(qt.Qt.UserRole, f"node{row}")
        table.setItem(row, 1, item)
    return table


def test_items_know_their_place_and_data(qt, table):
    item = table.item(1, 1)
    assert (item.row(), item.column(), item.text(), item.data(qt.Qt.UserRole)) == (1, 1, "rectum", "node1")
    assert (table.rowCount, table.columnCount, table.horizontalHeaderItem(1).text()) == (2, 2, "Name")
    assert table.item(0, 0) is None


def test_changes_by_code_and_by_a_user_are_told(qt, table):
    names = []
    table.itemChanged.connect(lambda item: names.append(item.text()))
    table.item(0, 1).setText("uterus")
    table._rename(1, 1, "colon")
    assert names == ["uterus", "colon"]
    table.item(0, 1).setFlags(qt.Qt.ItemIsSelectable | qt.Qt.ItemIsEnabled)
    with pytest.raises(AssertionError, match="cannot edit"):
        table._rename(0, 1, "other")


def test_removed_items_cannot_be_touched(table):
    item = table.item(0, 1)
    table.removeRow(0)
    with pytest.raises(ValueError, match="destroyed QTableWidgetItem"):
        item.text()
    assert table.item(0, 1).text() == "rectum"
    last = table.item(0, 1)
    table.setRowCount(0)
    with pytest.raises(ValueError, match="destroyed"):
        last.row()


def test_choosing_a_row_is_told_once(table):
    selections = heard(table, "itemSelectionChanged()")
    table._click(1)
    table._click(1)
    assert table.currentRow() == 1
    assert len(selections) == 1
    table.clearSelection()
    assert len(selections) == 2


def test_a_cell_holds_a_widget(qt, table):
    eye = qt.QToolButton()
    eye.setCheckable(True)
    table.setCellWidget(0, 0, eye)
    assert table.cellWidget(0, 0) is eye
    table.removeRow(0)
    with pytest.raises(ValueError, match="destroyed QToolButton"):
        eye.click()


# --- the event loop --------------------------------------------------------------------------------------------------


def test_single_shots_run_in_later_rounds_in_the_order_of_time(qt, recorded):
    ran = []
    qt.QTimer.singleShot(10, lambda: ran.append("late"))
    qt.QTimer.singleShot(0, lambda: (ran.append("first"), qt.QTimer.singleShot(0, lambda: ran.append("next"))))
    assert ran == []
    slicer.app.processEvents()
    assert ran == ["first"]
    recorded.loop.wait(9)
    assert ran == ["first", "next"]
    recorded.loop.wait(1)
    assert ran == ["first", "next", "late"]


def test_a_timer_repeats_until_it_is_stopped_and_once_if_asked(qt, recorded):
    timer, once = qt.QTimer(), qt.QTimer()
    once.setSingleShot(True)
    for each in (timer, once):
        each.setInterval(20)
    ticks, shots = heard(timer, "timeout()"), heard(once, "timeout()")
    timer.start()
    once.start()
    assert timer.active
    assert once.isActive()
    recorded.loop.wait(70)
    assert (len(ticks), len(shots)) == (3, 1)
    assert not once.active
    timer.stop()
    recorded.loop.wait(70)
    assert len(ticks) == 3


def test_a_timer_nobody_holds_never_fires(qt, recorded):
    ticks = []
    timer = qt.QTimer()
    timer.connect("timeout()", lambda: ticks.append(1))
    timer.start(5)
    del timer
    gc.collect()
    recorded.loop.wait(50)
    assert ticks == []


def test_waiting_for_what_never_comes_is_an_error(qt, recorded):
    with pytest.raises(AssertionError, match="no timer is waiting"):
        recorded.loop.waitFor(lambda: False)
    done = []
    qt.QTimer.singleShot(1000, lambda: done.append(1))
    recorded.loop.waitFor(lambda: done)
