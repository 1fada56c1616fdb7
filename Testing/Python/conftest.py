"""What several test files share: the demo's phantom and the real images beside the checkout."""

from __future__ import annotations

import functools
import gc
import os
import shutil
import sys
from pathlib import Path

import pytest

# Before numpy is loaded: its own and scipy's threads wait for each other on small matrices when cores are busy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


# Tests that take long and have shorter siblings are marked as long; they run where this variable is set.
_LONG_VARIABLE = "VICREGISTRATION_LONG_TESTS"


def pytest_collection_modifyitems(items):
    """Skip what takes long unless it is asked for."""
    if os.environ.get(_LONG_VARIABLE):
        return
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.skip(reason=f"takes long; set {_LONG_VARIABLE}=1 to run it"))


def pytest_collection_finish():
    """Leave what all tests have imported out of garbage collection, which looks at all of it each time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def kept_regions():
    """Separate the same organ of an image once where a fit begins with it; tests of separations do without this."""
    import quick_fits

    with pytest.MonkeyPatch.context() as patch:
        quick_fits.keep_regions(patch)
        yield


@pytest.fixture
def one_net(monkeypatch):
    """Fit without trying a finer net, for tests where any surface does: that takes most of the time."""
    import quick_fits

    quick_fits.without_finer_nets(monkeypatch)


@pytest.fixture
def cached_fits(one_net, monkeypatch):
    """One net, and a fit of the same image with the same options is run once, for tests of what is around fits."""
    import quick_fits

    quick_fits.cache(monkeypatch)


@pytest.fixture
def grown_regions(monkeypatch):
    """Separate by grey levels alone, for tests where any region does: that takes a small part of the time."""
    import quick_fits

    quick_fits.without_shapes(monkeypatch)


@pytest.fixture
def few_points(monkeypatch):
    """Compare surfaces by a tenth of the usual points, for tests of what is around a comparison."""
    import quick_fits

    quick_fits.compare_few_points(monkeypatch)


@pytest.fixture(scope="module")
def small_pictures():
    """Draw pictures with few pixels, for tests that do not look at them."""
    matplotlib = pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    with matplotlib.rc_context({"savefig.dpi": 30}):
        yield


@pytest.fixture(scope="session")
def image_path(tmp_path_factory, small_image):
    """File of the small phantom's image."""
    from VICRegistrationLib.imaging.reading import write_image

    path = tmp_path_factory.mktemp("image") / "mri.nii.gz"
    write_image(small_image, path)
    return path


@pytest.fixture
def output(tmp_path):
    """Folder with a file of the user, which has to survive."""
    folder = tmp_path / "output"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    return folder


@pytest.fixture
def refused(output, capsys):
    """Run a command that has to fail, and return its one line."""

    from VICRegistrationLib import cli

    def run(*words, code=2):
        try:
            found = cli.main([str(word) for word in words])
        except SystemExit as end:
            found = end.code
        captured = capsys.readouterr()
        assert found == code
        assert captured.out == ""
        lines = captured.err.splitlines()
        assert len(lines) == 1, lines
        assert [path.name for path in output.iterdir()] == ["notes.txt"]
        assert (output / "notes.txt").read_text() == "mine"
        assert [path.name for path in output.parent.iterdir() if path.name.startswith(".")] == []
        return lines[0]

    return run


@pytest.fixture
def refused_fit(refused, output):
    """Run a fit that has to fail, and return its one line."""

    def run(*words):
        line = refused("fit", *words, "--output", output, "--quiet", "--no-pictures")
        assert line.startswith("vic-registration: error: ")
        return line

    return run


@pytest.fixture(scope="session")
def images(tmp_path_factory):
    """Folder with an image, the same under another name, two others with another grey level, and a reference."""
    from small_phantom import ellipsoid, ellipsoid_image

    from VICRegistrationLib.geometry.surface_file import write_surface
    from VICRegistrationLib.imaging.reading import write_image

    folder, image = tmp_path_factory.mktemp("images"), ellipsoid_image()
    write_image(image, folder / "mri.nrrd")
    write_image(image, folder / "copy.nii.gz")
    image.array[0, 0, 0] += 1
    write_image(image, folder / "other.nrrd")
    (folder / "changed").mkdir()
    write_image(image, folder / "changed" / "mri.nrrd")
    write_surface(ellipsoid(), folder / "truth.json", name="bladder")
    return folder


@pytest.fixture(scope="session")
def fitted_bladder(images, tmp_path_factory):
    """Folder of results of a bladder, with its exact solid and without pictures."""
    from quick_fits import cache, without_finer_nets
    from results_runs import fit

    with pytest.MonkeyPatch.context() as patch:
        without_finer_nets(patch)
        cache(patch)
        folder = tmp_path_factory.mktemp("plain") / "out"
        assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures", "--step") == 0
    return folder


@pytest.fixture
def results(fitted_bladder, tmp_path):
    """A copy of it, with a file of the user."""
    copy = shutil.copytree(fitted_bladder, tmp_path / "out")
    (copy / "notes.txt").write_text("mine")
    return copy


@pytest.fixture(scope="session")
def pelvis():
    """The demo's MRI of a pelvis with its default settings; painting it takes some seconds."""
    from VICRegistrationLib.phantoms.pelvis import pelvis_phantom

    return pelvis_phantom()


@pytest.fixture(scope="session")
def near_pelvis(pelvis):
    """The same with the voxels around its organs alone: a scene takes a quarter of the time for them."""
    import dataclasses

    depth, rows, columns = pelvis.image.array.shape
    return dataclasses.replace(
        pelvis, image=pelvis.image.crop((0, rows // 4, columns // 4), (depth, 3 * rows // 4, 3 * columns // 4))
    )


@pytest.fixture(scope="session")
def pelvis_regions(pelvis):
    """Separated organs of the demo by name."""
    from VICRegistrationLib.segmentation import separation

    return {name: separation.separate(pelvis.image, seeds) for name, seeds in pelvis.seeds.items()}


@pytest.fixture(scope="session")
def pelvis_fit(pelvis):
    """Function that fits an organ of the demo with default options, each once."""
    from VICRegistrationLib.registration.organ import fit_organ
    from VICRegistrationLib.registration.steps import finish

    return functools.lru_cache(lambda organ: finish(fit_organ(pelvis.image, pelvis.seeds[organ])))


@pytest.fixture(scope="session")
def small_image():
    """The small phantom's image, of one bright organ."""
    from small_phantom import ellipsoid_image

    return ellipsoid_image()


@pytest.fixture(scope="session")
def small_fit(small_image):
    """Fit of the small phantom's organ with default options."""
    from small_phantom import CENTER

    from VICRegistrationLib.registration.organ import fit_organ
    from VICRegistrationLib.registration.steps import finish

    return finish(fit_organ(small_image, CENTER[None]))


@pytest.fixture(scope="session")
def small_coarse_fit(small_image):
    """Fit of the small phantom's organ with a net of 9 x 7."""
    from small_phantom import CENTER

    from VICRegistrationLib.registration.options import FitOptions
    from VICRegistrationLib.registration.organ import fit_organ
    from VICRegistrationLib.registration.steps import finish

    return finish(fit_organ(small_image, CENTER[None], FitOptions(net=(9, 7))))


@pytest.fixture(scope="session")
def shared_data():
    """Folder of real images, which are no part of the project."""
    folder = Path(__file__).resolve().parents[3] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("there is no folder ../shared/data of real images beside the project")
    return folder


@pytest.fixture(scope="session")
def stand_ins():
    """Slicer's real scene and stand-ins for the rest, so that code for Slicer can be imported."""
    pytest.importorskip("slicer", reason="slicer-core is not installed")
    from slicer_stand_ins.install import install

    return install()


@pytest.fixture
def scene(stand_ins, monkeypatch):
    """An empty slicer.mrmlScene; errors in its observers, which VTK only prints, fail the test."""
    import mrml_boot

    errors = []
    monkeypatch.setattr(sys, "excepthook", lambda kind, error, trace: errors.append(error))
    mrml_boot.clear(stand_ins.scene)
    yield stand_ins.scene
    mrml_boot.clear(stand_ins.scene)
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
    from slicer_stand_ins.install import loadModule

    module = loadModule(Path(__file__).resolve().parents[2] / "VICRegistration" / "VICRegistration.py")
    yield module
    module.unload()


@pytest.fixture
def logic(slicer_module):
    """A new logic of the module."""
    import mrml_scenes

    return mrml_scenes.logic()


@pytest.fixture
def demo_volume(logic, near_pelvis):
    """The demo's MRI in the scene, with seeds of bladder and vagina; nothing is separated yet."""
    import mrml_scenes

    from VICRegistrationLib.mrml.organ_nodes import seedsOf
    from VICRegistrationLib.mrml.points import addPoints

    node = mrml_scenes.add_volume(near_pelvis.image)
    logic.getParameterNode().volume = node
    for name in ("bladder", "vagina"):
        addPoints(seedsOf(logic.organs().add(name), node), near_pelvis.seeds[name])
    return node


@pytest.fixture
def fit_model(logic, demo_volume):
    """Function that fits the generic model that ships to that MRI."""
    from VICRegistrationLib.mrml.generic_model_fit import fitModel

    return lambda **choices: fitModel(logic.getParameterNode(), demo_volume, **choices)


@pytest.fixture
def model_nodes(slicer_module):
    """The module generic_model_nodes."""
    from VICRegistrationLib.mrml import generic_model_nodes

    return generic_model_nodes


@pytest.fixture
def organ(logic):
    """An organ whose surface is the small phantom's ellipsoid, without a fit."""
    import mrml_references
    import mrml_scenes

    return mrml_references.add_organ(logic, "bladder", mrml_scenes.add_volume())


@pytest.fixture
def recorded(scene):
    """Modules qt and ctk, and Slicer's widgets, as recorded in a real Slicer; .loop is their event loop."""
    from recorded_widgets.install import install

    widgets = install()
    widgets.loop.clear()
    yield widgets
    widgets.loop.clear()


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
