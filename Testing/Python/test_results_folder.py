"""A folder of results belongs to one image: organs are added to it or replaced in it, and nothing of it is lost."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from quick_fits import cache, compare_few_points, without_finer_nets
from results_runs import OTHER_SEED, check_report, configuration, content, fit, refer, report
from small_phantom import CENTER

from VICRegistrationLib import cli
from VICRegistrationLib.cli import fitting
from VICRegistrationLib.cli.configuration import organ_request
from VICRegistrationLib.cli.organ_entries import organ_entry, restored_organ
from VICRegistrationLib.geometry.surface_file import read_surface_record
from VICRegistrationLib.imaging.reading import read_image

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "few_points", "small_pictures")

ROOT = Path(__file__).resolve().parents[2]
ENDINGS = (".json", ".vtp", ".stl", "_convergence.csv")


@pytest.fixture(scope="module")
def pictured(images, small_pictures, tmp_path_factory):
    """Folder of results of two organs with their pictures and a reference, from one run."""
    base = tmp_path_factory.mktemp("pictured")
    config = configuration(
        base,
        {"organ": "bladder", "seed": CENTER.tolist(), "dilation": 1.5, "net": "7x6"},
        {"organ": "rectum", "seed": [-10, 10, -18]},
    )
    words = ["fit", images / "mri.nrrd", "--config", config, "--reference", images / "truth.json"]
    with pytest.MonkeyPatch.context() as patch:
        without_finer_nets(patch)
        cache(patch)
        compare_few_points(patch)
        assert cli.main([str(word) for word in [*words, "--output", base / "out", "--quiet"]]) == 0
    return base / "out"


def test_a_second_organ_is_added(images, results, capsys):
    before = content(results)
    assert fit(images / "mri.nrrd", "rectum", results, seed=OTHER_SEED) == 0
    found = check_report(results)
    assert list(found["organs"]) == ["bladder", "rectum"]
    assert found["organs"]["bladder"] == json.loads(before["report.json"])["organs"]["bladder"]
    after = content(results)
    assert all(after[name] == before[name] for name in before if name != "report.json")
    assert set(after) - set(before) == {
        *(f"rectum{ending}" for ending in (*ENDINGS, ".png")),
        "overview.png",
        "report.html",
    }
    page = (results / "report.html").read_text(encoding="utf-8")
    assert "bladder and rectum" in page
    assert "bladder.vtp, rectum.vtp" in page
    assert "bladder.step" in page
    assert capsys.readouterr().err == ""


def test_an_organ_is_replaced_and_what_would_show_the_old_one_is_removed(images, results, capsys):
    assert fit(images / "mri.nrrd", "bladder", results, "--no-pictures", "--net", "7x6") == 0
    found = check_report(results)
    assert found["organs"]["bladder"]["net"] == "7x6"
    assert not (results / "bladder.step").exists()
    assert capsys.readouterr().err == f"removed from {results} because outdated: bladder.step\n"


def test_a_second_fit_with_step_keeps_its_solids(images, results, capsys):
    before = (results / "bladder.step").read_bytes()
    assert fit(images / "mri.nrrd", "bladder", results, "--no-pictures", "--step", "--net", "7x6") == 0
    assert "bladder.step" in check_report(results)["organs"]["bladder"]["files"]
    assert (results / "bladder.step").read_bytes() != before
    assert capsys.readouterr().err == ""


def test_the_assembly_holds_all_organs_and_goes_with_its_first_change(images, results, capsys):
    common = (images / "mri.nrrd", "rectum", results, "--no-pictures")
    assert fit(*common, "--step", seed=OTHER_SEED) == 0
    text = (results / "organs.step").read_text(encoding="ascii")
    assert "'bladder'" in text
    assert "'rectum'" in text
    assert set(check_report(results)["files"]) == {"organs.step"}
    assert fit(*common, seed=OTHER_SEED) == 0
    assert check_report(results)["files"] == {}
    assert capsys.readouterr().err == f"removed from {results} because outdated: organs.step, rectum.step\n"


def test_the_page_of_an_earlier_organ_is_as_it_was(images, pictured, tmp_path):
    """The whole page, made again from the files, shows what it showed after the fit."""
    first = ("--dilation", "1.5", "--net", "7x6", "--no-pictures")
    assert fit(images / "mri.nrrd", "bladder", tmp_path, *first) == 0
    # Without pictures no reference may be given; the report is told of it as if it had been.
    refer(tmp_path, "bladder", report(pictured)["organs"]["bladder"]["reference"])
    truth = ("--reference", images / "truth.json")
    assert fit(images / "mri.nrrd", "rectum", tmp_path, *truth, seed=OTHER_SEED) == 0
    pages = [
        # Times and dates differ, and the files: a picture of the bladder by itself was never asked for.
        re.sub(r"\d+\.\d\d s |datetime=\S+|<time.*?/time>|bladder.png, ", "", page.read_text(encoding="utf-8"))
        for page in (pictured / "report.html", tmp_path / "report.html")
    ]
    assert pages[0].count("data:image/jpeg") == 9
    assert pages[0] == pages[1]


def test_an_organ_comes_back_as_it_was_written(images, tmp_path):
    image = read_image(images / "mri.nrrd")
    words = {"boundary": [(3.0, 8.0, -20.0)], "dilation": 1.5, "threshold": (450.0, 1200.0), "smoothness": 1e-4}
    requests = [organ_request("bladder", [CENTER], **words)]
    (organ,) = fitting.fit_to_folder(images / "mri.nrrd", requests, tmp_path / "out", pictures=False).organs
    entry = json.loads(json.dumps(organ_entry(organ)))
    back = restored_organ("bladder", entry, tmp_path / "out", image)
    np.testing.assert_array_equal(back.fit.surface.control_net, organ.fit.surface.control_net)
    np.testing.assert_array_equal(back.fit.region.mask, organ.fit.region.mask)
    np.testing.assert_allclose(back.fit.region.ijk_to_ras, organ.fit.region.ijk_to_ras, atol=1e-12)
    np.testing.assert_array_equal(back.fit.boundary_points, organ.fit.boundary_points)
    for name in ("offset", "threshold", "touches_border", "erosion", "diagnostics"):
        assert getattr(back.fit.region, name) == getattr(organ.fit.region, name)
    for name in ("converged", "cost_initial", "cost_final", "seconds", "options", "choices", "iterations"):
        assert getattr(back.fit, name) == getattr(organ.fit, name)
    for name in ("request", "seconds", "seconds_separation"):
        assert getattr(back, name) == getattr(organ, name)
    told = [(step.stage, step.iteration, step.cost, step.displacement, step.stopped_by) for step in back.fit.history]
    assert told == [
        (step.stage, step.iteration, step.cost, step.displacement, step.stopped_by) for step in organ.fit.history
    ]
    assert organ_entry(back) == organ_entry(organ)


def test_the_image_may_be_called_otherwise(images, results):
    assert fit(images / "copy.nii.gz", "rectum", results, "--no-pictures") == 0
    assert list(check_report(results)["organs"]) == ["bladder", "rectum"]


def test_pictures_of_all_organs_go_with_a_run_without(images, pictured, tmp_path, capsys):
    out = shutil.copytree(pictured, tmp_path / "out")
    assert {"report.html", "overview.png"} <= set(content(out))
    assert fit(images / "mri.nrrd", "rectum", out, "--no-pictures", seed=OTHER_SEED) == 0
    told = capsys.readouterr().err
    assert set(told.split("outdated: ")[1].strip().split(", ")) == {"report.html", "overview.png", "rectum.png"}
    assert "bladder.png" in content(out)
    check_report(out, others=())


def test_keep_going_keeps_what_works(images, tmp_path, capsys):
    config = configuration(
        tmp_path,
        {"organ": "outside", "seed": [500, 0, 0]},
        {"organ": "bladder", "seed": CENTER.tolist()},
        {"organ": "thin", "seed": CENTER.tolist(), "boundary": [20, 40, 10]},
    )
    words = ["fit", images / "mri.nrrd", "--config", config, "--output", tmp_path / "out", "--no-pictures", "--quiet"]
    words = [str(word) for word in words]
    assert cli.main(words) == 2
    assert not (tmp_path / "out").exists()
    capsys.readouterr()
    assert cli.main([*words, "--keep-going"]) == 3
    first, second, last = capsys.readouterr().err.splitlines()
    assert first.startswith("outside: error: The seed (500.0")
    assert second.startswith("thin: error: Boundary point 1")
    assert last == "2 of 3 organs could not be fitted: outside, thin"
    found = check_report(tmp_path / "out", others=())
    assert list(found["organs"]) == ["bladder"]
    assert list(found["failed"]) == ["outside", "thin"]
    assert found["failed"]["outside"].startswith("The seed (500.0")


def test_keep_going_with_nothing_that_works_is_an_error(images, tmp_path, capsys):
    config = configuration(tmp_path, {"organ": "outside", "seed": [500, 0, 0]})
    words = ["fit", images / "mri.nrrd", "--config", config, "--output", tmp_path / "out", "--keep-going", "--quiet"]
    assert cli.main([str(word) for word in words]) == 2
    assert "outside: The seed" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_surfaces_of_all_runs_are_what_the_report_says(images, results):
    assert fit(images / "mri.nrrd", "rectum", results, "--no-pictures", seed=OTHER_SEED) == 0
    for name, organ in report(results)["organs"].items():
        record = read_surface_record(results / f"{name}.json")
        assert (record.name, record.net) == (name, organ["net"])
        assert organ["volume_ml"] == pytest.approx(record.surface.volume() / 1000.0)


def test_every_key_of_the_report_is_documented(images, tmp_path):
    boundary = ("--boundary", "3,8,-20", "--no-pictures")
    assert fit(images / "mri.nrrd", "bladder", tmp_path / "out", *boundary) == 0
    found = report(tmp_path / "out")
    organ = found["organs"]["bladder"]
    text = (ROOT / "docs" / "file-formats.md").read_text(encoding="utf-8").partition("## report.json")[2]
    documented = set(re.findall(r"`(\w+)`", text))
    assert {*found, *organ, *organ["region"], *organ["choices"][0]} <= documented
    snippet = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    names = {}
    exec(snippet.replace('"organs"', repr(str(tmp_path / "out")), 1), names)
    spacing = np.prod(found["image_spacing_mm"])
    assert names["mask"].sum() * spacing / 1000.0 == pytest.approx(organ["separated_volume_ml"])
