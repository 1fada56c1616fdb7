"""Run a job in a process of its own, whose crash does no harm: the side that starts it, and the worker's side.

:func:`run_worker` starts a module and reads its result; in the module, :func:`main` does the job. The job is a JSON
file in a temporary folder. The worker gets its path, and writes into the same folder

============= =====================================================================================
``result.npz`` arrays, written last
``notes.json`` an object with further results
``error.txt``  one sentence for the user, instead of a result
``progress``   one line on what it is doing
============= =====================================================================================
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import reason

GMSH_WORKER = "VICRegistrationLib.meshing.gmsh_worker"
PATCH_WORKER = "VICRegistrationLib.meshing.patch_worker"
JOB, RESULT, NOTES, ERROR, PROGRESS = "job.json", "result.npz", "notes.json", "error.txt", "progress"
_ROOT = Path(__file__).resolve().parents[2]
# Time between two checks of the worker, s.
_POLL_S = 0.05
_LONGEST_OUTPUT = 300


class MeshingError(RuntimeError):
    """Meshing has failed; the message is one sentence for the user."""


class MesherCrashed(MeshingError):
    """gmsh crashed, hung or returned nothing; it may work with another layout of the faces."""


def require_gmsh() -> None:
    """Refuse to go on without gmsh.

    Raises
    ------
    MeshingError
        If it is not installed.
    """
    if importlib.util.find_spec("gmsh") is None:
        msg = "gmsh, which makes meshes, is not installed; install it with: pip install gmsh"
        raise MeshingError(msg)


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a worker.

    Parameters
    ----------
    arrays : dict of ndarray
    notes : dict
    """

    arrays: dict[str, np.ndarray]
    notes: dict


def run_worker(
    module: str,
    job: Mapping,
    files: Mapping[str, str | bytes | Mapping[str, np.ndarray]],
    *,
    time_limit: float = math.inf,
    on_progress: Callable[[str], None] | None = None,
) -> Result:
    """Run a module as a process and read its result; whatever ends this function ends the process.

    Parameters
    ----------
    module : str
        Run as ``python -m module JOB``.
    job : mapping
        Values for JSON; the time limit is added as ``time_limit``.
    files : mapping of name to text, bytes or arrays
        Files to write beside the job; arrays by their names become an .npz file.
    time_limit : float
        Seconds after which the process is ended; by default there is no limit.
    on_progress : callable, optional
        Called with what the worker is doing. If it raises, the work ends.

    Returns
    -------
    Result

    Raises
    ------
    MeshingError
        With one sentence, if the worker reports an error; :class:`MesherCrashed` if it crashes, takes too long or
        returns nothing.
    OSError
        If temporary files cannot be written.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="vic-mesh-")))
            for file, content in {**files, JOB: json.dumps({**job, "time_limit": time_limit})}.items():
                folder.joinpath(file).write_bytes(_encoded(content))
        except OSError as error:
            msg = (
                f"Temporary files for gmsh cannot be written ({reason(error)}); make room on that disk, or name a "
                "folder on another one by the environment variable TMPDIR."
            )
            raise OSError(msg) from error
        code = _run(module, folder, time_limit, on_progress)
        return _result(folder, code)


def _encoded(content: str | bytes | Mapping[str, np.ndarray]) -> bytes:
    if isinstance(content, Mapping):
        buffer = io.BytesIO()
        np.savez(buffer, **content)
        return buffer.getvalue()
    return content.encode("utf-8") if isinstance(content, str) else content


def _run(module: str, folder: Path, time_limit: float, on_progress) -> int:
    """Start the process and watch it until it ends; returns its exit code."""
    paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    with folder.joinpath("output").open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", module, str(folder / JOB)],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            return _watched(process, folder, time_limit, on_progress)
        finally:
            # Also after Ctrl-C no process stays.
            if process.poll() is None:
                process.kill()
            process.wait()


def _watched(process, folder: Path, time_limit: float, on_progress) -> int:
    end, shown = time.monotonic() + time_limit, ""
    while True:
        try:
            return process.wait(_POLL_S)
        except subprocess.TimeoutExpired:
            pass
        if time.monotonic() > end:
            msg = (
                f"gmsh was not done after {time_limit:g} s and was ended; choose larger elements or a longer time "
                "limit."
            )
            raise MesherCrashed(msg)
        progress = _text(folder / PROGRESS)
        if on_progress is not None and progress != shown:
            on_progress(progress)
            shown = progress


def _result(folder: Path, code: int) -> Result:
    """Read the files of a worker that has ended."""
    error = _text(folder / ERROR)
    if error:
        raise MeshingError(error)
    if code != 0:
        how, remedy = f"crashed (signal {-code})", "choose another element size"
        if code > 0:
            how, remedy = f"failed (exit code {code}{_last_line(folder)})", "check its installation"
        msg = f"gmsh {how}; {remedy}."
        raise MesherCrashed(msg)
    try:
        with np.load(folder / RESULT, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        notes = json.loads(_text(folder / NOTES) or "{}")
    except (OSError, ValueError, EOFError, KeyError) as error:
        msg = "gmsh ended without a result; choose another element size."
        raise MesherCrashed(msg) from error
    return Result(arrays, notes)


def _text(path: Path) -> str:
    try:
        return " ".join(path.read_text(encoding="utf-8", errors="replace").split())
    except OSError:
        return ""


def _last_line(folder: Path) -> str:
    """Last line that the worker printed, after a colon; empty if there is none."""
    try:
        lines = folder.joinpath("output").read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError:
        return ""
    last = next((" ".join(line.split()) for line in reversed(lines) if line.strip()), "")
    return f": {last[:_LONGEST_OUTPUT]}" if last else ""


# ------------------------------------------------------------------ the worker's side


class JobFolder:
    """The folder of a job, for the worker.

    Parameters
    ----------
    job_path : Path
        File of the job; all other files are beside it.
    """

    def __init__(self, job_path: Path) -> None:
        self.folder = job_path.parent
        self.job = json.loads(job_path.read_text(encoding="utf-8"))
        self._start = time.monotonic()

    def path(self, name: str) -> str:
        """Return the path of a file of the job."""
        return str(self.folder / name)

    def spent(self) -> float:
        """Return the share of the time limit that has passed."""
        return (time.monotonic() - self._start) / self.job["time_limit"]

    def progress(self, line: str) -> None:
        """Report what is being done now."""
        # On Windows the file cannot be replaced while it is read; the next line will be written.
        with contextlib.suppress(OSError):
            self._write(PROGRESS, line)

    def finish(self, arrays: dict[str, np.ndarray], notes: dict) -> None:
        """Write the result."""
        self._write(NOTES, json.dumps(notes))
        draft = self.folder / "draft.npz"
        np.savez(draft, **arrays)
        os.replace(draft, self.folder / RESULT)

    def fail(self, sentence: str) -> None:
        """Write one sentence for the user instead of a result."""
        self._write(ERROR, sentence)

    def _write(self, name: str, text: str) -> None:
        draft = self.folder / f"{name}.draft"
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, self.folder / name)


class JobError(Exception):
    """The job cannot be done; the message is for the user."""


def main(work: Callable[[JobFolder], None]) -> int:
    """Do the job named on the command line.

    Parameters
    ----------
    work : callable
        Does the job and writes the result.

    Returns
    -------
    int
        Exit code.
    """
    _end_with_parent()
    place = JobFolder(Path(sys.argv[1]))
    try:
        work(place)
    except JobError as error:
        place.fail(str(error))
    except Exception as error:  # noqa: BLE001 - gmsh raises bare Exception; the user shall see one sentence.
        place.fail(f"gmsh failed ({reason(error)}); choose another element size.")
    return 0


def _end_with_parent() -> None:
    """Exit when the process that started this one has ended."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
