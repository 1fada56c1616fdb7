"""A folder of results belongs to one image: organs are added to it or replaced in it, and nothing of it is lost."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from quick_fits import without_finer_nets
from small_phantom import CENTER, SEED, ellipsoid, ellipsoid_image

import VICRegistrationLib
from VICRegistrationLib import cli
from VICRegistrationLib.cli import fitting, results_folder
from VICRegistrationLib.cli.configuration import organ_request
from VICRegistrationLib.cli.organ_entries import organ_entry, restored_organ
from VICRegistrationLib.cli.outputs import write_organ
from VICRegistrationLib.cli.stored_results import file_digest
from VICRegistrationLib.geometry.surface_file import read_surface_record, write_surface
from VICRegistrationLib.imaging.reading import read_image, write_image

pytestmark = pytest.mark.usefixtures("one_net", "small_pictures")

ROOT = Path(__file__).resolve().parents[2]
OTHER_SEED = "-10,10,-18"
ENDINGS = (".json", ".vtp", ".stl", "_convergence.csv")


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Folder with an image, the same under another name, one with another grey level, and references."""
    folder = tmp_path_factory.mktemp("images")
    image = ellipsoid_image()
    write_image(image, folder / "mri.nrrd")
    write_image(image, folder / "copy.nii.gz")
    image.array[0, 0, 0] += 1
    write_image(image, folder / "other.nrrd")
    (folder / "changed").mkdir()
    write_image(image, folder / "changed" / "mri.nrrd")
    write_surface(ellipsoid(), folder / "truth.json", name="bladder")
    return folder


@pytest.fixture(scope="module")
def plain(images, tmp_path_factory):
    """Folder of results of a bladder, with its exact solid and without pictures."""
    with pytest.MonkeyPatch.context() as patch:
        without_finer_nets(patch)
        folder = tmp_path_factory.mktemp("plain") / "out"
        assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures", "--step") == 0
    return folder


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
        assert cli.main([str(word) for word in [*words, "--output", base / "out", "--quiet"]]) == 0
    return base / "out"


@pytest.fixture
def folder(plain, tmp_path):
    """A copy of it, with a file of the user."""
    copy = shutil.copytree(plain, tmp_path / "out")
    (copy / "notes.txt").write_text("mine")
    return copy


def fit(image, organ, output, *more, seed=SEED):
    words = ["fit", image, "--organ", organ, "--seed", seed, "--output", output, "--quiet", *more]
    return cli.main([str(word) for word in words])


def report(folder):
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def check_report(folder, *, others=("notes.txt",)):
    """All files that the report names are there as they were written, and no others but the user's."""
    found = report(folder)
    files = {
        **found["files"],
        **{name: file for organ in found["organs"].values() for name, file in organ["files"].items()},
    }
    assert {name: file_digest(folder / name) for name in files} == files
    assert {path.name for path in folder.iterdir()} == {"report.json", *files, *others}
    return found


def configuration(tmp_path, *organs):
    path = tmp_path / "organs.json"
    path.write_text(json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": organs}))
    return path


def test_a_second_organ_is_added(images, folder, capsys):
    before = content(folder)
    assert fit(images / "mri.nrrd", "rectum", folder, seed=OTHER_SEED) == 0
    found = check_report(folder)
    assert list(found["organs"]) == ["bladder", "rectum"]
    assert found["organs"]["bladder"] == json.loads(before["report.json"])["organs"]["bladder"]
    after = content(folder)
    assert all(after[name] == before[name] for name in before if name != "report.json")
    assert set(after) - set(before) == {
        *(f"rectum{ending}" for ending in (*ENDINGS, ".png")),
        "overview.png",
        "report.html",
    }
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "bladder and rectum" in page
    assert "bladder.vtp, rectum.vtp" in page
    assert "bladder.step" in page
    assert capsys.readouterr().err == ""


def test_an_organ_is_replaced_and_what_would_show_the_old_one_is_removed(images, folder, capsys):
    assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures", "--net", "7x6") == 0
    found = check_report(folder)
    assert found["organs"]["bladder"]["net"] == "7x6"
    assert not (folder / "bladder.step").exists()
    assert capsys.readouterr().err == f"removed from {folder}, as outdated: bladder.step\n"


def test_a_second_fit_with_step_keeps_its_solids(images, folder, capsys):
    before = (folder / "bladder.step").read_bytes()
    assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures", "--step", "--net", "7x6") == 0
    assert "bladder.step" in check_report(folder)["organs"]["bladder"]["files"]
    assert (folder / "bladder.step").read_bytes() != before
    assert capsys.readouterr().err == ""


def test_the_assembly_holds_all_organs_and_goes_with_its_first_change(images, folder, capsys):
    common = (images / "mri.nrrd", "rectum", folder, "--no-pictures")
    assert fit(*common, "--step", seed=OTHER_SEED) == 0
    text = (folder / "organs.step").read_text(encoding="ascii")
    assert "'bladder'" in text
    assert "'rectum'" in text
    assert set(check_report(folder)["files"]) == {"organs.step"}
    assert fit(*common, seed=OTHER_SEED) == 0
    assert check_report(folder)["files"] == {}
    assert capsys.readouterr().err == f"removed from {folder}, as outdated: organs.step, rectum.step\n"


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


def refer(folder, organ, reference):
    """Write into the report what an organ was compared with."""
    content = report(folder)
    content["organs"][organ]["reference"] = reference
    del content["digest"]
    (folder / "report.json").write_text(json.dumps(content))


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


def test_another_image_is_refused_and_nothing_changes(images, folder, capsys):
    before = content(folder)
    assert fit(images / "other.nrrd", "rectum", folder, "--no-pictures") == 2
    line = capsys.readouterr().err
    assert f"The folder {folder} holds results of another image, {images / 'mri.nrrd'}; choose another folder" in line
    assert fit(images / "changed" / "mri.nrrd", "rectum", folder, "--no-pictures") == 2
    assert "holds results of an earlier version of" in capsys.readouterr().err
    assert content(folder) == before


def test_the_image_may_be_called_otherwise(images, folder):
    assert fit(images / "copy.nii.gz", "rectum", folder, "--no-pictures") == 0
    assert list(check_report(folder)["organs"]) == ["bladder", "rectum"]


@pytest.mark.parametrize("name", ["rectum.json", "rectum.step", "organs.step"])
def test_files_of_the_user_are_not_replaced(images, folder, capsys, name):
    (folder / name).write_text("mine")
    before = content(folder)
    assert fit(images / "mri.nrrd", "rectum", folder, "--no-pictures", "--step") == 2
    assert f"{folder / name} is there and is no result of a fit; move it elsewhere" in capsys.readouterr().err
    assert content(folder) == before


def test_a_result_that_the_user_has_changed_is_the_users(images, folder, capsys):
    with (folder / "bladder.stl").open("ab") as file:
        file.write(b"\n")
    before = content(folder)
    assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures") == 2
    assert "bladder.stl was changed since it was written; move it elsewhere" in capsys.readouterr().err
    assert content(folder) == before


def test_an_outdated_result_that_the_user_has_changed_stays(images, folder, capsys):
    (folder / "bladder.step").write_text("mine")
    assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures") == 0
    assert (folder / "bladder.step").read_text() == "mine"
    check_report(folder, others=("notes.txt", "bladder.step"))
    assert "bladder.step is outdated; it was changed since it was written, so it is left" in capsys.readouterr().err


def test_who_removes_a_surface_takes_the_organ_out(images, folder, capsys):
    (folder / "bladder.json").unlink()
    assert fit(images / "mri.nrrd", "rectum", folder, "--no-pictures") == 0
    assert list(check_report(folder)["organs"]) == ["rectum"]
    told = capsys.readouterr().err
    assert f"no longer in the report, as the surface was removed from {folder}: bladder" in told
    assert "bladder.vtp" in told


def test_an_earlier_organ_that_is_damaged_is_told_before_the_fit(images, folder, capsys, monkeypatch):
    (folder / "bladder_convergence.csv").write_text("nothing")
    monkeypatch.setattr(fitting, "separate", lambda *arguments, **options: pytest.fail("no organ must be fitted"))
    before = content(folder)
    assert fit(images / "mri.nrrd", "rectum", folder) == 2
    line = capsys.readouterr().err
    assert "The organ bladder of an earlier run" in line
    assert f"fit it again too, or remove {folder / 'bladder.json'}" in line
    assert content(folder) == before


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "is damaged"),
        ("[]", "is no report of a fit"),
        ('{"schema": "mine"}', "is no report of a fit, and one would replace it"),
        ('{"schema": "vic-registration/report", "version": 1}', "has version 1, and version 2 is understood"),
    ],
)
def test_a_report_that_cannot_be_continued_is_refused(images, folder, capsys, text, told):
    (folder / "report.json").write_text(text)
    before = content(folder)
    assert fit(images / "mri.nrrd", "rectum", folder, "--no-pictures") == 2
    line = capsys.readouterr().err
    assert told in line
    assert "choose another folder by --output, or remove it" in line
    assert content(folder) == before


def test_a_report_that_was_changed_by_hand_is_refused(images, folder, capsys):
    found = report(folder)
    (folder / "report.json").write_text(json.dumps({**found, "organs": {"bladder": None}}))
    before = content(folder)
    assert fit(images / "mri.nrrd", "rectum", folder, "--no-pictures") == 2
    assert "report.json was changed since it was written; restore it, choose another" in capsys.readouterr().err
    assert content(folder) == before


def test_a_report_that_says_the_same_in_other_words_is_continued(images, folder):
    found = report(folder)
    (folder / "report.json").write_text(json.dumps(dict(reversed(found.items()))))
    assert fit(images / "mri.nrrd", "rectum", folder, "--no-pictures", seed=OTHER_SEED) == 0
    assert sorted(report(folder)["organs"]) == ["bladder", "rectum"]


def test_a_name_that_differs_in_its_case_is_refused(images, folder, capsys):
    assert fit(images / "mri.nrrd", "Bladder", folder, "--no-pictures") == 2
    assert "holds an organ bladder; name it like that" in capsys.readouterr().err


def test_a_reference_of_an_earlier_run_that_is_gone_is_told(images, folder, capsys):
    refer(folder, "bladder", {"path": str(folder / "gone.json"), "label": None, "largest": False, "frame": None})
    assert fit(images / "mri.nrrd", "rectum", folder, seed=OTHER_SEED) == 0
    told = capsys.readouterr().err
    assert "bladder: warning: report.html is without its reference, which cannot be read again" in told
    assert "gone.json" in told
    check_report(folder)


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


def test_a_disk_that_fills_up_leaves_the_old_results(images, folder, capsys, monkeypatch):
    before = content(folder)

    def full(organ, drafts):
        write_organ(organ, drafts)
        raise OSError(errno.ENOSPC, "No space left on device", str(drafts / "bladder.vtp"))

    monkeypatch.setattr(results_folder, "write_organ", full)
    assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "No space left on device" in line
    assert str(folder / "bladder.vtp") in line
    assert content(folder) == before


def test_a_disk_that_fills_up_while_files_are_moved_leaves_the_old_results(images, folder, capsys, monkeypatch):
    before = content(folder)
    replace = os.replace

    def full(source, target):
        if str(target) == str(folder / "bladder_convergence.csv") and "drafts" in Path(source).parts:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    assert fit(images / "mri.nrrd", "bladder", folder, "--no-pictures", "--net", "7x6") == 2
    assert "It was left as it was" in capsys.readouterr().err
    assert content(folder) == before


@pytest.mark.skipif(os.name == "nt", reason="the environment is put together for POSIX")
def test_two_runs_at_the_same_time_both_leave_their_organ(images, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(VICRegistrationLib.__file__).parents[1])}
    start = [sys.executable, "-m", "VICRegistrationLib", "fit", str(images / "mri.nrrd"), "--seed=" + SEED]
    more = ["--net", "7x6", "--no-pictures", "--quiet", "--output", str(tmp_path / "out")]
    runs = [
        subprocess.Popen([*start, "--organ", name, *more], env=environment, stderr=subprocess.PIPE)
        for name in ("bladder", "rectum", "uterus")
    ]
    assert [run.communicate()[1] for run in runs] == [b""] * 3
    assert [run.returncode for run in runs] == [0, 0, 0]
    assert set(check_report(tmp_path / "out", others=())["organs"]) == {"bladder", "rectum", "uterus"}


def test_surfaces_of_all_runs_are_what_the_report_says(images, folder):
    assert fit(images / "mri.nrrd", "rectum", folder, "--no-pictures", seed=OTHER_SEED) == 0
    for name, organ in report(folder)["organs"].items():
        record = read_surface_record(folder / f"{name}.json")
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


@pytest.mark.skipif(os.name == "nt", reason="Windows has no fork")
def test_fits_that_are_ended_at_random_moments_leave_old_or_new_results():
    """A few of the moments of the benchmark, which takes 100."""
    run = subprocess.run(
        [sys.executable, ROOT / "Testing" / "benchmarks" / "kills.py", "--moments", "3"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "3 fits of about" in run.stdout
