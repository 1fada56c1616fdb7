"""Changes of a folder that are made completely or not at all, even if the process is killed or the power fails.

A change uses a hidden work folder in the folder that it changes:

================ ===================================================================================================
``owner``        a file that the process locks until it ends
``drafts/``      the new files; all of them are on the disk before the first is moved
``backups/``     hard links (copies where there are none) to the files that are replaced or removed
``journal.json`` exists only while files are moved; `roll_back` restores the old files by it
================ ===================================================================================================

The change is complete when the journal is removed. The next process that uses the folder calls `recover`: it rolls back
the journal of a work folder whose process has ended, and removes that folder. So the folder has all old files or all
new ones. This module imports nothing of the library.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

# Hidden, so that nobody takes files of a killed process for results.
_PREFIX = ".vic-"
DRAFTS = "drafts"
_OWNER, _BACKUPS, _JOURNAL, _LOCK = "owner", "backups", "journal.json", f"{_PREFIX}lock"
# A work folder without an owner's file was abandoned if it is older than this, s; a younger one may just be made.
_ABANDONED_S = 60.0


@contextlib.contextmanager
def work_folder(beside: Path) -> Iterator[Path]:
    """Make a work folder, and remove it at the end.

    Parameters
    ----------
    beside : Path
        The folder to make it in, which must exist. Changes of killed processes there are recovered first.

    Yields
    ------
    Path
        The work folder, with an empty folder ``drafts``.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    """
    recover(beside)
    work = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=beside))
    try:
        with (work / _OWNER).open("wb") as owner:
            _locked(owner, wait=False)
            # With the usual permissions, unlike the folder of mkdtemp.
            (work / DRAFTS).mkdir()
            yield work
    finally:
        # A journal remains only if it could not be rolled back: the next `recover` tries again.
        if not (work / _JOURNAL).exists():
            _remove(work)


def commit(work: Path, *, outdated: Sequence[str] = ()) -> None:
    """Move the drafts of a work folder into its parent folder, and remove outdated files there.

    Parameters
    ----------
    work : Path
        From `work_folder`.
    outdated : sequence of str
        Names of files to remove; those that do not exist, or are among the drafts, are ignored.

    Raises
    ------
    OSError
        If a file cannot be moved. After this and any other error the folder is as it was.
    """
    folder, drafts = work.parent, work / DRAFTS
    entries = sorted(drafts.rglob("*"))
    names = [path.relative_to(drafts) for path in entries if path.is_file()]
    folders = [path.relative_to(drafts) for path in entries if path.is_dir()]
    blocked = [name for name in names if (folder / name).is_dir()]
    if blocked:
        msg = f"{blocked[0]} is a folder there"
        raise IsADirectoryError(msg)
    for path in entries:
        to_disk(path)
    gone = [Path(name) for name in outdated if (folder / name).is_file() and Path(name) not in names]
    replaced = [name for name in names if os.path.lexists(folder / name)]
    for name in (*replaced, *gone):
        _back_up(folder / name, work / _BACKUPS / name)
    missing = [name for name in folders if not (folder / name).exists()]
    new = [name for name in names if name not in replaced]
    _write_journal(work, new=new, saved=[*replaced, *gone], folders=missing)
    try:
        for name in missing:
            (folder / name).mkdir()
        for name in names:
            os.replace(drafts / name, folder / name)
        for name in gone:
            (folder / name).unlink()
        for path in (folder, *(folder / name for name in folders)):
            to_disk(path)
    except BaseException:
        roll_back(work)
        raise
    (work / _JOURNAL).unlink()
    to_disk(work)


def roll_back(work: Path) -> None:
    """Restore the files that an incomplete change has replaced or removed.

    Parameters
    ----------
    work : Path
        A work folder; nothing happens if it has no journal. The call may be repeated.

    Raises
    ------
    OSError
        If a file cannot be restored; the journal stays.
    """
    journal = work / _JOURNAL
    if not journal.exists():
        return
    content = json.loads(journal.read_text(encoding="utf-8"))
    folder = work.parent
    for name in content["new"]:
        # If the draft still exists, the file of this name in the folder is another one.
        if not (work / DRAFTS / name).exists():
            (folder / name).unlink(missing_ok=True)
    for name in content["saved"]:
        if os.path.lexists(work / _BACKUPS / name):
            os.replace(work / _BACKUPS / name, folder / name)
    for name in reversed(content["folders"]):
        with contextlib.suppress(OSError):
            (folder / name).rmdir()
    to_disk(folder)
    journal.unlink()


def recover(folder: str | os.PathLike) -> None:
    """Roll back incomplete changes of killed processes in a folder, and remove their drafts.

    Parameters
    ----------
    folder : path
        Nothing happens if it does not exist. Work folders of running processes are left alone.

    Raises
    ------
    OSError
        If a file cannot be restored.
    """
    if not os.path.isdir(folder):
        return
    with os.scandir(folder) as entries:
        found = [Path(entry.path) for entry in entries if entry.name.startswith(_PREFIX)]
    for path in found:
        if path.is_dir():
            _recover_one(path)
        elif path.name == _LOCK:
            _remove_lock(path)


@contextlib.contextmanager
def one_at_a_time(folder: Path, *, on_wait: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Lock a folder against the same block in other processes, to read its files and write them again.

    Parameters
    ----------
    folder : Path
        It is made if it does not exist, and removed at the end if it is empty.
    on_wait : callable
        Called if another process has the lock.

    Raises
    ------
    OSError
        If the folder cannot be written to.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / _LOCK
    try:
        with _own_lock(path, on_wait):
            try:
                yield
            finally:
                # Before it is unlocked: a waiting process sees that the file is gone, and makes a new one.
                with contextlib.suppress(OSError):
                    path.unlink()
    finally:
        # Windows does not remove open files, so the lock's file may still exist.
        recover(folder)
        for new in made:
            with contextlib.suppress(OSError):
                new.rmdir()


@contextlib.contextmanager
def _own_lock(path: Path, on_wait: Callable[[], None]) -> Iterator[None]:
    """Make a file and lock it; repeat that if the file was removed in the meantime."""
    while True:
        with path.open("ab") as file:
            if not _locked(file, wait=False):
                on_wait()
                _locked(file, wait=True)
            if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
                yield
                return


def _remove_lock(path: Path) -> None:
    """Remove the file of a lock that no process has."""
    with contextlib.suppress(OSError), path.open("ab") as file:
        if _locked(file, wait=False):
            # A waiting process sees that the file is gone, and makes a new one.
            path.unlink()


def _locked(file, *, wait: bool) -> bool:
    """Lock an open file until it is closed or the process ends; False if another process has it."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        # Some network drives have no locks; then a file is taken to be in use.
        return wait and not isinstance(error, BlockingIOError)
    return True


def _recover_one(work: Path) -> None:
    """Recover a work folder if its process has ended."""
    try:
        with (work / _OWNER).open("r+b") as owner:
            if not _locked(owner, wait=False):
                return
            roll_back(work)
    except FileNotFoundError:
        with contextlib.suppress(OSError):
            if time.time() - work.stat().st_mtime > _ABANDONED_S:
                work.rmdir()
        return
    except PermissionError:
        # It belongs to another user.
        return
    _remove(work)


def _remove(work: Path) -> None:
    """Remove a work folder, the owner's file last: it shows whether the process has ended."""
    for name in (DRAFTS, _BACKUPS):
        shutil.rmtree(work / name, ignore_errors=True)
    shutil.rmtree(work, ignore_errors=True)


def _write_journal(work: Path, **names: Sequence[Path]) -> None:
    """Write the journal, after all backups are on the disk."""
    if (work / _BACKUPS).exists():
        for path in (work / _BACKUPS).rglob("*"):
            to_disk(path)
        to_disk(work / _BACKUPS)
    draft = work / f"{_JOURNAL}.draft"
    draft.write_text(json.dumps({key: [str(name) for name in found] for key, found in names.items()}), encoding="utf-8")
    to_disk(draft)
    os.replace(draft, work / _JOURNAL)
    to_disk(work)


def _back_up(path: Path, backup: Path) -> None:
    """Make a hard link to a file, or a copy where the file system has no links."""
    backup.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(path, backup, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(path, backup, follow_symlinks=False)


def to_disk(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError
        If they cannot be written.
    """
    if path.is_symlink():
        return
    # Windows cannot open folders, and flushes only files that are open for writing.
    if os.name == "nt" and path.is_dir():
        return
    number = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
