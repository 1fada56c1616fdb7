"""Folders of results that another image, a user or an accident has changed: what is refused, and what is kept."""

from __future__ import annotations

import json

import pytest
from results_runs import OTHER_SEED, check_report, content, fit, refer, report

from VICRegistrationLib.cli import fitting

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions", "small_pictures")


def test_another_image_is_refused_and_nothing_changes(images, results, capsys):
    before = content(results)
    assert fit(images / "other.nrrd", "rectum", results, "--no-pictures") == 2
    line = capsys.readouterr().err
    told = (
        f"The folder {results} has results of another image, {images / 'mri.nrrd'}, and a folder belongs to one image;"
    )
    assert f"{told} choose another folder" in line
    assert fit(images / "changed" / "mri.nrrd", "rectum", results, "--no-pictures") == 2
    assert "has results of an earlier version of" in capsys.readouterr().err
    assert content(results) == before


@pytest.mark.parametrize("name", ["rectum.json", "rectum.step", "organs.step"])
def test_files_of_the_user_are_not_replaced(images, results, capsys, name):
    (results / name).write_text("mine")
    before = content(results)
    assert fit(images / "mri.nrrd", "rectum", results, "--no-pictures", "--step") == 2
    assert f"{results / name} exists and is no result of a fit; move it elsewhere" in capsys.readouterr().err
    assert content(results) == before


def test_a_result_that_the_user_has_changed_is_the_users(images, results, capsys):
    with (results / "bladder.stl").open("ab") as file:
        file.write(b"\n")
    before = content(results)
    assert fit(images / "mri.nrrd", "bladder", results, "--no-pictures") == 2
    assert "bladder.stl was changed since it was written; move it elsewhere" in capsys.readouterr().err
    assert content(results) == before


def test_an_outdated_result_that_the_user_has_changed_stays(images, results, capsys):
    (results / "bladder.step").write_text("mine")
    assert fit(images / "mri.nrrd", "bladder", results, "--no-pictures") == 0
    assert (results / "bladder.step").read_text() == "mine"
    check_report(results, others=("notes.txt", "bladder.step"))
    assert "bladder.step is outdated, but is kept because it was changed" in capsys.readouterr().err


def test_who_removes_a_surface_takes_the_organ_out(images, results, capsys):
    (results / "bladder.json").unlink()
    assert fit(images / "mri.nrrd", "rectum", results, "--no-pictures") == 0
    assert list(check_report(results)["organs"]) == ["rectum"]
    told = capsys.readouterr().err
    assert f"no longer in the report, because the surface was removed from {results}: bladder" in told
    assert "bladder.vtp" in told


def test_an_earlier_organ_that_is_damaged_is_told_before_the_fit(images, results, capsys, monkeypatch):
    (results / "bladder_convergence.csv").write_text("nothing")
    monkeypatch.setattr(fitting, "separate", lambda *arguments, **options: pytest.fail("no organ must be fitted"))
    before = content(results)
    assert fit(images / "mri.nrrd", "rectum", results) == 2
    line = capsys.readouterr().err
    assert "The organ bladder of an earlier run" in line
    assert f"fit it again too, or remove {results / 'bladder.json'}" in line
    assert content(results) == before


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "is damaged"),
        ("[]", "is no report of a fit"),
        ('{"schema": "mine"}', "is no report of a fit, and would be replaced"),
        (
            '{"schema": "vic-registration/report", "version": 1}',
            "has version 1, but this version of the program reads version 2",
        ),
    ],
)
def test_a_report_that_cannot_be_continued_is_refused(images, results, capsys, text, told):
    (results / "report.json").write_text(text)
    before = content(results)
    assert fit(images / "mri.nrrd", "rectum", results, "--no-pictures") == 2
    line = capsys.readouterr().err
    assert told in line
    assert "choose another folder by --output, or remove it" in line
    assert content(results) == before


def test_a_report_that_was_changed_by_hand_is_refused(images, results, capsys):
    found = report(results)
    (results / "report.json").write_text(json.dumps({**found, "organs": {"bladder": None}}))
    before = content(results)
    assert fit(images / "mri.nrrd", "rectum", results, "--no-pictures") == 2
    assert "report.json was changed since it was written; restore it, choose another" in capsys.readouterr().err
    assert content(results) == before


def test_a_report_that_says_the_same_in_other_words_is_continued(images, results):
    found = report(results)
    (results / "report.json").write_text(json.dumps(dict(reversed(found.items()))))
    assert fit(images / "mri.nrrd", "rectum", results, "--no-pictures", seed=OTHER_SEED) == 0
    assert sorted(report(results)["organs"]) == ["bladder", "rectum"]


def test_a_name_that_differs_in_its_case_is_refused(images, results, capsys):
    assert fit(images / "mri.nrrd", "Bladder", results, "--no-pictures") == 2
    assert "has an organ bladder; use that name" in capsys.readouterr().err


def test_a_reference_of_an_earlier_run_that_is_gone_is_told(images, results, capsys):
    refer(results, "bladder", {"path": str(results / "gone.json"), "label": None, "largest": False, "frame": None})
    assert fit(images / "mri.nrrd", "rectum", results, seed=OTHER_SEED) == 0
    told = capsys.readouterr().err
    assert "bladder: warning: report.html does not show its reference, which cannot be read again" in told
    assert "gone.json" in told
    check_report(results)
