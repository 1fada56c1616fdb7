"""Meshers that crash, hang, complain or return nonsense: one message and no file."""

from __future__ import annotations

import json
import re
import sys
import time

import numpy as np
import pytest

from VICRegistrationLib import cli
from VICRegistrationLib.export.step import Solid
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.meshing import tetrahedra
from VICRegistrationLib.meshing.options import MeshOptions
from VICRegistrationLib.meshing.process import MeshingCancelled, MeshingError, run_worker

STUB = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from VICRegistrationLib.meshing.worker import JobError, Workplace, main
def work(place):
{body}
sys.exit(main(work, name="The stub"))
"""
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
def stub(tmp_path, monkeypatch):
    """Put a worker with the given body in the place of gmsh's."""

    def install(body, *, head=""):
        folder = tmp_path / "modules"
        folder.mkdir(exist_ok=True)
        (folder / "stub_worker.py").write_text(head + STUB.format(body=f"    {body}"))
        monkeypatch.setenv("PYTHONPATH", str(folder))
        monkeypatch.setattr(tetrahedra, "require_mesher", lambda tool: "stub_worker")
        return "stub_worker"

    return install


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_faulty_mesher_leads_to_one_message_and_no_file(fault, stub, tmp_path, capsys):
    body, told = FAULTS[fault]
    stub(body or "pass", head="import a_module_that_is_not_there\n" if fault == "dies at import" else "")
    write_surface(ball(), tmp_path / "organ.json", name="organ")
    limit = "1" if fault == "hangs" else "60"
    words = [
        "mesh",
        tmp_path / "organ.json",
        "--size",
        "5",
        "--time-limit",
        limit,
        "--output",
        tmp_path / "out" / "m.msh",
    ]
    assert cli.main([*map(str, words), "--quiet"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("vic-registration: error: ")
    assert len(captured.err.splitlines()) == 1
    assert re.search(told, captured.err), captured.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["modules", "organ.json"]


def test_a_good_result_comes_back_with_progress(stub):
    module = stub("place.progress('half'); time.sleep(0.3); place.finish({'a': np.arange(3)}, {'b': 1})")
    told = []
    result = run_worker(module, {}, {}, name="The stub", time_limit=60.0, on_progress=told.append)
    np.testing.assert_array_equal(result.arrays["a"], [0, 1, 2])
    assert result.notes == {"b": 1}
    assert "half" in told


def test_the_worker_finds_its_job_and_files(stub):
    module = stub("place.finish({'n': np.array([place.job['n'], len(Path(place.path('x.bin')).read_bytes())])}, {})")
    result = run_worker(module, {"n": 7}, {"x.bin": b"12345"}, name="The stub", time_limit=60.0)
    np.testing.assert_array_equal(result.arrays["n"], [7, 5])


def test_work_can_be_cancelled_and_leaves_no_process(stub, tmp_path):
    module = stub(f"Path(r'{tmp_path / 'pid'}').write_text(str(os.getpid())); time.sleep(600)")
    started = tmp_path / "pid"
    with pytest.raises(MeshingCancelled, match="cancelled"):
        run_worker(module, {}, {}, name="The stub", time_limit=60.0, cancelled=started.exists)
    if started.read_text() and sys.platform == "linux":
        from pathlib import Path

        assert not Path("/proc", started.read_text()).exists()


def test_a_worker_ends_when_its_parent_is_gone(tmp_path):
    """Killed hard, the program cannot end its worker; the worker notices."""
    if sys.platform != "linux":
        pytest.skip("looks into /proc")
    import os
    import subprocess
    from pathlib import Path

    root = Path(__file__).resolve().parents[2] / "VICRegistration"
    (tmp_path / "job.json").write_text(json.dumps({"time_limit": 60}))
    worker = tmp_path / "child.py"
    body = f"Path(r'{tmp_path / 'pid'}').write_text(str(os.getpid())); time.sleep(600)"
    worker.write_text(STUB.format(body=f"    {body}"))
    parent = (
        "import subprocess, sys, time\n"
        f"subprocess.Popen([sys.executable, {str(worker)!r}, {str(tmp_path / 'job.json')!r}])\n"
        f"from pathlib import Path\nwhile not Path({str(tmp_path / 'pid')!r}).exists(): time.sleep(0.05)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-c", parent], env=environment, check=True)
    child = Path("/proc", (tmp_path / "pid").read_text())
    end = time.monotonic() + 20.0
    while child.exists() and "zombie" not in (child / "status").read_text() and time.monotonic() < end:
        time.sleep(0.1)
    assert not child.exists() or "zombie" in (child / "status").read_text()


def test_a_mesher_that_is_not_installed_is_told_with_the_way_to_install_it(monkeypatch):
    monkeypatch.setattr(tetrahedra.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MeshingError, match=r"gmsh is not installed; .*vicregistration\[mesh\]"):
        tetrahedra.mesh_organs([Solid("organ", ball())])
    with pytest.raises(MeshingError, match="Netgen is not installed"):
        tetrahedra.mesh_organs([Solid("organ", ball())], MeshOptions(tool="netgen"))


def test_a_disk_without_room_for_temporary_files_is_told(monkeypatch, tmp_path, capsys):
    def full(self, data):
        raise OSError(28, "No space left on device")

    write_surface(ball(), tmp_path / "organ.json")
    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    assert cli.main(["mesh", str(tmp_path / "organ.json"), "--output", str(tmp_path / "organ.msh")]) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1] == (
        "vic-registration: error: Temporary files for gmsh cannot be written (No space left on device); make room on "
        "that disk, or name a folder on another one by the environment variable TMPDIR."
    )
    assert not (tmp_path / "organ.msh").exists()
