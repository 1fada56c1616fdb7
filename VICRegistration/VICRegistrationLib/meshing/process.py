"""Work in a process of its own, which may crash, hang or return nothing without harm.

The job is a JSON file in a temporary folder; the worker is told its path, and leaves in the same folder

============= =====================================================================================
``result.npz`` arrays, written last
``notes.json`` an object with whatever else there is to say
``error.txt``  one sentence for the user, instead of a result
``progress``   what it is doing now, one line
============= =====================================================================================
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files import reason

JOB, RESULT, NOTES, ERROR, PROGRESS = "job.json", "result.npz", "notes.json", "error.txt", "progress"
_ROOT = Path(__file__).resolve().parents[2]
# How long the worker is left alone between two looks at it, s.
_LOOK = 0.05
_LONGEST_COMPLAINT = 300


class MeshingError(RuntimeError):
    """The mesher has failed; the message is one sentence for the user."""


class MesherBroke(MeshingError):
    """The mesher crashed, hung or returned nothing: something else may work."""


class MeshingCancelled(MeshingError):
    """The work was cancelled from outside."""


@dataclass(frozen=True, eq=False)
class Result:
    """What a worker has left.

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
    files: Mapping[str, str | bytes],
    *,
    name: str,
    time_limit: float,
    on_progress: Callable[[str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Result:
    """Run a module as a process and read its result.

    Parameters
    ----------
    module : str
        Run as ``python -m module JOB``.
    job : mapping
        What JSON can hold; the worker finds ``time_limit`` in it too.
    files : mapping of name to text or bytes
        Put beside the job.
    name : str
        What the worker is called in messages.
    time_limit : float
        Seconds after which it is ended.
    on_progress : callable, optional
        Told what the worker is doing.
    cancelled : callable, optional
        Asked some times a second whether to stop.

    Returns
    -------
    Result

    Raises
    ------
    MeshingError
        With one sentence: the worker complained; or crashed, took too long or returned nothing (:class:`MesherBroke`).
    MeshingCancelled
        If `cancelled` said so.
    OSError
        If temporary files cannot be written.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="vic-mesh-")))
            for file, content in {**files, JOB: json.dumps({**job, "time_limit": time_limit})}.items():
                folder.joinpath(file).write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        except OSError as error:
            msg = (
                f"Temporary files for {name} cannot be written ({reason(error)}); make room on that disk, or name a "
                "folder on another one by the environment variable TMPDIR."
            )
            raise OSError(msg) from error
        code = _run(module, folder, name, time_limit, on_progress, cancelled)
        return _result(folder, name, code)


def _run(module, folder: Path, name: str, time_limit: float, on_progress, cancelled) -> int:
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
            return _watched(process, folder, name, time_limit, on_progress, cancelled)
        finally:
            # Whatever ends the watch (Ctrl-C too), nothing is left running.
            if process.poll() is None:
                process.kill()
            process.wait()


def _watched(process, folder: Path, name: str, time_limit: float, on_progress, cancelled) -> int:
    end, told = time.monotonic() + time_limit, ""
    while True:
        try:
            return process.wait(_LOOK)
        except subprocess.TimeoutExpired:
            pass
        if cancelled is not None and cancelled():
            msg = f"{name} was cancelled; nothing was written."
            raise MeshingCancelled(msg)
        if time.monotonic() > end:
            msg = (
                f"{name} was not done after {time_limit:g} s and was ended; choose larger elements or a longer time "
                "limit."
            )
            raise MesherBroke(msg)
        progress = _text(folder / PROGRESS)
        if on_progress is not None and progress != told:
            on_progress(progress)
            told = progress


def _result(folder: Path, name: str, code: int) -> Result:
    """Read the files of a worker that has ended."""
    complaint = _text(folder / ERROR)
    if complaint:
        raise MeshingError(complaint)
    if code != 0:
        how, remedy = f"crashed (signal {-code})", "choose another element size"
        if code > 0:
            how, remedy = f"failed (exit code {code}{_last_words(folder)})", "check its installation"
        msg = f"{name} {how}; {remedy}, or use the other mesher."
        raise MesherBroke(msg)
    try:
        with np.load(folder / RESULT, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        notes = json.loads(_text(folder / NOTES) or "{}")
    except (OSError, ValueError, EOFError, KeyError) as error:
        msg = f"{name} ended without a result; choose another element size or the other mesher."
        raise MesherBroke(msg) from error
    return Result(arrays, notes)


def _text(path: Path) -> str:
    try:
        return " ".join(path.read_text(encoding="utf-8", errors="replace").split())
    except OSError:
        return ""


def _last_words(folder: Path) -> str:
    """Last line that the worker printed, if any."""
    try:
        lines = folder.joinpath("output").read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError:
        return ""
    last = next((" ".join(line.split()) for line in reversed(lines) if line.strip()), "")
    return f": {last[:_LONGEST_COMPLAINT]}" if last else ""
