"""What the workers have in common: reading the job, leaving a result or one sentence."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .process import ERROR, NOTES, PROGRESS, RESULT


class Workplace:
    """The folder of a job.

    Parameters
    ----------
    job_path : Path
        The job; everything else lies beside it.
    """

    def __init__(self, job_path: Path) -> None:
        self.folder = job_path.parent
        self.job = json.loads(job_path.read_text(encoding="utf-8"))
        self._start = time.monotonic()

    def path(self, name: str) -> str:
        """Path of a file of the job."""
        return str(self.folder / name)

    def spent(self) -> float:
        """Fraction of the time limit that is over."""
        return (time.monotonic() - self._start) / self.job["time_limit"]

    def progress(self, line: str) -> None:
        """Tell what is being done now."""
        # Where the other side just reads it, it cannot be replaced (Windows); it will be next time.
        with contextlib.suppress(OSError):
            self._write(PROGRESS, line)

    def finish(self, arrays: dict[str, np.ndarray], notes: dict) -> None:
        """Leave the result."""
        self._write(NOTES, json.dumps(notes))
        draft = self.folder / "draft.npz"
        np.savez(draft, **arrays)
        os.replace(draft, self.folder / RESULT)

    def complain(self, sentence: str) -> None:
        """Leave one sentence instead of a result."""
        self._write(ERROR, sentence)

    def _write(self, name: str, text: str) -> None:
        draft = self.folder / f"{name}.draft"
        draft.write_text(text, encoding="utf-8")
        os.replace(draft, self.folder / name)


class JobError(Exception):
    """The job cannot be done; the message is for the user."""


def nothing_left(name: str) -> str:
    """Say that an organ lies wholly inside of others."""
    return (
        f"Nothing is left of {name}: it lies inside of the organs and lumens that were named before it. Name it before "
        "the organ that holds it, or leave it out; vic-registration gaps tells how the organs lie to each other."
    )


def miscut(tool: str, name: str) -> str:
    """Say that a solid could not be cut where it meets others."""
    return (
        f"{tool} could not cut {name} where it meets its neighbours: they overlap too much or have most of their "
        "surfaces in common. Look at vic-registration gaps, correct the surfaces, take another wall, or mesh the "
        "organs one by one."
    )


def main(work: Callable[[Workplace], None], *, name: str) -> int:
    """Do the job named on the command line.

    Parameters
    ----------
    work : callable
        Does the job and leaves the result.
    name : str
        Name of the mesher, for messages.

    Returns
    -------
    int
        Exit code.
    """
    _end_with_parent()
    place = Workplace(Path(sys.argv[1]))
    try:
        work(place)
    except JobError as error:
        place.complain(str(error))
    except Exception as error:  # noqa: BLE001 - meshers raise bare Exception; the user shall see one sentence.
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        place.complain(f"{name} failed ({reason}); choose another element size or the other mesher.")
    return 0


def _end_with_parent() -> None:
    """Leave when the process that started this one is gone, however it went."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
