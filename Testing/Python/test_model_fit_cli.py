"""``vic-registration model fit``: the demo's MRI without its rectum."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from VICRegistrationLib import cli
from VICRegistrationLib.geometry.surface_file import read_surface
from VICRegistrationLib.imaging.reading import write_image
from VICRegistrationLib.multipatch.file import read_model
from VICRegistrationLib.multipatch.pelvis import pelvis as generic_pelvis


def config(folder, organs):
    path = folder / "organs.json"
    content = {"schema": "vic-registration/organs", "version": 1, "organs": organs}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def given(pelvis, tmp_path_factory):
    """Folder with the image, a configuration of two organs, and landmarks."""
    folder = tmp_path_factory.mktemp("given")
    write_image(pelvis.image, folder / "mri.nii.gz")
    config(folder, [{"organ": name, "seed": pelvis.seeds[name].tolist()} for name in ("bladder", "vagina")])
    marks = {name: point.tolist() for name, point in generic_pelvis().landmarks.items()}
    (folder / "marks.json").write_text(json.dumps(marks), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def results(given, small_pictures, tmp_path_factory):
    pytest.importorskip("jinja2", reason="the page needs Jinja2")
    folder = tmp_path_factory.mktemp("results") / "out"
    words = ["model", "fit", given / "mri.nii.gz", "--config", given / "organs.json", "--output", folder]
    assert cli.main([*map(str, words), "--landmarks", str(given / "marks.json"), "--quiet"]) == 0
    return folder


def test_the_folder_holds_the_model_and_its_organs(results):
    names = {path.name for path in results.iterdir()}
    assert {"model.json", "model.step", "model.vtp", "model.png", "report.html", "report.json"} <= names
    assert {"bladder.json", "vagina.json", "bladder_convergence.csv"} <= names
    # What the image does not show is no organ of its own.
    assert "rectum.json" not in names


def test_the_model_s_organs_are_the_fitted_surfaces(results):
    model = read_model(results / "model.json")
    for name in ("bladder", "vagina"):
        assert np.allclose(model.parents[name].control_net, read_surface(results / f"{name}.json").control_net)
        assert not model.part(name).estimated
    assert model.part("rectum").estimated


def test_the_report_shows_what_was_predicted_and_estimated(results):
    entry = json.loads((results / "report.json").read_text(encoding="utf-8"))["model"]
    assert entry["predicted"] == ["rectum"]
    assert "levator ani" in entry["estimated"]
    assert entry["model"] == "pelvis"
    assert set(entry["distance_from_region_mm"]) == {"bladder", "vagina"}
    # Regions are made of voxels of 0.6 x 0.6 x 4 mm.
    assert max(entry["distance_from_region_mm"].values()) < 1.0
    assert 0.3 < entry["smallest_determinant"] < 1.0
    assert max(entry["landmarks_mm"].values()) < 3.0
    assert {found["code"] for found in entry["diagnostics"]} == {"organ_predicted", "parts_estimated", "header_trusted"}


def test_the_page_calls_it_estimated_too(results):
    page = (results / "report.html").read_text(encoding="utf-8")
    assert "Generic model: pelvis" in page
    assert "rectum (estimated)" in page
    assert "levator ani (estimated)" in page
    assert "The organ rectum was not given; it is predicted" in page
    assert "Smallest determinant" in page


def test_files_of_the_model_belong_to_the_results(results):
    stored = json.loads((results / "report.json").read_text(encoding="utf-8"))
    assert {"model.json", "model.step", "model.vtp", "model.png"} <= set(stored["files"])


def test_a_later_fit_of_one_organ_removes_the_model_which_would_not_show_it(
    capsys, given, results, tmp_path, pelvis, one_net
):
    folder = shutil.copytree(results, tmp_path / "out")
    seeds = [f"--seed={','.join(map(str, seed))}" for seed in pelvis.seeds["bladder"].tolist()]
    words = ["fit", given / "mri.nii.gz", "--organ", "bladder", *seeds, "--output", folder, "--no-pictures"]
    assert cli.main(list(map(str, words))) == 0
    assert "removed from" in capsys.readouterr().err
    assert not any((folder / name).exists() for name in ("model.json", "model.step", "model.vtp", "model.png"))
    stored = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert "model" not in stored
    assert list(stored["organs"]) == ["bladder", "vagina"]


def refused(capsys, given, tmp_path, *words, organs=None):
    path = given / "organs.json" if organs is None else config(tmp_path, organs)
    output = tmp_path / "out"
    words = ["model", "fit", given / "mri.nii.gz", "--config", path, "--output", output, "--no-pictures", *words]
    assert cli.main(list(map(str, words))) == 2
    assert not output.exists()
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


def test_an_unknown_landmark_is_refused_before_the_work(capsys, given, tmp_path):
    (tmp_path / "marks.json").write_text('{"navel": [0, 80, 40]}', encoding="utf-8")
    assert "no landmark 'navel'" in refused(capsys, given, tmp_path, "--landmarks", tmp_path / "marks.json")


def test_the_landmarks_of_a_model_are_listed(capsys):
    assert cli.main(["model", "show"]) == 0
    assert "landmarks: symphysis, lower margin; coccyx, tip;" in capsys.readouterr().out
