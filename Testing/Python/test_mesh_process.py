"""A gmsh that crashes, hangs, complains or returns nonsense: one message and no file."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from VICRegistrationLib import cli
from VICRegistrationLib.export.step import Solid
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.meshing import process
from VICRegistrationLib.meshing.organ_meshes import mesh_organs
from VICRegistrationLib.meshing.process import MeshingError, run_worker

HEAD = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from VICRegistrationLib.meshing.process import JobError, JobFolder, main
"""
# Takes the place of gmsh: the worker imports it and initializes it first.
GMSH = HEAD + "def initialize(**options):\n    place = JobFolder(Path(sys.argv[1]))\n    {body}\n    os._exit(0)\n"
WORKER = HEAD + "def work(place):\n    {body}\nsys.exit(main(work))\n"
POINTS = "np.array([[0., 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 30]])"
RESULT = "place.finish({{'points': {points}, 'tetrahedra': np.array({cells}), 'regions': np.zeros({n}, int)}}, {notes})"
NOTES = "{'volumes': [{'whole': 4 / 3 * np.pi * 8000 * 0.9998, 'given': {}}]}"
FAULTS = {
    "crash": ("os.kill(os.getpid(), signal.SIGKILL)", r"crashed \(signal 9\)"),
    "leaves": ("os._exit(3)", "failed .exit code 3"),
    "dies at import": ("", "failed .exit code 1: ModuleNotFoundError"),
    "hangs": ("time.sleep(600)", "not done after 1 s"),
    "nothing": ("pass", "ended without a result"),
    "garbage": ("Path(place.path('result.npz')).write_bytes(b'no archive')", "ended without a result"),
    "raises": ("raise RuntimeError('kernel says no')", "kernel says no"),
    "complains": ("raise JobError('Nothing is left of it; name it first.')", "Nothing is left of it"),
    "no tetrahedra": (
        RESULT.format(points=POINTS, cells="np.zeros((0, 4), int)", n=0, notes=NOTES),
        "returned no tetrahedra",
    ),
    "inverted": (RESULT.format(points=POINTS, cells="[[1, 0, 2, 3]]", n=1, notes=NOTES), "1 inverted element"),
    "wrong nodes": (RESULT.format(points=POINTS, cells="[[0, 1, 2, 9]]", n=1, notes=NOTES), "does not hold together"),
    "wrong volume": (RESULT.format(points=POINTS, cells="[[0, 1, 2, 3]]", n=1, notes=NOTES), "% off"),
    "wrong solid": (
        RESULT.format(points=POINTS, cells="[[0, 1, 2, 3]]", n=1, notes="{'volumes': [{'whole': 5.0, 'given': {}}]}"),
        "has read organ with",
    ),
    "not finite": (
        RESULT.format(points=f"np.nan * {POINTS}", cells="[[0, 1, 2, 3]]", n=1, notes=NOTES),
        "does not hold together",
    ),
}


def ball():
    return closed_organ((9, 7), axes=20.0 * np.eye(3))


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Put a module where Python finds it before all others, here and in the worker."""

    def install(name, text):
        folder = tmp_path / "modules"
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.py").write_text(text)
        monkeypatch.setenv("PYTHONPATH", str(folder))
        monkeypatch.syspath_prepend(str(folder))
        return name

    return install


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_faulty_mesher_leads_to_one_message_and_no_file(fault, module, tmp_path, capsys):
    body, told = FAULTS[fault]
    module("gmsh", "import a_module_that_is_not_there" if fault == "dies at import" else GMSH.format(body=body))
    write_surface(ball(), tmp_path / "organ.json", name="organ")
    words = ["mesh", str(tmp_path / "organ.json"), "--size", "5", "--output", str(tmp_path / "out" / "m.msh")]
    limit = ["--time-limit", "1"] if fault == "hangs" else []
    assert cli.main([*words, *limit, "--quiet"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("vic-registration: error: ")
    assert len(captured.err.splitlines()) == 1
    assert re.search(told, captured.err), captured.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["modules", "organ.json"]


def test_the_worker_finds_its_job_and_files_and_a_good_result_comes_back_with_progress(module):
    body = "place.progress('half'); time.sleep(0.3); place.finish({'n': np.load(place.path('x.npz'))['a']}, place.job)"
    told = []
    stub = module("stub_worker", WORKER.format(body=body))
    result = run_worker(stub, {"n": 7}, {"x.npz": {"a": np.arange(3)}}, on_progress=told.append)
    np.testing.assert_array_equal(result.arrays["n"], [0, 1, 2])
    assert result.notes["n"] == 7
    assert "half" in told


@pytest.mark.parametrize("reason", [KeyboardInterrupt, RuntimeError])
def test_what_ends_the_work_ends_the_process(module, tmp_path, reason):
    """Ctrl-C, a signal that a command takes for one, or an error."""
    pid = tmp_path / "pid"
    body = f"Path(r'{pid}').write_text(str(os.getpid())); place.progress('half'); time.sleep(600)"
    stub = module("stub_worker", WORKER.format(body=body))

    def interrupted(line):
        raise reason

    with pytest.raises(reason):
        run_worker(stub, {}, {}, on_progress=lambda line: line and interrupted(line))
    if sys.platform == "linux":
        assert not Path("/proc", pid.read_text()).exists()


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_worker_ends_when_its_parent_is_gone(tmp_path):
    """Killed hard, the program cannot end its worker; the worker notices."""
    started, job, worker = (tmp_path / name for name in ("pid", "job.json", "child.py"))
    job.write_text(json.dumps({"time_limit": 600}))
    worker.write_text(WORKER.format(body=f"Path(r'{started}').write_text(str(os.getpid())); time.sleep(600)"))
    parent = (
        "import subprocess, sys, time\n"
        "from pathlib import Path\n"
        f"subprocess.Popen([sys.executable, {str(worker)!r}, {str(job)!r}])\n"
        f"started = Path({str(started)!r})\n"
        "while not (started.exists() and started.read_text()):\n"
        "    time.sleep(0.05)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[2])}
    subprocess.run([sys.executable, "-c", parent], env=environment, check=True)
    child = Path("/proc", started.read_text())
    while child.exists() and "zombie" not in (child / "status").read_text():
        time.sleep(0.1)


def test_without_gmsh_the_way_to_install_it_is_told(monkeypatch):
    monkeypatch.setattr(process.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MeshingError, match=r"gmsh, which makes meshes, is not installed; .* pip install gmsh"):
        mesh_organs([Solid("organ", ball())])


def test_a_disk_without_room_for_temporary_files_is_told(module, monkeypatch, tmp_path, capsys):
    def full(self, data):
        raise OSError(28, "No space left on device")

    module("gmsh", "")
    write_surface(ball(), tmp_path / "organ.json")
    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    assert cli.main(["mesh", str(tmp_path / "organ.json"), "--output", str(tmp_path / "organ.msh")]) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1] == (
        "vic-registration: error: Temporary files for gmsh cannot be written (No space left on device); make room on "
        "that disk, or name a folder on another one by the environment variable TMPDIR."
    )
    assert not (tmp_path / "organ.msh").exists()
