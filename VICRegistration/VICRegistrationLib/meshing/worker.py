"""What the workers have in common: reading the job, trying ways to mesh, leaving a result or one sentence."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from .elements import scaled_jacobians
from .process import ERROR, NOTES, PROGRESS, RESULT

# Relative difference of volumes at which a cut has failed.
_MISCUT = 1e-3
# Another way is tried only while no more of the time limit than this is spent.
_TIME_FOR_TRIES = 0.3


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


def best_mesh(place: Workplace, ways: Sequence, mesh: Callable[..., dict | None]) -> dict | None:
    """Mesh in one way after the other until a mesh is good or the time is short.

    Parameters
    ----------
    place : Workplace
    ways : sequence
        What `mesh` is called with.
    mesh : callable
        Returns ``points``, ``tetrahedra`` and ``regions``, or None if there are no tetrahedra.

    Returns
    -------
    dict or None
        The mesh with the largest least scaled Jacobian.
    """
    best = None
    for number, way in enumerate(ways, start=1):
        place.progress(f"meshing, try {number}" if number > 1 else "meshing")
        found = mesh(way)
        if found is None:
            continue
        least = scaled_jacobians(found["points"], found["tetrahedra"]).min()
        if best is None or least > best[0]:
            best = least, found
        if best[0] >= place.job["least_quality"] or place.spent() > _TIME_FOR_TRIES:
            break
    return None if best is None else best[1]


def claimants(names: Sequence[str], outers: Sequence, lumens: Sequence, number: int) -> list[tuple]:
    """Solids that have a prior claim on what a region fills, with their names.

    Who is named first keeps what is claimed twice, but lumens stay free of everybody's wall.
    """
    before = list(zip(names, outers[:number]))
    return before + [(f"the lumen of {name}", lumen) for name, lumen in zip(names[number + 1 :], lumens[number + 1 :])]


def check_left(name: str, volume: float, whole: float) -> None:
    """Refuse a region of which others take everything."""
    if volume <= _MISCUT * whole:
        msg = (
            f"Nothing is left of {name}: it lies inside of the organs and lumens that were named before it. Name it "
            "before the organ that holds it, or leave it out; vic-registration gaps tells how the organs lie to each "
            "other."
        )
        raise JobError(msg)


def check_cut(tool: str, name: str, parts: Sequence[float], told: Mapping) -> None:
    """Refuse what Open CASCADE has cut wrongly.

    Parameters
    ----------
    tool, name : str
        The mesher, and the region.
    parts : sequence of float
        Volumes of the region's solids.
    told : mapping
        ``whole``, the region's volume before it was cut, and ``given``, what it gave up to whom.
    """
    kept = told["whole"] - sum(told["given"].values())
    if min(parts, default=0.0) <= 0.0 or abs(sum(parts) - kept) > _MISCUT * told["whole"]:
        msg = (
            f"{tool} could not cut {name} where it meets its neighbours: they or their walls overlap too much or have "
            "most of their surfaces in common. Take a thinner wall or the other mesher (--tool), correct the surfaces "
            "(vic-registration gaps tells how they lie), or mesh the organs one by one."
        )
        raise JobError(msg)


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
