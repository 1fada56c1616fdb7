"""What several test files share: the demo's phantom and the real images beside the checkout."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

# Before numpy is loaded: its own and scipy's threads wait for each other on small matrices when cores are busy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


# Files whose tests fit organs to have some surface: the finer net, which takes most of the time, is not their subject.
_ANY_SURFACE = ("test_mrml_", "test_panel", "test_cli_errors", "test_export_cli", "test_compare_cli", "test_pictures")
_OWN_NET = ("test_mrml_fit", "test_mrml_bundle")


# Tests that take long and have shorter siblings; they run where this variable is set.
_LONG_VARIABLE = "VICREGISTRATION_LONG_TESTS"
_LONG = (
    "test_benchmark.py::test_energies_of_both_problems_are_told",
    "test_benchmark.py::test_random_organs_are_meshed_and_counted",
    "test_benchmark.py::test_a_correction_is_timed_against_the_fit",
    "test_bent_model.py::test_bent_organs_are_fitted_as_well_as_straight_ones[180]",
    "test_bent_model.py::test_the_tube_lies_along_the_organ[paper",
    "test_cli_errors.py::test_a_name_that_looks_like_a_formula_is_drawn_as_it_is",
    "test_gaps.py::test_overlapping_balls_have_a_lens_in_common[49.5",
    "test_mesh_organs.py::test_the_demo_organs_are_meshed_well[rectum",
    "test_mesh_organs.py::test_the_demo_organs_are_meshed_well[vagina",
    "test_organ.py::test_a_large_net_fits_too",
    "test_report_html.py::test_without_pictures_there_is_no_page_and_no_old_one",
    "test_step_meshers.py::test_an_assembly_is_read_and_meshed[netgen",
)


def pytest_collection_modifyitems(items):
    """Skip what takes long unless it is asked for."""
    if os.environ.get(_LONG_VARIABLE):
        return
    reason = pytest.mark.skip(reason=f"takes long; set {_LONG_VARIABLE}=1 to run it")
    for item in items:
        if item.nodeid.rpartition("/")[2].startswith(_LONG):
            item.add_marker(reason)


@pytest.fixture(autouse=True)
def coarser_net(request, monkeypatch):
    """Leave out the finer net where any surface does."""
    module = request.module.__name__
    if not module.startswith(_ANY_SURFACE) or module.startswith(_OWN_NET):
        return
    from VICRegistrationLib.registration import automatic

    def finer(plan, scaled, found, options, anchor):
        yield from ()
        return found, "no finer one was tried"

    monkeypatch.setattr(automatic, "_finer", finer)


@pytest.fixture(scope="session")
def pelvis():
    """The demo's MRI of a pelvis with its default settings; painting it takes some seconds."""
    from VICRegistrationLib.phantoms.pelvis import pelvis_phantom

    return pelvis_phantom()


@pytest.fixture(scope="session")
def shared_data():
    """Folder of real images, which are no part of the project."""
    folder = Path(__file__).resolve().parents[3] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("there is no folder ../shared/data of real images beside the project")
    return folder


@pytest.fixture(scope="session")
def slicer_bench():
    """Slicer's real scene and stand-ins for the rest, so that code for Slicer can be imported."""
    pytest.importorskip("slicer", reason="slicer-core is not installed")
    from slicer_stand_ins.bench import install

    return install()


@pytest.fixture
def scene(slicer_bench, monkeypatch):
    """An empty slicer.mrmlScene; errors in its observers, which VTK only prints, fail the test."""
    import mrml_boot

    errors = []
    monkeypatch.setattr(sys, "excepthook", lambda kind, error, trace: errors.append(error))
    mrml_boot.clear(slicer_bench.scene)
    yield slicer_bench.scene
    mrml_boot.clear(slicer_bench.scene)
    if errors:
        raise errors[0]


@pytest.fixture
def vtk_messages(scene):
    """Function that gives what VTK and MRML have complained of since the test began; Slicer logs that in red."""
    import vtk

    kept, window = vtk.vtkOutputWindow.GetInstance(), vtk.vtkStringOutputWindow()
    vtk.vtkOutputWindow.SetInstance(window)
    yield window.GetOutput
    vtk.vtkOutputWindow.SetInstance(kept)


@pytest.fixture
def slicer_module(scene):
    """The module VICRegistration as slicer.modules.vicregistration, loaded from its file."""
    from slicer_stand_ins.bench import loadModule

    module = loadModule(Path(__file__).resolve().parents[2] / "VICRegistration" / "VICRegistration.py")
    yield module
    module.unload()


@pytest.fixture
def logic(slicer_module):
    """A new logic of the module."""
    import mrml_scenes

    return mrml_scenes.logic()


@pytest.fixture
def organ(logic):
    """An organ whose surface is the small phantom's ellipsoid, without a fit."""
    import mrml_references
    import mrml_scenes

    return mrml_references.add_organ(logic, "bladder", mrml_scenes.add_volume())


@pytest.fixture
def recorded(scene):
    """Modules qt and ctk, and Slicer's widgets, as recorded in a real Slicer; .loop is their event loop."""
    from recorded_widgets import record

    if not (record.FOLDER / "qt.json").is_file():
        pytest.skip("there is no folder ../shared/slicer-api, the record of Slicer's widgets, beside the project")
    from recorded_widgets.install import install

    bench = install()
    bench.loop.clear()
    yield bench
    bench.loop.clear()


@pytest.fixture
def qt(recorded):
    """The module qt made from the record."""
    import qt

    return qt


@pytest.fixture
def ctk(recorded):
    """The module ctk made from the record."""
    import ctk

    return ctk
