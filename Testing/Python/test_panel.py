"""The self tests of the panel that run in Slicer (Testing/Slicer), on the recorded widgets."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "few_points")

pytest.importorskip("slicer", reason="slicer-core is not installed")

FOLDER = Path(__file__).resolve().parents[1] / "Slicer"
FILES = sorted(path.stem for path in FOLDER.glob("*_tests.py"))


@pytest.fixture
def panelTests(recorded, slicer_module, near_pelvis, monkeypatch):
    """The modules of the self tests by name, with the demo's MRI around its organs.

    A round of the event loop takes one step of a fit: a kept fit would end within one slice of time on a fast machine.
    """
    from VICRegistrationLib.gui import runner

    monkeypatch.setattr(runner, "SLICE_S", 0.0)
    monkeypatch.setattr("VICRegistrationLib.mrml.samples.phantom", lambda: near_pelvis)
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in ("panel_case", *FILES):
        sys.modules.pop(name, None)
    return {name: importlib.import_module(name) for name in ("panel_case", *FILES)}


def names():
    """File, class and method of each test, read off: they cannot be imported before the stand-ins are there."""
    for file in FILES:
        for node in ast.parse((FOLDER / f"{file}.py").read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                for child in node.body:
                    if isinstance(child, ast.FunctionDef) and child.name.startswith("test_"):
                        yield file, node.name, child.name


@pytest.mark.parametrize(("file", "group", "name"), list(names()))
def test_in_the_panel(panelTests, file, group, name):
    case = getattr(panelTests[file], group)(name)
    case.setUp()
    try:
        getattr(case, name)()
    finally:
        case.tearDown()


@pytest.fixture
def case(panelTests):
    """A scene with the demo's MRI, and the panel."""
    case = panelTests["panel_case"].PanelTestCase()
    case.setUp()
    yield case
    case.tearDown()


def test_a_rename_under_way_outlives_a_refresh(case):
    case.add("bladder")
    table = case.ui.organsTable
    table._edit(0, 2, "half a na")
    case.panel.refresh()
    table._return()
    assert case.organ.label == "half a na"
    assert table.currentColumn() == 2


def test_a_binding_that_has_failed_releases_no_other_one(case):
    import qt

    from VICRegistrationLib.gui.binding import Binding

    case.add("bladder")
    one, other = (type(case.organ)(case.organ.parameterNode) for _ in range(2))
    failing, kept, box = Binding(), Binding(), qt.QDoubleSpinBox()
    failing.bind(one, {"erosionMm": qt.QDoubleSpinBox()})
    failing.release()
    kept.bind(other, {"dilationMm": box})
    with pytest.raises(KeyError):
        failing.bind(other, {"noSuchParameter": qt.QDoubleSpinBox()})
    failing.release()
    box.value = 4.0
    assert other.dilationMm == 4.0


@pytest.fixture
def modules():
    """What is imported of the project, put back after a test in which it is imported anew."""
    kept = {name: module for name, module in sys.modules.items() if name.startswith("VICRegistration")}
    yield
    for name in [name for name in sys.modules if name.startswith("VICRegistration")]:
        del sys.modules[name]
    sys.modules.update(kept)


@pytest.mark.usefixtures("modules")
def test_a_module_that_is_reloaded_shows_the_scene_and_the_old_panel_nothing(case):
    import slicer

    case.fitted("bladder")
    case.add("vagina")
    case.placeSeeds("vagina", count=1)
    case.ui.fitButton.click()
    slicer.app.processEvents()
    old = case.panel
    case.widget.onReload()
    case.widget = slicer.util.getModuleWidget("VICRegistration")
    case.ui, case.panel = case.widget.ui, case.widget.panel
    assert (old.isOpen, old.fitSection.running, case.panel.isOpen) == (False, False, True)
    assert type(old) is not type(case.panel)
    assert [organ.label for organ in case.panel.organs] == ["bladder", "vagina"]
    assert case.organ.surface is None
    case.ui.fitButton.click()
    case.waitForFit()
    assert "iterations" in case.ui.fitStatusLabel.text
    # Nothing follows the scene twice.
    refreshed = []
    old.refresh = lambda: refreshed.append(old)
    case.organ.message = "seen once"
    assert (refreshed, old.ui.organsTable.rowCount) == ([], 0)


def test_the_list_of_stacks_takes_no_notice_of_label_maps(case, monkeypatch):
    case.add("bladder")
    case.placeSeeds("bladder", count=1)
    regions, segment = case.organ.regions, case.organ.regionSegmentId
    case.add("uterus")
    case.ui.sourceCombo.setCurrentIndex(1)
    notices = []
    monkeypatch.setattr(case.panel.stacksSection, "_onChanged", lambda: notices.append(1))
    case.ui.segmentSelector.setCurrentNode(regions)
    case.ui.segmentSelector.setCurrentSegmentID(segment)
    case.waitForRegion()
    assert case.organ.state.value == "separated"
    assert notices == []


@pytest.mark.usefixtures("recorded")
def test_long_lines_of_a_message_are_shortened_until_all_is_shown():
    import qt

    from VICRegistrationLib.gui.message_label import MessageLabel

    label = qt.QLabel()
    message = MessageLabel(label)
    word, sentence = "x" * 70, "The surface follows no edge. " * 4
    message.show(f"132.0 ml\n{word}\n{sentence}")
    lines = label.text.split("<br>")
    assert lines[:2] == ["132.0 ml", f"{'x' * 58} ..."]
    assert lines[2] == "The surface follows no edge. The surface follows no edge. ..."
    assert label.toolTip == f"132.0 ml\n{word}\n{sentence}"
    label._emit("linkActivated", "#")
    assert label.text.split("<br>")[1] == word


@pytest.mark.parametrize("typed", ["~/results", " results "])
def test_a_folder_that_is_typed_is_told_with_its_whole_path(case, tmp_path, monkeypatch, typed):
    for variable in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(variable, str(tmp_path))
    monkeypatch.chdir(tmp_path)
    case.fitted("bladder")
    case.ui.exportFolderEdit.currentPath = typed
    case.ui.exportButton.click()
    assert (tmp_path / "results" / "bladder.step").is_file()
    assert case.ui.exportStatusLabel.text == f"Written: {tmp_path / 'results' / 'bladder.step'}"


def test_a_separation_that_breaks_is_told(case, monkeypatch, caplog):
    def broken(*arguments):
        raise MemoryError

    case.add("bladder")
    monkeypatch.setattr("VICRegistrationLib.gui.separate_section.separateOrgan", broken)
    case.placeSeeds("bladder", count=1)
    assert "The log has it" in case.ui.regionStatusLabel.text
    assert "MemoryError" in caplog.text


@pytest.mark.parametrize("name", ["fitSteps", "modelSteps"])
def test_a_fit_that_breaks_is_told(case, panelTests, monkeypatch, caplog, name):
    def broken(*arguments):
        yield from ([][index] for index in range(1))

    section = {"fitSteps": "fit_section", "modelSteps": "model_section"}[name]
    case.add("bladder")
    monkeypatch.setattr(f"VICRegistrationLib.gui.{section}.{name}", broken)
    (case.ui.fitButton if name == "fitSteps" else case.ui.fitModelButton).click()
    case.waitForFit()
    panelTests["panel_case"].waitFor(lambda: not case.panel.modelSection.running)
    label = case.ui.fitStatusLabel if name == "fitSteps" else case.ui.modelStatusLabel
    assert "The fit failed because of an unexpected error" in label.text
    assert "list index" not in label.text
    assert "list index out of range" in caplog.text
    assert case.ui.fitButton.enabled


@pytest.mark.parametrize("answer", ["no", "yes", "pip fails"])
def test_gmsh_is_installed_only_if_the_user_agrees(case, monkeypatch, tmp_path, caplog, answer):
    import slicer

    from VICRegistrationLib.gui import mesher

    asked, installed, started = [], [], []

    def pip_install(name):
        if answer == "pip fails":
            raise subprocess.CalledProcessError(1, "pip")
        installed.append(name)

    monkeypatch.setattr(mesher, "_gmshIsThere", lambda: bool(installed))
    monkeypatch.setattr(mesher, "Command", lambda words, *rest: started.append(words))
    monkeypatch.setattr(type(slicer.app), "testingEnabled", lambda self: False)
    monkeypatch.setattr(slicer.util, "confirmOkCancelDisplay", lambda text: asked.append(text) or answer != "no")
    monkeypatch.setattr(slicer.util, "pip_install", pip_install, raising=False)
    case.fitted("rectum")
    case.ui.exportFormatCombo.setCurrentIndex(case.ui.exportFormatCombo.findData(".vtu"))
    case.ui.exportFolderEdit.currentPath = str(tmp_path)
    case.ui.exportButton.click()
    assert len(asked) == 1
    assert [words[0] for words in started] == (["mesh"] if answer == "yes" else [])
    assert ("A mesh needs the package gmsh" in case.ui.exportStatusLabel.text) == (answer != "yes")
    assert ("could not be installed" in caplog.text) == (answer == "pip fails")


@pytest.mark.skipif(os.name == "nt", reason="needs a shell script for a program")
@pytest.mark.usefixtures("recorded")
def test_a_command_behind_a_launcher_is_cancelled(tmp_path, monkeypatch):
    # Slicer's own Python is a launcher: a program that starts another one, hands on what is written, and no signal.
    launcher = tmp_path / "PythonSlicer"
    launcher.write_text(f'#!/bin/sh\n"{sys.executable}" "$@" <&0\nexit $?\n')
    launcher.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(launcher))
    from recorded_widgets.event_loop import LOOP

    from VICRegistrationLib.gui.command import Command

    ends = []
    command = Command(["phantom", str(tmp_path / "out")], print, lambda *end: ends.append(end), patience=10**9)
    # A library written in C may crash if it is ended while it is imported: after the imports a draft is there. Not when
    # its folder has just been made: whoever has made it has to hear of it.
    LOOP.waitFor(lambda: any(path.is_dir() and any(path.iterdir()) for path in tmp_path.iterdir()))
    command.cancel()
    LOOP.waitFor(lambda: ends)
    assert ends == [(143, "")]
    assert list(tmp_path.iterdir()) == [launcher]


@pytest.mark.usefixtures("recorded")
def test_the_last_line_of_a_command_that_fails_is_the_sentence_to_show(tmp_path):
    from recorded_widgets.event_loop import LOOP

    from VICRegistrationLib.gui.command import Command

    lines, ends = [], []
    Command(["gaps", str(tmp_path / "none.json")], lines.append, lambda *end: ends.append(end))
    LOOP.waitFor(lambda: ends)
    assert ends == [(2, "")]
    assert lines[-1].startswith("The surface file ")


@pytest.mark.skipif(os.name == "nt", reason="the encoding of pipes is another one there by itself")
@pytest.mark.usefixtures("recorded")
def test_names_in_a_command_s_messages_come_through_whatever_the_encoding_of_pipes(tmp_path, monkeypatch):
    for name, value in {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}.items():
        monkeypatch.setenv(name, value)
    from recorded_widgets.event_loop import LOOP

    from VICRegistrationLib.gui.command import Command

    lines, ends = [], []
    Command(["gaps", str(tmp_path / "Müller.json")], lines.append, lambda *end: ends.append(end))
    LOOP.waitFor(lambda: ends)
    assert "Müller.json" in lines[-1]
