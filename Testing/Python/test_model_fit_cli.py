"""``vic-registration model fit``: two organs of a model of three, in two stacks and one of noise."""

from __future__ import annotations

import contextlib
import io
import json
import shutil

import numpy as np
import pytest
from model_stacks import SEEDS, SHIFTS, stack, with_a_third_organ
from quick_fits import without_shapes

from VICRegistrationLib import cli
from VICRegistrationLib.geometry.surface_file import read_surface
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.multipatch.file import read_model

FILES = ("model.json", "model.step", "model.vtp", "model.png")


def config(folder, organs):
    path = folder / "organs.json"
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Stacks, a model with its landmarks, and a configuration with stacks of one organ alone."""
    folder, model = tmp_path_factory.mktemp("given"), with_a_third_organ()
    axial = stack("axial", moved=True)
    noise = np.random.default_rng(3).normal(200.0, 80.0, axial.array.shape)
    images = {"sag": stack("sagittal"), "ax": axial, "noise": Image(noise.astype(np.float32), axial.ijk_to_ras)}
    for name, image in images.items():
        write_image(image, folder / f"{name}.nii.gz")
    model.save(folder / "model.json")
    marks = {name: point.tolist() for name, point in model.landmarks.items()}
    (folder / "marks.json").write_text(json.dumps(marks), encoding="utf-8")
    organs = [{"organ": name, "seed": seeds.tolist()} for name, seeds in SEEDS.items()]
    organs[0]["also"] = ["noise.nii.gz", "ax.nii.gz"]
    config(folder, organs)
    return folder


def model_fit(given, output, *words, organs=None):
    words = ["--config", organs or given / "organs.json", "--output", output, *words]
    return cli.main([*map(str, ["model", "fit", given / "sag.nii.gz", *words])])


@pytest.fixture(scope="module")
def told():
    """What the command writes on stderr."""
    return io.StringIO()


@pytest.fixture(scope="module")
def results(given, told, small_pictures, tmp_path_factory):
    pytest.importorskip("jinja2", reason="the page needs Jinja2")
    folder = tmp_path_factory.mktemp("results") / "out"
    words = ["--model", given / "model.json", "--landmarks", given / "marks.json", "--also", given / "ax.nii.gz"]
    # Nobody looks at these regions.
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(told):
        without_shapes(patch)
        assert model_fit(given, folder, *words) == 0
    return folder


@pytest.fixture(scope="module")
def report(results):
    return json.loads((results / "report.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(results):
    return (results / "report.html").read_text(encoding="utf-8")


def test_the_folder_holds_the_model_and_its_organs(results, report):
    names = {path.name for path in results.iterdir()}
    assert {*FILES, "report.html", "bladder.json", "vagina.json", "bladder_convergence.csv"} <= names
    # What the image does not show is no organ of its own.
    assert "rectum.json" not in names
    assert set(FILES) <= set(report["files"])


def test_the_model_s_organs_are_the_fitted_surfaces(results):
    model = read_model(results / "model.json")
    for name in ("bladder", "vagina"):
        assert np.allclose(model.parents[name].control_net, read_surface(results / f"{name}.json").control_net)
        assert not model.part(name).estimated
    assert model.part("rectum").estimated


def test_the_report_shows_what_was_predicted_and_estimated(given, report):
    entry = report["model"]
    assert entry["predicted"] == ["rectum"]
    assert entry["estimated"] == ["band"]
    assert entry["model"] == str(given / "model.json")
    assert set(entry["distance_from_region_mm"]) == {"bladder", "vagina"}
    # Regions are made of voxels of 1.2 x 1.2 x 4 mm.
    assert max(entry["distance_from_region_mm"].values()) < 1.0
    assert 0.3 < entry["smallest_determinant"] < 1.0
    assert set(entry["landmarks_mm"]) == {"peg"}
    assert entry["landmarks_mm"]["peg"] < 3.0
    assert {found["code"] for found in entry["diagnostics"]} == {"organ_predicted", "parts_estimated", "header_trusted"}


def test_the_page_calls_it_estimated_too(page):
    assert "Generic model: three organs" in page
    assert "rectum (estimated)" in page
    assert "band (estimated)" in page
    assert "The organ rectum was not given. The generic model predicts it" in page
    assert "Smallest determinant" in page


def test_the_report_shows_what_became_of_each_stack_as_fit_does(given, report):
    # Those of an organ are in place of those of the command line.
    uses = report["organs"]["bladder"]["stacks"]
    assert [use["file"] for use in uses] == [str(given / "noise.nii.gz"), str(given / "ax.nii.gz")]
    assert [use["used"] for use in uses] == [False, True]
    (use,) = report["organs"]["vagina"]["stacks"]
    assert (use["file"], use["used"]) == (str(given / "ax.nii.gz"), True)
    assert use["translation_mm"] == pytest.approx(SHIFTS["vagina"], abs=0.2)


def test_the_page_shows_each_organ_in_the_stack_that_was_used(page):
    assert page.count("in its own plane") == 2
    assert "Wherever the stack is moved, it shows no edge" in page


def test_motions_are_told(given, results, told):
    lines = told.getvalue()
    assert f"vagina: {given / 'ax.nii.gz'}, moved by R A S +0." in lines
    assert "model: grey levels, coarse, all stacks" in lines


def test_a_stack_is_not_replaced(given, tmp_path, capsys):
    (tmp_path / "model.vtp").write_bytes((given / "ax.nii.gz").read_bytes())
    assert model_fit(given, tmp_path, "--also", tmp_path / "model.vtp", "--no-pictures") == 2
    assert "model.vtp" in capsys.readouterr().err
    assert not (tmp_path / "report.json").exists()


def test_a_later_fit_of_one_organ_removes_the_model_which_would_not_show_it(capsys, given, results, tmp_path, one_net):
    folder = shutil.copytree(results, tmp_path / "out")
    seed = ",".join(map(str, SEEDS["bladder"][0]))
    words = ["fit", given / "sag.nii.gz", "--organ", "bladder", f"--seed={seed}", "--output", folder, "--no-pictures"]
    assert cli.main(list(map(str, words))) == 0
    assert "removed from" in capsys.readouterr().err
    assert not any((folder / name).exists() for name in FILES)
    stored = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert "model" not in stored
    assert list(stored["organs"]) == ["bladder", "vagina"]


def refused(capsys, given, tmp_path, *words, organs=None):
    path = organs and config(tmp_path, organs)
    assert model_fit(given, tmp_path / "out", "--no-pictures", *words, organs=path) == 2
    assert not (tmp_path / "out").exists()
    return capsys.readouterr().err


def test_one_organ_is_too_few(capsys, given, tmp_path):
    told = refused(capsys, given, tmp_path, organs=[{"organ": "bladder", "seed": [2, 25, 22]}])
    assert "at least 2 are needed to place the model" in told


def test_organs_of_other_names_are_refused(capsys, given, tmp_path):
    organs = [{"organ": "Blase", "seed": [2, 25, 22]}, {"organ": "vagina", "seed": [0, -7, -13]}]
    assert "no organ 'Blase'; it has bladder, vagina, rectum" in refused(capsys, given, tmp_path, organs=organs)


def test_boundary_points_are_refused(capsys, given, tmp_path):
    organs = [
        {"organ": "bladder", "seed": [2, 25, 22], "boundary": [[2, 58, 22]]},
        {"organ": "vagina", "seed": [0, -7, -13]},
    ]
    assert "bladder: boundary points were given" in refused(capsys, given, tmp_path, organs=organs)


def test_what_is_wrong_with_each_organ_is_printed_with_its_name(capsys, given, tmp_path):
    organs = [{"organ": name, "seed": [500, 0, 0]} for name in ("bladder", "vagina")]
    told = refused(capsys, given, tmp_path, organs=organs)
    assert "bladder: The seed (500.0, 0.0, 0.0) mm lies outside" in told
    assert "vagina: The seed (500.0, 0.0, 0.0) mm lies outside" in told


def test_a_model_that_is_not_there_is_refused(capsys, given, tmp_path):
    assert "give a file, or one of pelvis" in refused(capsys, given, tmp_path, "--model", tmp_path / "none.json")


def test_an_unknown_landmark_is_refused_before_the_work_with_those_of_the_pelvis_that_ships(capsys, given, tmp_path):
    (tmp_path / "marks.json").write_text('{"navel": [0, 80, 40]}', encoding="utf-8")
    told = refused(capsys, given, tmp_path, "--landmarks", tmp_path / "marks.json")
    assert "no landmark 'navel'; it has: symphysis, lower margin;" in told


def test_the_landmarks_of_a_model_are_listed(capsys):
    assert cli.main(["model", "show"]) == 0
    assert "landmarks: symphysis, lower margin; coccyx, tip;" in capsys.readouterr().out
