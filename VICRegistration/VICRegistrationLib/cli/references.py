"""References that fitted organs are compared with: their arguments, and reading them."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..analysis.references import ReadReference, read_reference
from ..export.mesh_reading import FRAMES, READABLE_MESHES
from ..file_names import file_key
from ..imaging.dicom import segmentation_in
from .process import silenced_stderr

# Endings of references in a folder, in order of preference.
_ENDINGS = (".json", *READABLE_MESHES, ".seg.nrrd", ".nrrd", ".nii.gz", ".nii", ".mha", ".mhd")


@dataclass(frozen=True, eq=False)
class OrganReference:
    """The reference of one organ.

    Parameters
    ----------
    read : ReadReference
    path : Path
        Its file.
    asked : mapping of str to object
        Label, largest piece only, and frame, as they were given.
    """

    read: ReadReference
    path: Path
    asked: Mapping[str, object] = field(default_factory=dict)

    def record(self) -> dict[str, object]:
        """Describe the reference for JSON, so that `read_again` can read it."""
        return {"path": os.path.abspath(self.path), **self.asked}


def add_words(group: argparse._ArgumentGroup, *, frame: str = "--frame") -> None:
    """Add the arguments that choose a part of a reference.

    Parameters
    ----------
    group : argument group of argparse
    frame : str
        Flag for the frame of a mesh.
    """
    group.add_argument(
        "--label",
        metavar="[ORGAN=]LABEL",
        action="append",
        default=[],
        help="value or name of a label; with several organs ORGAN=LABEL for each (default: the only label, or the one "
        "with the name of the organ)",
    )
    group.add_argument(
        "--largest",
        action="store_true",
        help="take only the largest piece of a label or a mesh, with its cavities filled",
    )
    help_text = "frame of a mesh (default: as marked in the file, else LPS)"
    group.add_argument(frame, dest="mesh_frame", choices=FRAMES, help=help_text)


def read_references(
    names: Sequence[str], paths: dict[str, Path], options: argparse.Namespace
) -> dict[str, OrganReference]:
    """Read the reference of each organ.

    Parameters
    ----------
    names : sequence of str
        Of the organs.
    paths : dict of str to Path
        From `reference_paths`.
    options : argparse.Namespace
        With the arguments of `add_words`.

    Returns
    -------
    dict of str to OrganReference

    Raises
    ------
    ValueError, OSError
        With a message for the user.
    """
    labels = chosen_labels(options.label, names)
    words = {"largest": options.largest, "frame": options.mesh_frame}
    return {name: _read(name, paths[name], {"label": labels.get(name), **words}) for name in names}


def read_again(name: str, record: Mapping[str, object]) -> OrganReference:
    """Read the reference of an organ of an earlier run.

    Parameters
    ----------
    name : str
        Of the organ.
    record : mapping
        From `OrganReference.record`.

    Returns
    -------
    OrganReference

    Raises
    ------
    ValueError, OSError
        With a message for the user.
    """
    return _read(name, Path(record["path"]), {key: value for key, value in record.items() if key != "path"})


def _read(name: str, path: Path, asked: Mapping[str, object]) -> OrganReference:
    # Readers written in C print errors, which they also raise.
    with silenced_stderr():
        return OrganReference(read_reference(path, organ=name, **asked), path, asked)


def reference_paths(reference: str, names: Sequence[str]) -> dict[str, Path]:
    """Find the file of the reference of each organ.

    Parameters
    ----------
    reference : str
        A file, or a folder with a file for each organ, or with one DICOM segmentation.
    names : sequence of str
        Of the organs.

    Returns
    -------
    dict of str to Path

    Raises
    ------
    ValueError
        If the folder has no reference for an organ, or several DICOM segmentations.
    """
    path = Path(reference)
    if not path.is_dir():
        return dict.fromkeys(names, path)
    found = {}
    for name in names:
        wanted = {file_key(name + ending): rank for rank, ending in enumerate(_ENDINGS)}
        files = {wanted[key]: file for file in path.iterdir() if (key := file_key(file.name)) in wanted}
        if files:
            found[name] = files[min(files)]
    missing = [name for name in names if name not in found]
    if not missing:
        return found
    segmentation = segmentation_in(path)
    if segmentation is None:
        msg = (
            f"The folder {path} holds no reference for {missing[0]}; give one that holds {missing[0]}.json, "
            f"{missing[0]}.stl or {missing[0]}.nii.gz, or name the file itself."
        )
        raise ValueError(msg)
    return dict.fromkeys(names, segmentation)


def chosen_labels(words: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Label of each organ by arguments LABEL, for all organs, and ORGAN=LABEL.

    Parameters
    ----------
    words : sequence of str
    names : sequence of str
        Of the organs.

    Returns
    -------
    dict of str to str

    Raises
    ------
    ValueError
        If an organ is not known, or several labels are given for all organs.
    """
    common = [word for word in words if "=" not in word]
    if len(common) > 1:
        msg = f"--label was given {len(common)} times; give the organ of each, such as --label {names[0]}={common[0]}."
        raise ValueError(msg)
    chosen = {name: label for label in common for name in names}
    for word in words:
        name, own, label = word.rpartition("=")
        if own and name not in names:
            msg = f"--label {word} was given, but the organs are {', '.join(names)}; name one of them."
            raise ValueError(msg)
        if own:
            chosen[name] = label
    return chosen
