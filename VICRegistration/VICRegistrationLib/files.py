"""Writing files and folders completely or not at all. Knows nothing of the rest of the library."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

# Hidden, so that nobody takes what a killed process left behind for a result.
_PREFIX = ".vic-"


def keep_inputs(targets: Iterable[str | os.PathLike], inputs: Iterable[str | os.PathLike]) -> None:
    """Refuse results that would replace what is read.

    Parameters
    ----------
    targets : iterable of path
        Files to be written.
    inputs : iterable of path
        Files that are read.

    Raises
    ------
    ValueError
        If two of them are one file, by whatever name.
    """
    inputs = list(inputs)
    for target in targets:
        for path in inputs:
            if os.path.exists(target) and os.path.exists(path) and os.path.samefile(target, path):
                msg = f"The result {target} would replace {path}, which is read; choose another output folder or name."
                raise ValueError(msg)


@contextlib.contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Write a file under a draft's name and put it in its place at the end.

    Parameters
    ----------
    path : path
        File to write; its folder must exist. A file of that name is replaced.

    Yields
    ------
    Path
        Where to write: a file of the same name in a folder of its own beside the target.

    Raises
    ------
    OSError
        If the file cannot be written (``RuntimeError`` of VTK and ITK included); a file of that name is left as it
        was, and no draft stays behind.
    """
    path = Path(path)
    try:
        # A folder of its own: same file system, and the file gets the usual permissions.
        with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=path.parent) as folder:
            draft = Path(folder, path.name)
            yield draft
            os.replace(draft, path)
    except (OSError, RuntimeError) as error:
        msg = (
            f"{path} cannot be written ({reason(error)}); choose a folder that exists and may be written to, and check "
            "that the disk has room."
        )
        raise OSError(msg) from error


@contextlib.contextmanager
def replacing_folder(folder: str | os.PathLike, *, outdated: Sequence[str] = ()) -> Iterator[Path]:
    """Write several files into a draft folder and put all of them in their place at the end.

    Parameters
    ----------
    folder : path
        Folder for the files. It is made if there is none; if there is one, its other files stay, and files of the same
        name are replaced.
    outdated : sequence of str
        Names of its files that are removed when the new ones are put in their place.

    Yields
    ------
    Path
        Folder to write into, on the same file system.

    Raises
    ------
    OSError
        If the folder cannot be written to, which is found out before anything is yielded, or the files cannot be put in
        their place. Whatever ends the block early (an error, Ctrl-C), `folder` is left as it was.
    """
    folder = Path(folder)
    beside = _nearest_folder(folder)
    try:
        outer = tempfile.TemporaryDirectory(prefix=_PREFIX, dir=beside)
    except OSError as error:
        msg = f"The folder {folder} cannot be written to ({reason(error)}); choose another folder."
        raise OSError(msg) from error
    with outer as temporary:
        drafts, backups = Path(temporary, "drafts"), Path(temporary, "backups")
        drafts.mkdir()
        try:
            yield drafts
        except OSError as error:
            # The user knows the folder asked for, not the draft's.
            msg = str(error).replace(str(drafts), str(folder))
            raise OSError(msg) from error
        try:
            _move_in(drafts, folder, backups, outdated)
        except OSError as error:
            msg = (
                f"The files cannot be put into {folder} ({reason(error)}); check that it may be written to and holds "
                "no folders of their names. It was left as it was."
            )
            raise OSError(msg) from error


def reason(error: Exception) -> str:
    """Reason of an error in one line, without numbers and paths where the system tells them apart."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split()).rstrip(".;:")


def _nearest_folder(folder: Path) -> Path:
    """Find the folder itself if there is one, else the first of its parents that exists."""
    existing = folder
    while not (existing.exists() or existing.is_symlink()) and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        msg = f"{existing} is not a folder; choose a folder for the output."
        raise OSError(msg)
    return existing


def _move_in(drafts: Path, folder: Path, backups: Path, outdated: Sequence[str]) -> None:
    """Move the files of a draft folder into a folder and others out; if one cannot be moved, undo the others."""
    made = _missing_folders(drafts, folder)
    written = sorted(path.relative_to(drafts) for path in drafts.rglob("*") if path.is_file())
    undo = []
    try:
        for new in made:
            new.mkdir()
            undo.append((new.rmdir,))
        for name in written:
            target = folder / name
            if target.is_dir():
                msg = f"{name} is a folder there"
                raise IsADirectoryError(msg)
            if target.exists():
                undo.append(_moved_out(target, backups / name))
            os.replace(drafts / name, target)
            undo.append((target.unlink,))
        for name in outdated:
            if (folder / name).is_file() and Path(name) not in written:
                undo.append(_moved_out(folder / name, backups / name))
    except BaseException:
        for call, *arguments in reversed(undo):
            call(*arguments)
        raise


def _moved_out(target: Path, backup: Path) -> tuple:
    """Move a file to its backup; returns the call that brings it back."""
    backup.parent.mkdir(parents=True, exist_ok=True)
    os.replace(target, backup)
    return os.replace, backup, target


def _missing_folders(drafts: Path, folder: Path) -> list[Path]:
    """Folders to make before the drafts can be moved, outer ones first."""
    wanted = [folder, *(folder / path.relative_to(drafts) for path in drafts.rglob("*") if path.is_dir())]
    missing = {parent for path in wanted for parent in (path, *path.parents) if not parent.exists()}
    return sorted(missing, key=lambda path: len(path.parts))
