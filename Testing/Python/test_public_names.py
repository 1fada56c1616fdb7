"""What `import VICRegistrationLib as vic` offers: fast to import, and with examples that run."""

from __future__ import annotations

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_phantom import CENTER, ellipsoid

import VICRegistrationLib as vic
from VICRegistrationLib.imaging.reading import write_image

ROOT = Path(__file__).resolve().parents[2]
# Formats that hold every control point, and those of triangles or solids.
EXACT, OTHERS = (".json", ".vtp"), (".step", ".stp", ".stl", ".ply")


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


@pytest.fixture(scope="module")
def fit(image):
    return vic.fit(image, CENTER, net=(9, 7))


@pytest.mark.parametrize("name", vic.__all__)
def test_examples_of_a_public_name_run(name):
    tests = [test for test in doctest.DocTestFinder().find(getattr(vic, name), name, globs={}) if test.examples]
    runner = doctest.DocTestRunner(verbose=False)
    for test in tests:
        runner.run(test)
    assert name in {test.name for test in tests}
    assert runner.failures == 0


def test_importing_the_package_imports_neither_numpy_nor_vtk():
    code = "import sys, VICRegistrationLib; print(*sys.modules)"
    path = os.pathsep.join(sys.path)
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": path}
    )
    loaded = {name.split(".")[0] for name in found.stdout.split()}
    assert not loaded & {"numpy", "scipy", "vtkmodules", "vtk", "SimpleITK", "matplotlib"}


def test_names_are_listed_and_others_are_an_attribute_error():
    assert set(vic.__all__) <= set(dir(vic))
    with pytest.raises(AttributeError, match="fitt"):
        vic.fitt  # noqa: B018


def test_the_page_explains_every_name():
    table = (ROOT / "docs/python.md").read_text(encoding="utf-8").split("## All names")[1]
    assert set(vic.__all__) <= set(re.findall(r"`(\w+)`", table))


def test_objects_are_shown_in_one_line(image, fit):
    assert repr(image) == "Image(52 x 56 x 22 voxels of 1.2 x 1.2 x 3 mm, int16)"
    large = vic.Image.from_array(np.zeros((2, 2, 1024), dtype=bool), np.eye(4))
    assert repr(large) == "Image(1024 x 2 x 2 voxels of 1 x 1 x 1 mm, bool)"
    assert "\n" not in repr(fit.confidence)
    for shown in (fit, fit.region, fit.surface):
        assert len(repr(shown)) < 120
        assert "\n" not in repr(shown)


def test_a_path_stands_for_the_image_in_it(image, fit, tmp_path):
    path = tmp_path / "mri.nii.gz"
    write_image(image, path)
    region = vic.separate(path, CENTER)
    np.testing.assert_array_equal(region.mask, fit.region.mask)
    for again in (vic.fit(str(path), CENTER, net=(9, 7)), vic.fit_region(path, region, net=(9, 7))):
        # Matrices of NIfTI files have single precision.
        np.testing.assert_allclose(again.surface.control_net, fit.surface.control_net, atol=1e-3)


def test_what_is_no_surface_or_no_region_is_refused_by_a_sentence(fit):
    for call in (
        lambda: vic.compare(fit, fit.surface),
        lambda: vic.compare(fit.surface, fit),
        lambda: vic.refit(fit.image, fit),
    ):
        with pytest.raises(TypeError, match="OrganFit was given; give that of a fit, which is fit.surface"):
            call()
    with pytest.raises(TypeError, match="A region is needed, and OrganFit was given; make one with separate"):
        vic.fit_region(fit.image, fit)


def test_a_label_may_be_a_path(image, fit, tmp_path):
    mask = fit.region.in_box((0, 0, 0), image.array.shape).astype(np.uint8)
    write_image(vic.Image(mask, image.ijk_to_ras), tmp_path / "label.nii.gz")
    found = vic.region_from_label(image, tmp_path / "label.nii.gz")
    np.testing.assert_array_equal(found.in_box((0, 0, 0), mask.shape), mask)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda image: vic.region_from_mask(image, image), "A mask is an array .* Image was given; region_from_label"),
        (lambda image: vic.fit(image, CENTER, {"net": (9, 7)}), "dict was given; give single ones .* net="),
        (lambda image: vic.fit_model(image, [CENTER]), "list was given as organs; a mapping is needed"),
    ],
)
def test_values_of_another_type_are_refused_by_a_sentence(image, call, told):
    with pytest.raises(TypeError, match=told):
        call(image)


@pytest.mark.parametrize("name", ["organ.stl", "organ.step", "organ"])
def test_a_file_without_control_points_is_refused_as_that(tmp_path, name):
    with pytest.raises(ValueError, match=r"holds no control points; those of a surface are in \.json and \.vtp files"):
        vic.read_surface(tmp_path / name)


@pytest.mark.parametrize("frame", ["1", 1.0, True])
def test_the_number_of_a_volume_is_a_whole_one(image, tmp_path, frame):
    write_image(image, tmp_path / "mri.nii.gz")
    with pytest.raises(ValueError, match=r"Volume \S+ was asked for; its number is a whole one, from 1"):
        vic.read_image(tmp_path / "mri.nii.gz", frame=frame)
    assert vic.read_image(tmp_path / "mri.nii.gz", frame=np.int64(1)).array.shape == image.array.shape


@pytest.mark.parametrize("call", [vic.separate, vic.fit, vic.fit_region, vic.refit, vic.region_from_mask])
def test_an_array_is_no_image(call):
    with pytest.raises(TypeError, match=r"ndarray was given; make one with Image.from_array\(array, ijk_to_ras\)"):
        call(np.zeros((5, 5, 5)), None)


def test_a_surface_may_be_given_by_its_path(fit, tmp_path):
    fit.surface.save(tmp_path / "organ.json")
    assert vic.compare(tmp_path / "organ.json", fit.surface, n_points=100).hausdorff < 1e-9


def test_single_choices_count_before_those_of_the_options(image):
    found = vic.fit(image, CENTER, vic.FitOptions(net=(17, 11), tau=2.0), net=(9, 7))
    assert (found.options.net, found.options.tau) == ((9, 7), 2.0)
    with pytest.raises(TypeError, match="There is no option nett; the options are .*net"):
        vic.fit(image, CENTER, nett=(9, 7))


def test_steps_are_handed_on(image, fit):
    steps = []
    vic.refit(image, fit.surface, on_step=steps.append)
    assert steps
    assert all(step.surface.control_net.shape == fit.surface.control_net.shape for step in steps)


@pytest.mark.parametrize("suffix", [*EXACT, *OTHERS, ".STL"])
def test_a_surface_is_saved_in_the_format_of_its_ending(tmp_path, suffix):
    path, surface = tmp_path / f"organ{suffix}", ellipsoid()
    surface.save(path)
    content = path.read_bytes()
    if suffix in EXACT:
        np.testing.assert_array_equal(vic.read_surface(path).control_net, surface.control_net)
    else:
        starts = {".step": b"ISO-10303-21", ".stp": b"ISO-10303-21", ".ply": b"ply"}
        assert content.startswith(starts.get(suffix, b"3D Slicer output"))


def test_another_ending_is_refused_by_a_sentence_with_those_there_are(tmp_path):
    with pytest.raises(ValueError, match=r"x.iges was asked for; .* \.json, \.step, \.stp, \.vtp, \.stl, \.ply\."):
        ellipsoid().save(tmp_path / "x.iges")
    assert list(tmp_path.iterdir()) == []


def test_triangles_are_as_fine_as_asked_for(tmp_path):
    sizes = []
    for chord_error in (0.1, 1.0):
        ellipsoid().save(tmp_path / "organ.stl", chord_error=chord_error)
        sizes.append(Path(tmp_path / "organ.stl").stat().st_size)
    assert sizes[0] > 5 * sizes[1]


def test_a_surface_is_compared_with_another_one_and_with_a_file(fit, tmp_path):
    ellipsoid().save(tmp_path / "truth.json")
    found = [vic.compare(fit.surface, reference, n_points=500) for reference in (ellipsoid(), tmp_path / "truth.json")]
    assert found[0].to_surface.mean == found[1].to_surface.mean < 0.2


def test_the_code_of_the_page_runs(image, fit, tmp_path, monkeypatch, capsys):
    page = "docs/python.md"
    labels = fit.region.in_box((0, 0, 0), image.array.shape).astype(np.uint8)
    monkeypatch.chdir(tmp_path)
    write_image(image, "scan.nii.gz")
    write_image(vic.Image(labels, image.ijk_to_ras), "labels.nii.gz")
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    names = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    assert (tmp_path / "bladder.step").is_file()
    assert "ml" in capsys.readouterr().out
