"""A folder of results where the disk fills up, runs meet, or a run is ended: the old results or the new ones."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from results_runs import check_report, content, fit
from small_phantom import SEED

import VICRegistrationLib
from VICRegistrationLib.cli import results_folder
from VICRegistrationLib.cli.outputs import write_organ

pytestmark = pytest.mark.usefixtures("one_net", "small_pictures")

ROOT = Path(__file__).resolve().parents[2]


def test_a_disk_that_fills_up_leaves_the_old_results(images, results, capsys, monkeypatch):
    before = content(results)

    def full(organ, drafts):
        write_organ(organ, drafts)
        raise OSError(errno.ENOSPC, "No space left on device", str(drafts / "bladder.vtp"))

    monkeypatch.setattr(results_folder, "write_organ", full)
    assert fit(images / "mri.nrrd", "bladder", results, "--no-pictures") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "No space left on device" in line
    assert str(results / "bladder.vtp") in line
    assert content(results) == before


def test_a_disk_that_fills_up_while_files_are_moved_leaves_the_old_results(images, results, capsys, monkeypatch):
    before = content(results)
    replace = os.replace

    def full(source, target):
        if str(target) == str(results / "bladder_convergence.csv") and "drafts" in Path(source).parts:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    assert fit(images / "mri.nrrd", "bladder", results, "--no-pictures", "--net", "7x6") == 2
    assert "It was left as it was" in capsys.readouterr().err
    assert content(results) == before


@pytest.mark.skipif(os.name == "nt", reason="the environment is put together for POSIX")
def test_two_runs_at_the_same_time_both_leave_their_organ(images, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(VICRegistrationLib.__file__).parents[1])}
    start = [sys.executable, "-m", "VICRegistrationLib", "fit", str(images / "mri.nrrd"), "--seed=" + SEED]
    more = ["--net", "7x6", "--no-pictures", "--quiet", "--output", str(tmp_path / "out")]
    runs = [
        subprocess.Popen([*start, "--organ", name, *more], env=environment, stderr=subprocess.PIPE)
        for name in ("bladder", "rectum")
    ]
    assert [run.communicate()[1] for run in runs] == [b""] * 2
    assert [run.returncode for run in runs] == [0, 0]
    assert set(check_report(tmp_path / "out", others=())["organs"]) == {"bladder", "rectum"}


@pytest.mark.skipif(os.name == "nt", reason="Windows has no fork")
def test_fits_that_are_ended_at_random_moments_leave_old_or_new_results():
    """A few of the moments of the benchmark, which takes 100."""
    run = subprocess.run(
        [sys.executable, ROOT / "Testing" / "benchmarks" / "kills.py", "--moments", "2"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "2 fits of about" in run.stdout
