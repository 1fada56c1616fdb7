"""The folder of results of one image: the results of earlier runs, and which files belong to them.

A folder belongs to one image. Organs are added to it or replaced in it; ``report.json`` lists all of them with their
files and the digests of those. A file is a result if the report lists it and its content was not changed; all other
files in the folder are the user's and are never touched.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..file_names import file_key
from ..files import reason
from ..imaging.image import Image

REPORT, PAGE, OVERVIEW, ASSEMBLY = "report.json", "report.html", "overview.png", "organs.step"
SCHEMA, VERSION = "vic-registration/report", 2
# Key of a report.
_DIGEST = "digest"
# Tolerance for rounding when an image is read again, mm.
_SAME_PLACE_MM = 1e-3


@dataclass(frozen=True)
class StoredResults:
    """Contents of ``report.json`` of a folder.

    Parameters
    ----------
    folder : Path
    content : dict
        Of the report; empty if there is none.
    """

    folder: Path
    content: Mapping[str, object] = field(default_factory=dict)

    @property
    def organs(self) -> dict[str, dict]:
        """Entries of the organs by their names; those whose surface the user has removed are left out."""
        return {name: entry for name, entry in self._all_organs.items() if (self.folder / f"{name}.json").is_file()}

    @property
    def removed_organs(self) -> list[str]:
        """Names of the organs whose surface the user has removed."""
        return [name for name in self._all_organs if name not in self.organs]

    @property
    def _all_organs(self) -> dict[str, dict]:
        return self.content.get("organs", {})

    def files_of(self, name: str) -> dict[str, str]:
        """Files of one organ with their digests; none if it is not known."""
        return self._all_organs.get(name, {}).get("files", {})

    @property
    def files(self) -> dict[str, str]:
        """All files with their digests, except the report itself."""
        common = self.content.get("files", {})
        return {**common, **{file: digest for name in self._all_organs for file, digest in self.files_of(name).items()}}

    def holds(self, name: str) -> bool:
        """Whether a file of the folder is a result that was not changed."""
        if name == REPORT:
            return bool(self.content)
        return name in self.files and file_digest(self.folder / name) == self.files[name]

    def check_targets(self, names: Iterable[str]) -> None:
        """Refuse to replace files that are no results.

        Parameters
        ----------
        names : iterable of str
            Names of files to be written.

        Raises
        ------
        ValueError
            If one exists that is no result, or was changed since.
        """
        for name in names:
            path = self.folder / name
            if not os.path.lexists(path) or path.is_dir() or self.holds(name):
                continue
            if name in self.files:
                msg = f"{path} was changed since it was written; move it elsewhere, or choose another output folder."
            else:
                msg = f"{path} exists and is no result of a fit; move it elsewhere, or choose another output folder."
            raise ValueError(msg)

    def check_names(self, names: Iterable[str]) -> None:
        """Refuse a name that differs from one in the folder only in case or in the encoding of accents.

        Parameters
        ----------
        names : iterable of str
            Of organs to be fitted.

        Raises
        ------
        ValueError
            If one does.
        """
        known = {file_key(name): name for name in self._all_organs}
        for name in names:
            before = known.get(file_key(name), name)
            if before != name:
                msg = f"The folder {self.folder} has an organ {before}; use that name, or choose another folder."
                raise ValueError(msg)

    def check_image(self, record: Mapping[str, object]) -> None:
        """Refuse to mix results of two images.

        Parameters
        ----------
        record : mapping
            From `image_record`.

        Raises
        ------
        ValueError
            If the results are of another image.
        """
        if not self.content or self._is_of(record):
            return
        before, now = str(self.content["image"]), str(record["image"])
        asked = ("image_series", "image_frame")
        same_name = Path(before).name == Path(now).name and all(self.content.get(key) == record[key] for key in asked)
        what = f"an earlier version of {before}" if same_name else f"another image, {before}"
        msg = (
            f"The folder {self.folder} has results of {what}, and a folder belongs to one image; choose another "
            "folder by --output, or remove it."
        )
        raise ValueError(msg)

    def _is_of(self, record: Mapping[str, object]) -> bool:
        matrices = (np.asarray(found["image_ijk_to_ras"], dtype=float) for found in (self.content, record))
        return (
            self.content["image_size"] == record["image_size"]
            and self.content["image_digest"] == record["image_digest"]
            and np.allclose(*matrices, rtol=0.0, atol=_SAME_PLACE_MM)
        )


def read_results(folder: Path) -> StoredResults:
    """Read the report of a folder of results.

    Parameters
    ----------
    folder : Path
        Need not exist.

    Returns
    -------
    StoredResults

    Raises
    ------
    OSError
        If ``report.json`` cannot be read.
    ValueError
        If it was not written by this version of the program, or changed since.
    """
    path = folder / REPORT
    way_out = "choose another folder by --output, or remove it"
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        return StoredResults(folder)
    except OSError as error:
        msg = f"{path} cannot be read ({reason(error)}); {way_out}."
        raise OSError(msg) from error
    except ValueError as error:
        msg = f"{path} is damaged ({reason(error)}); {way_out}."
        raise ValueError(msg) from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        msg = f"{path} is no report of a fit, and would be replaced; {way_out}."
        raise ValueError(msg)
    if content.get("version") != VERSION:
        msg = (
            f"{path} has version {content.get('version')!r}, but this version of the program reads version {VERSION}; "
            f"{way_out}."
        )
        raise ValueError(msg)
    if content.get(_DIGEST, _content_digest(content)) != _content_digest(content):
        msg = f"{path} was changed since it was written; restore it, {way_out}."
        raise ValueError(msg)
    return StoredResults(folder, content)


def with_digest(content: Mapping[str, object]) -> dict[str, object]:
    """Add to a report a digest, which tells whether it was changed later.

    Parameters
    ----------
    content : mapping

    Returns
    -------
    dict
    """
    return {**content, _DIGEST: _content_digest(content)}


def _content_digest(content: Mapping[str, object]) -> str:
    """SHA-256 of a report without its digest; the order of keys and white space do not matter."""
    text = json.dumps({key: value for key, value in content.items() if key != _DIGEST}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def image_record(
    image: Image, path: str, series: str | None, frame: int | None = None, warnings: Sequence[str] = ()
) -> dict[str, object]:
    """Describe an image for ``report.json``.

    Parameters
    ----------
    image : Image
    path : str
        As the user gave it.
    series : str, optional
        The DICOM series that was chosen.
    frame : int, optional
        Number of the volume that was chosen.
    warnings : sequence of str
        Warnings about the file, a sentence each.

    Returns
    -------
    dict
        With size, spacing, matrix and digest of the grey levels, by which the image is recognised.
    """
    digest = hashlib.sha256()
    for part in image.array:
        # One type for all, because readers may return integers or floating-point numbers.
        digest.update(np.ascontiguousarray(part, dtype="<f4"))
    return {
        "image": path,
        "image_series": series,
        "image_frame": frame,
        "image_warnings": list(warnings),
        "image_size": image.size.tolist(),
        "image_spacing_mm": image.spacing.tolist(),
        "image_ijk_to_ras": image.ijk_to_ras.tolist(),
        "image_digest": digest.hexdigest(),
    }


def file_digest(path: Path) -> str:
    """SHA-256 of a file as hexadecimal digits; empty if it does not exist."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
