"""Writing files and folders completely or not at all. Imports only :mod:`.transactions`."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from .transactions import DRAFTS, commit, recover, to_disk, work_folder


def keep_inputs(targets: Iterable[str | os.PathLike], inputs: Iterable[str | os.PathLike]) -> None:
    """Refuse results that would replace inputs.

    Parameters
    ----------
    targets : iterable of path
        Files to be written.
    inputs : iterable of path
        Files that are read.

    Raises
    ------
    ValueError
        If a target and an input are the same file, under any name.
    """
    inputs = list(inputs)
    for target in targets:
        for path in inputs:
            if os.path.exists(target) and os.path.exists(path) and os.path.samefile(target, path):
                msg = f"The result {target} would replace {path}, which is read; choose another output folder or name."
                raise ValueError(msg)


@contextlib.contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Write a draft of a file, and move it to its place at the end.

    Parameters
    ----------
    path : path
        File to write; its folder must exist. A file of that name is replaced.

    Yields
    ------
    Path
        The draft: a file of the same name in a temporary folder beside the target.

    Raises
    ------
    OSError
        If the file cannot be written (``RuntimeError`` of VTK and ITK included); a file of that name is left as it
        was, and no draft stays behind.
    """
    path = Path(path)
    try:
        with work_folder(path.parent) as work:
            draft = work / DRAFTS / path.name
            yield draft
            to_disk(draft)
            os.replace(draft, path)
    except (OSError, RuntimeError) as error:
        msg = (
            f"{path} cannot be written ({reason(error)}); choose a folder that exists and may be written to, and check "
            "that the disk has room."
        )
        raise OSError(msg) from error


def write_text(path: str | os.PathLike, text: str) -> None:
    """Write a text as UTF-8, completely or not at all, as in `replacing`."""
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike, content: object) -> None:
    """Write indented JSON of finite numbers, completely or not at all, as in `replacing`."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


@contextlib.contextmanager
def replacing_folder(folder: str | os.PathLike, *, outdated: Sequence[str] = ()) -> Iterator[Path]:
    """Write several files into a draft folder, and move all of them to their places at the end.

    Parameters
    ----------
    folder : path
        Folder for the files. It is made if it does not exist. Existing files of the same names are replaced, others
        stay.
    outdated : sequence of str
        Names of files in it that are removed when the new ones are moved. The list is read then, so that it may grow
        within the block.

    Yields
    ------
    Path
        Folder to write into, on the same file system.

    Raises
    ------
    OSError
        If the folder cannot be written to, which is checked before the block, or the files cannot be moved. If an error
        or Ctrl-C ends the block, `folder` is left as it was. If the process is killed, it has all old files or all new
        ones, see :mod:`.transactions`.
    """
    folder = Path(folder)
    beside = _nearest_folder(folder)
    with contextlib.ExitStack() as stack:
        try:
            for place in (folder, folder.parent):
                recover(place)
            work = stack.enter_context(work_folder(beside))
        except OSError as error:
            msg = f"The folder {folder} cannot be written to ({reason(error)}); choose another folder."
            raise OSError(msg) from error
        drafts = work / DRAFTS / folder.relative_to(beside)
        drafts.mkdir(parents=True, exist_ok=True)
        try:
            yield drafts
        except OSError as error:
            # The user does not know the folder of the drafts.
            msg = str(error).replace(str(drafts), str(folder))
            raise OSError(msg) from error
        try:
            if beside == folder:
                commit(work, outdated=outdated)
            else:
                _move_folder(work)
        except OSError as error:
            msg = (
                f"The files cannot be put into {folder} ({reason(error)}); check that it may be written to and holds "
                "no folders of their names. It was left as it was."
            )
            raise OSError(msg) from error


def check_writable(folder: str | os.PathLike) -> None:
    """Refuse a folder into which files cannot be written.

    Parameters
    ----------
    folder : path
        Need not exist.

    Raises
    ------
    OSError
        If it, or its nearest existing parent, is no folder or cannot be written to.
    """
    beside = _nearest_folder(Path(folder))
    try:
        with work_folder(beside):
            pass
    except OSError as error:
        msg = f"The folder {folder} cannot be written to ({reason(error)}); choose another folder."
        raise OSError(msg) from error


def reason(error: Exception) -> str:
    """Return the reason of an error in one line; for errors of the system without number and path."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split()).rstrip(".;:")


def _nearest_folder(folder: Path) -> Path:
    """Return a folder if it exists, else its nearest existing parent."""
    existing = folder
    while not (existing.exists() or existing.is_symlink()) and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        msg = f"{existing} is not a folder; choose a folder for the output."
        raise OSError(msg)
    return existing


def _move_folder(work: Path) -> None:
    """Move a new folder to its place in one step; if it exists by now, move its files."""
    (new,) = (work / DRAFTS).iterdir()
    target = work.parent / new.name
    if os.path.lexists(target):
        commit(work)
        return
    for path in new.rglob("*"):
        to_disk(path)
    os.replace(new, target)
    to_disk(work.parent)
