"""Checks of NRRD, MetaImage and VTK headers, because ITK fills in defaults for a missing spacing or origin."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

# Largest part of a file that is searched for the header; Slicer's segmentations have headers of some hundred kB.
_MOST_BYTES = 1 << 20
_VECTOR = re.compile(r"\([^)]*\)|none", re.IGNORECASE)
_SIDES = {"left", "right", "anterior", "posterior", "superior", "inferior"}
_SHORT_SPACES = {"lps", "ras", "las", "lpst"}
# ITK does not convert these spaces, and takes their axes for left, posterior and superior.
_NOT_TURNED = {"rast", "last", "right-anterior-superior-time", "left-anterior-superior-time"}
_MILLIMETRES = {"", "mm", "millimeter", "millimeters", "millimetre", "millimetres"}
_META_DIRECTIONS, _META_ORIGINS = {"transformmatrix", "rotation", "orientation"}, {"offset", "origin", "position"}
# Fields that ITK reads only after NDims.
_META_SIZED = {"dimsize", "centerofrotation", *_META_DIRECTIONS, *_META_ORIGINS, "elementspacing", "elementsize"}
# ITK's messages about files that it cannot read, and their causes in words.
_CAUSES = (
    (r"fread got only|expected \d+ bytes but received|trouble with inflate", "its data end too soon"),
    ("valid space dimension", "its header has directions, an origin or units above its space, or without one"),
    ("couldn't parse space \"", "its space is none that NRRD knows, such as left-posterior-superior"),
    ("require endian", "its header does not give the order of bytes (endian: little or big)"),
    ("space vector coefficients|parse origin", "its directions or its origin are no numbers"),
    ("determinant is 0", "two of its axes have one direction"),
)
_META_DISTANCES, _MOST_AXES = {"elementspacing", "elementsize"}, 6
# Largest deviation of a direction's length from 1; some programs write three digits.
_UNIT = 5e-3
_NO_AXES = "which way its axes point; they were taken as left, posterior and superior, as ITK and 3D Slicer do"
_NO_ORIGIN = "where its first voxel is; that was taken as 0, 0, 0"


def notes_about(path: Path, kind: str) -> list[str]:
    """Check that a file gives the distances of its voxels, and collect warnings about other missing information.

    Parameters
    ----------
    path : Path
    kind : str
        ITK's name of the format: "NrrdImageIO", "MetaImageIO", "VTKImageIO", ...

    Returns
    -------
    list of str
        A sentence each.

    Raises
    ------
    ValueError
        If a distance is missing, or not in mm.
    """
    head = _head(path)
    if kind == "NrrdImageIO":
        return _about_nrrd(path, head)
    if kind == "MetaImageIO":
        return _about_meta(path, head)
    if kind == "VTKImageIO" and not re.search(r"^(SPACING|ASPECT_RATIO)\s", head.split("POINT_DATA")[0], re.M | re.I):
        raise ValueError(_no_distances(path, "SPACING"))
    return _left_open(kind not in ("VTKImageIO", "GiplImageIO"), True)


def check_numbers(path: Path, kind: str) -> None:
    """Refuse a header with too few numbers, or texts in place of numbers, which ITK would misread.

    Parameters
    ----------
    path : Path
    kind : str
        As in `notes_about`.

    Raises
    ------
    ValueError
        If a number for size or position of the voxels is missing or invalid.
    """
    head = _head(path)
    if kind == "MetaImageIO":
        fields = _fields(r"^\s*(\w+)\s*=(.*)$", head.split("ElementDataFile", maxsplit=1)[0])
        axes = fields.get("ndims", "")
        if not axes.isdecimal() or not 1 <= int(axes) <= _MOST_AXES:
            msg = f"{path} says that it has {axes or 'no'} dimensions (NDims); three are needed. Correct its header."
            raise ValueError(msg)
        counts = {"dimsize": int(axes)}
        counts.update(dict.fromkeys(_META_DISTANCES | _META_ORIGINS, int(axes)))
        counts.update(dict.fromkeys(_META_DIRECTIONS, int(axes) ** 2))
    elif kind == "VTKImageIO":
        fields = _fields(r"^\s*(\w+) +(.*)$", head.split("POINT_DATA")[0])
        counts = dict.fromkeys(("dimensions", "spacing", "aspect_ratio", "origin"), 3)
    else:
        return
    for field, count in counts.items():
        numbers = _numbers(fields[field]) if field in fields else np.zeros(count)
        if len(numbers) != count or not np.isfinite(numbers).all():
            msg = f"{path} has the {field} {fields[field]}; {count} numbers are needed. Correct its header."
            raise ValueError(msg)


def cause(path: Path, kind: str, error: str) -> str:
    """Find the cause why ITK cannot read a file.

    Parameters
    ----------
    path : Path
    kind : str
        As in `notes_about`.
    error : str
        ITK's report, several lines.

    Returns
    -------
    str
        Without a capital and a full stop; empty if it is unknown.
    """
    head = _head(path)
    named = re.search(r"^(?:ElementDataFile *=|data ?file:)(.*)$", head, re.M | re.I)
    data = named[1].strip() if named else ""
    # The voxels may be in the same file, or in several that a pattern or a list names.
    if data and not re.match(r"LOCAL|LIST|.*[% ]", data, re.I) and not (path.parent / data).exists():
        return f"the file of its voxels, {data}, is not beside it"
    if re.search(r"^encoding: *(bz2|bzip2)", head, re.M | re.I):
        return "it is compressed by bzip2, which ITK cannot read; save it with gzip"
    if "number of domain axes" in error:
        return "it has more axes than its space, such as time; save one volume of it as a file of its own"
    if kind == "MetaImageIO" and "for reading" in error:
        return _meta_cause(head)
    return next((text for words, text in _CAUSES if re.search(words, error)), "")


def _meta_cause(head: str) -> str:
    """Find the cause if ITK only reports that a MetaImage file cannot be read."""
    fields = re.findall(r"^\s*(\w+)\s*=", head.split("ElementDataFile", maxsplit=1)[0], re.M)
    late = [field for field in fields[: fields.index("NDims")] if field.lower() in _META_SIZED]
    if late:
        return f"its header has {late[0]} above NDims, which has to come first"
    return "its data end too soon"


def _about_nrrd(path: Path, head: str) -> list[str]:
    fields = _fields(r"^([^:#\n]+):(?!=)(.*)$", re.split(r"\r?\n\r?\n", head, maxsplit=1)[0])
    vectors = [each.lower() for each in _VECTOR.findall(fields.get("space directions", ""))]
    distances = [text for text in fields.get("spacings", "").split() if text.lower() != "nan"]
    # One axis of four may be the components of a voxel.
    if len(vectors) - vectors.count("none") < 3 and len(distances) < 3:
        raise ValueError(_no_distances(path, "space directions"))
    kinds = fields.get("kinds", "").lower().split()
    if len(kinds) == 3 and "time" in kinds:
        msg = (
            f"{path} says that one of its three axes is time (kinds: {' '.join(kinds)}): a time series of one slice, "
            "which is no volume. Choose another file, or correct its header."
        )
        raise ValueError(msg)
    units = re.findall(r'"([^"]*)"', fields.get("space units", "") or fields.get("units", ""))
    _check_unit(path, next((unit for unit in units[:3] if unit.lower() not in _MILLIMETRES), ""))
    space = fields.get("space", "").lower()
    if space in _NOT_TURNED:
        msg = f"{path} is in the space {space}, which is not understood; save one volume of it as a file of its own."
        raise ValueError(msg)
    has_axes = bool(vectors) and (space in _SHORT_SPACES or len(_SIDES & set(space.split("-"))) == 3)
    return _left_open(has_axes, bool({"space origin", "axis mins"} & set(fields)))


def _about_meta(path: Path, head: str) -> list[str]:
    fields = _fields(r"^\s*(\w+)\s*=(.*)$", head.split("ElementDataFile", maxsplit=1)[0])
    if not _META_DISTANCES & set(fields):
        raise ValueError(_no_distances(path, "ElementSpacing"))
    unit = fields.get("distanceunits", "")
    _check_unit(path, "" if unit.lower() in {*_MILLIMETRES, "?"} else unit)
    placed = [bool(names & set(fields)) for names in (_META_DIRECTIONS, _META_ORIGINS)]
    return _left_open(*placed)


def _left_open(has_axes: bool, has_origin: bool) -> list[str]:
    """Warn of missing axes or origin."""
    missing = [text for text, given in ((_NO_AXES, has_axes), (_NO_ORIGIN, has_origin)) if not given]
    return [f"it does not say {text}" for text in missing]


def _fields(pattern: str, head: str) -> dict[str, str]:
    return {key.strip().lower(): text.strip() for key, text in re.findall(pattern, head, re.MULTILINE)}


def _head(path: Path) -> str:
    """Beginning of a file as text."""
    with path.open("rb") as file:
        return file.read(_MOST_BYTES).decode("latin-1")


def _numbers(text: str) -> list[float]:
    """Convert the words of a text to numbers; NaN for a word that is no number."""
    numbers = []
    for word in text.split():
        try:
            numbers.append(float(word))
        except ValueError:
            numbers.append(np.nan)
    return numbers


def _check_unit(path: Path, unit: str) -> None:
    if unit:
        msg = f"{path} gives its lengths in {unit}; millimetres are needed. Convert it, or correct its header."
        raise ValueError(msg)


def _no_distances(path: Path, field: str) -> str:
    return (
        f"{path} does not give the distances of its voxels (no {field} for each of its three axes); write them into "
        "its header, or give the file that it was made of."
    )


def notes_about_directions(directions: np.ndarray, spacing: np.ndarray) -> list[str]:
    """Warn of directions whose length is not 1, because they scale the distances of the voxels.

    Parameters
    ----------
    directions : (3, 3) ndarray
        In columns.
    spacing : (3,) ndarray
        As the file gives it, mm.

    Returns
    -------
    list of str
        A sentence, or none.
    """
    lengths = np.linalg.norm(directions, axis=0)
    cosines = (directions.T @ directions)[np.triu_indices(3, 1)]
    # Sheared axes have a warning of their own.
    if np.abs(lengths - 1.0).max() <= _UNIT or np.abs(cosines).max() > _UNIT:
        return []
    sizes = (lengths, spacing, lengths * spacing)
    found, given, taken = (" x ".join(f"{length:.4g}" for length in each) for each in sizes)
    return [
        f"the directions of its axes have the lengths {found} instead of 1, so that its voxels of {given} mm were "
        f"taken as {taken} mm, as ITK and 3D Slicer do"
    ]


def check_spacing(path: Path, spacing: np.ndarray) -> None:
    """Refuse a voxel spacing that is not positive.

    Raises
    ------
    ValueError
        If one is not a positive number.
    """
    if np.isfinite(spacing).all() and np.all(np.asarray(spacing) > 0.0):
        return
    steps = " x ".join(f"{step:g}" for step in spacing)
    msg = f"{path} has the voxel spacing {steps} mm; every spacing must be positive. Correct the file's header."
    raise ValueError(msg)
