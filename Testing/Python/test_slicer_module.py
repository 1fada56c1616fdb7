"""The module file as Slicer loads it: what it registers, what it imports, and its own self test."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

slicer = pytest.importorskip("slicer", reason="slicer-core is not installed")

ROOT = Path(__file__).resolve().parents[2]
MODULE_FILE = ROOT / "VICRegistration" / "VICRegistration.py"
SELF_TESTS = ("test_fit", "test_refit", "test_furtherStack", "test_sceneBundle", "test_badSeed")


@pytest.fixture
def python(slicer_module, near_pelvis, monkeypatch):
    """The Python module of the module file; what several of its tests paint or fit is painted or fitted once."""
    import quick_fits

    quick_fits.cache(monkeypatch)
    monkeypatch.setattr("VICRegistrationLib.mrml.samples.phantom", lambda: near_pelvis)
    return sys.modules["VICRegistration"]


def test_the_module_is_told_to_slicer(slicer_module):
    parent = slicer.modules.VICRegistrationInstance.parent
    assert parent.title == "VIC Registration"
    assert parent.categories == ["Segmentation"]
    assert "not for clinical use" in parent.helpText
    assert "10.1111/str.12305" in parent.acknowledgementText


def test_the_phantom_is_offered_as_sample_data(slicer_module, pelvis, monkeypatch):
    import SampleData

    # As it is painted for other tests too.
    monkeypatch.setattr("VICRegistrationLib.phantoms.pelvis.pelvis_phantom", lambda: pelvis)
    slicer.app.startupCompleted()
    source = SampleData.SampleDataLogic().sourceForSampleName("VIC pelvis phantom")
    volume = source.customDownloader(source)
    assert volume.GetName() == "VIC pelvis phantom"
    assert slicer.util.arrayFromVolume(volume).shape == (28, 512, 512)
    assert SampleData.SampleDataLogic().sourceForSampleName("VIC pelvis phantom, axial")


@pytest.mark.parametrize("name", SELF_TESTS)
def test_the_self_test_passes(python, name):
    case = python.VICRegistrationTest()
    case.setUp()
    getattr(case, name)()


def test_the_self_test_runs_every_test(python):
    assert {name for name in vars(python.VICRegistrationTest) if name.startswith("test_")} == set(SELF_TESTS)


def test_a_panel_that_is_not_entered_follows_the_scene(recorded, slicer_module):
    # As where a script asks for the panel without a main window to show it in.
    widget = slicer.util.getModuleWidget("VICRegistration")
    volume = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "MRI")
    widget.ui.volumeSelector.setCurrentNode(volume)
    assert widget.panel.parameters.volume is volume
    widget.ui.addOrganButton.click()
    assert widget.ui.organsTable.rowCount == 1


def test_the_module_file_stays_thin():
    text = MODULE_FILE.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 400
    imported = {
        alias.name.split(".")[0]
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert not imported & {"numpy", "scipy", "vtk", "SimpleITK", "qt", "ctk"}


def test_loading_the_module_imports_nothing_heavy():
    """Slicer loads every module at start: what computes is imported when it is first needed."""
    program = (
        "import sys\n"
        "from slicer_stand_ins.install import loadModule\n"
        f"loadModule({str(MODULE_FILE)!r})\n"
        "print(sorted({'scipy', 'SimpleITK', 'matplotlib'} & set(sys.modules)))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", program], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"
