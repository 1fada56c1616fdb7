"""DICOM: series of a folder, and files with several frames, placed by the position and orientation of each image."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from . import multiframe
from .library_messages import one_line
from .slices import Slice, stacked
from .volumes import SeveralVolumes

_SOP_CLASS, _IMAGE_TYPE, _FRAMES, _SAMPLES = "0008|0016", "0008|0008", "0028|0008", "0028|0002"
_PHOTOMETRIC, _SLOPE = "0028|0004", "0028|1053"
_SERIES, _SERIES_DESCRIPTION, _SERIES_NUMBER = "0020|000e", "0008|103e", "0020|0011"
_FRAME_OF_REFERENCE = "0020|0052"
_READER = "GDCMImageIO"
# Its only message about a file whose pixels it does not find.
_NO_PIXELS = "Cannot read requested file"
_ROWS, _COLUMNS = "0028|0010", "0028|0011"
_POSITION, _ORIENTATION, _SPACING = "0020|0032", "0020|0037", "0028|0030"
_PLACING = {
    _POSITION: ("ImagePositionPatient", 3),
    _ORIENTATION: ("ImageOrientationPatient", 6),
    _SPACING: ("PixelSpacing", 2),
}
# Elements that may distinguish images at the same position, the simplest first.
_DISTINGUISHING = {
    "0020|0100": "TemporalPositionIdentifier",
    "0018|0086": "EchoNumbers",
    "0018|0081": "EchoTime",
    "0018|9087": "DiffusionBValue",
    "0018|0082": "InversionTime",
    "0018|1314": "FlipAngle",
    "0018|1060": "TriggerTime",
    "0008|0008": "ImageType",
    "0018|0024": "SequenceName",
    "0020|0012": "AcquisitionNumber",
    "0008|0032": "AcquisitionTime",
    "0020|0013": "InstanceNumber",
}
# Segmentations have pixels, but are no images of a patient.
_SEGMENTATIONS = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")

# Largest number of file names in a message, and of folders that are searched for DICOM files.
_LISTED, _MOST_FOLDERS = 3, 200

Header = dict[str, str]
Placed = tuple[np.ndarray, np.ndarray, list[str]]


class _NoImageError(ValueError):
    """A DICOM file without an image: a report, a presentation state, a directory."""


def is_dicom(path: Path) -> bool:
    """Whether a file begins with the DICOM prefix."""
    with path.open("rb") as file:
        return file.read(132)[128:] == b"DICM"


def is_segmentation(path: Path) -> bool:
    """Whether a file is a DICOM segmentation; False if it cannot be read."""
    try:
        return is_dicom(path) and _header(str(path)).get(_SOP_CLASS) in _SEGMENTATIONS
    except ValueError:
        return False


def segmentation_in(folder: Path) -> Path | None:
    """Find the DICOM segmentation in a folder.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Path or None
        None if there is none.

    Raises
    ------
    ValueError
        If there are several.
    """
    found = sorted(path for path in folder.iterdir() if path.is_file() and is_segmentation(path))
    if len(found) > 1:
        names = ", ".join(path.name for path in found[:_LISTED])
        msg = (
            f"The folder {folder} holds {len(found)} DICOM segmentations ({names}{', ...' * (len(found) > _LISTED)}); "
            "give the file of one of them."
        )
        raise ValueError(msg)
    return found[0] if found else None


def read_series(folder: Path, series: str | None, frame: int | None) -> Placed:
    """Read a series from a folder.

    Parameters
    ----------
    folder : Path
    series : str, optional
        UID, description or number of the series, if there are several.
    frame : int, optional
        Which of several volumes of the series, from 1.

    Returns
    -------
    array : (nk, nj, ni) ndarray
    ijk_to_lps : (4, 4) ndarray
    notes : list of str
        Warnings for the user, a sentence each.

    Raises
    ------
    ValueError
        If there are several series and none was chosen, or if the series is no volume.
    """
    headers, damaged = _headers(folder)
    left_out = f"holds files that are damaged and were left out ({len(damaged)}): {', '.join(damaged[:_LISTED])}"
    try:
        array, matrix = _read(_chosen_series(headers, folder, series), f"the DICOM series in {folder}", frame)
    except SeveralVolumes:
        raise
    except ValueError as error:
        if not damaged:
            raise
        # The damaged files may be the missing slices.
        msg = f"{error} The folder also {left_out}."
        raise ValueError(msg) from error
    return array, matrix, [f"it {left_out}"] if damaged else []


def read_file(path: Path, frame: int | None) -> Placed:
    """Read the volume of a file with several frames.

    Parameters
    ----------
    path : Path
    frame : int, optional
        Which of several volumes in it, from 1.

    Returns
    -------
    array, ijk_to_lps, notes
        As in :func:`read_series`.

    Raises
    ------
    ValueError
        If it holds a single slice, or no volume.
    """
    header = _header(str(path))
    if header.get(_SOP_CLASS) in _SEGMENTATIONS:
        msg = f"{path} is a DICOM segmentation, not an image; give the series that it was drawn in."
        raise ValueError(msg)
    _check_kind(header, str(path), str(path))
    if not _several_frames(header):
        msg = f"{path} holds a single slice; a surface needs several slices, so give the folder that holds the series."
        raise ValueError(msg)
    return *_read({str(path): header}, str(path), frame), []


# ------------------------------------------------------------------ files of a series


def _headers(folder: Path) -> tuple[dict[str, Header], list[str]]:
    """Read the headers of the images in a folder; returns also the names of damaged files."""
    found, damaged = {}, []
    for path in sorted(path for path in folder.iterdir() if path.is_file()):
        try:
            header = _header(str(path))
        except _NoImageError:
            continue
        except ValueError:
            # Other files beside the slices, such as texts and pictures, are ignored.
            if is_dicom(path) or not path.stat().st_size:
                damaged.append(path.name)
            continue
        if not header.get(_SERIES):
            damaged.append(f"{path.name} (no SeriesInstanceUID)")
        elif header.get(_SOP_CLASS) not in _SEGMENTATIONS:
            found[str(path)] = header
    return found, damaged


def _chosen_series(headers: dict[str, Header], folder: Path, series: str | None) -> dict[str, Header]:
    """Return the files of the chosen series, with their headers."""
    found: dict[str, dict[str, Header]] = {}
    for name, header in headers.items():
        found.setdefault(header[_SERIES], {})[name] = header
    if not found:
        below = _folders_below(folder)
        named = f" ({', '.join(map(str, below[:_LISTED]))}{', ...' * (len(below) > _LISTED)})" if below else ""
        msg = (
            f"The folder {folder} holds no DICOM slices; choose the folder that holds the slices themselves{named}, or "
            "give the file of an image."
        )
        raise ValueError(msg)
    if series is None and len(found) == 1:
        return next(iter(found.values()))
    firsts = {uid: next(iter(files.values())) for uid, files in found.items()}
    named = {uid: [firsts[uid].get(tag, "") for tag in (_SERIES_DESCRIPTION, _SERIES_NUMBER)] for uid in found}
    matches = [uid for uid in found if series is not None and str(series) in (uid, *named[uid])]
    if len(matches) == 1:
        return found[matches[0]]
    listing = "; ".join(
        f"{uid} '{named[uid][0]}'{f', number {named[uid][1]}' * bool(named[uid][1])}, {len(names)} files"
        for uid, names in found.items()
    )
    reason = "" if series is None else f", and {len(matches) or 'none'} of them match '{series}'"
    listed = f"The folder {folder} holds {len(found)} DICOM series{reason}: {listing}"
    raise SeveralVolumes(listed, ". Choose one with --series (its UID, description or number).")


def _folders_below(folder: Path) -> list[Path]:
    """Return the subfolders in which the first file that is not hidden is a DICOM file."""
    found = []
    for root, _, names in itertools.islice(os.walk(folder), _MOST_FOLDERS):
        paths = (Path(root, name) for name in sorted(names) if not name.startswith("."))
        # Folders without permission to read are left out.
        with contextlib.suppress(OSError):
            first = next((path for path in paths if path.is_file()), None)
            if first is not None and Path(root) != folder and is_dicom(first):
                found.append(Path(root))
    return sorted(found)


def _header(name: str) -> Header:
    """Read the texts of a file's top-level elements by their tags."""
    reader = sitk.ImageFileReader()
    reader.SetFileName(name)
    reader.SetImageIO(_READER)
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        header = multiframe.header_of(name)
        if _ROWS in header:
            return header
        kind = multiframe.kind_of(header.get(_SOP_CLASS, ""))
        if kind and "Image" not in kind:
            msg = (
                f"{name} is a DICOM file without an image ({kind}); give an image series, or for a reference a DICOM "
                "segmentation or a label image."
            )
            raise _NoImageError(msg) from None
        msg = f"{name} cannot be read as a DICOM image ({one_line(error)}); give the files of an image series."
        raise ValueError(msg) from None
    return {key: reader.GetMetaData(key).strip() for key in reader.GetMetaDataKeys()}


def _several_frames(header: Header) -> bool:
    return _number(header, _FRAMES) > 1 or header.get(_SOP_CLASS) in multiframe.SOP_CLASSES


def _number(header: Header, tag: str) -> int:
    """Integer value of an element; 0 if it is missing or no integer."""
    return int(header[tag]) if header.get(tag, "").isdecimal() else 0


# ------------------------------------------------------------------ one series


def _read(headers: dict[str, Header], what: str, frame: int | None) -> tuple[np.ndarray, np.ndarray]:
    _check_one_frame_of_reference(headers.values(), what)
    slices: list[Slice] = []
    for name, header in headers.items():
        _check_kind(header, name, what)
        slices += multiframe.slices_of(name) if _several_frames(header) else [_slice_of(name, header, what)]
    ordered, matrix = stacked(slices, what, frame)
    _check_levels({each.source[0]: headers[each.source[0]] for each in ordered}, what)
    multi = {name for name, header in headers.items() if _several_frames(header)}
    return _voxels(ordered, multi, what), matrix


def _check_one_frame_of_reference(headers: Iterable[Header], what: str) -> None:
    found = {header.get(_FRAME_OF_REFERENCE, "") for header in headers} - {""}
    if len(found) > 1:
        msg = (
            f"The positions in {what} refer to {len(found)} different frames of reference (the patient was moved "
            "between them?), so they are no volume; choose another series."
        )
        raise ValueError(msg)


def _check_kind(header: Header, name: str, what: str) -> None:
    """Refuse colours and mosaics."""
    if _number(header, _SAMPLES) > 1 or "PALETTE" in header.get(_PHOTOMETRIC, ""):
        msg = f"The image {name} of {what} is in colour; grey levels are needed. Choose another series."
        raise ValueError(msg)
    if "MOSAIC" in header.get(_IMAGE_TYPE, "").upper().split("\\"):
        msg = (
            f"{name} is a Siemens mosaic, all slices of a volume in one picture, which has no place in the patient; "
            "convert the series to NIfTI, for example with dcm2niix, and give that file."
        )
        raise ValueError(msg)


def _check_levels(headers: dict[str, Header], what: str) -> None:
    """Refuse slices whose grey levels do not have the same scale."""
    scales = [header.get(_PHOTOMETRIC, "none") for header in headers.values()]
    if len(set(scales)) > 1:
        counts = ", ".join(f"{scales.count(scale)} {scale}" for scale in sorted(set(scales)))
        msg = (
            f"The slices of {what} differ in their PhotometricInterpretation ({counts}): what is bright in some is "
            "dark in the others, and their levels are not on one scale. Export the series again from where it was "
            "acquired."
        )
        raise ValueError(msg)
    # ITK replaces an invalid slope by 1, which is harmless if all slices have the same slope.
    if len({header.get(_SLOPE) for header in headers.values()}) < 2:
        return
    for name, header in headers.items():
        if not _is_slope(header.get(_SLOPE) or "1"):
            msg = (
                f"The image {name} of {what} has the RescaleSlope {header[_SLOPE]}, and other slices another one, so "
                "that its grey levels are not known; a number other than 0 is needed. Export the series again from "
                "where it was acquired."
            )
            raise ValueError(msg)


def _is_slope(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)) and float(text) != 0.0)
    except ValueError:
        return False


def _slice_of(name: str, header: Header, what: str) -> Slice:
    """Make the slice of a file with one image."""
    values = {}
    for tag, (keyword, count) in _PLACING.items():
        try:
            values[tag] = np.array(header.get(tag, "").split("\\"), dtype=float)
        except ValueError:
            values[tag] = np.empty(0)
        if len(values[tag]) != count or not np.isfinite(values[tag]).all():
            found = f"the {keyword} '{header[tag]}'" if header.get(tag) else f"no {keyword}"
            msg = (
                f"The image {name} of {what} has {found}, so that its place in the patient is not known; {count} "
                "numbers are needed. Export the series again from where it was acquired."
            )
            raise ValueError(msg)
    properties = {keyword: header[tag] for tag, keyword in _DISTINGUISHING.items() if header.get(tag)}
    shape = _number(header, _ROWS), _number(header, _COLUMNS)
    return Slice(values[_POSITION], values[_ORIENTATION], values[_SPACING], shape, (name, 0), properties)


def _voxels(slices: Sequence[Slice], multi: set[str], what: str) -> np.ndarray:
    """Read the grey levels of slices, with the slope and intercept of each applied."""
    wanted: dict[str, list[int]] = {}
    for number, each in enumerate(slices):
        wanted.setdefault(each.source[0], []).append(number)
    images: list = [None] * len(slices)
    for name, numbers in wanted.items():
        if name in multi:
            found = multiframe.frames_of(name, [slices[number].source[1] for number in numbers])
        else:
            try:
                image = sitk.ReadImage(name, imageIO=_READER)
                found = sitk.GetArrayFromImage(image).reshape(1, *slices[numbers[0]].shape)
            except RuntimeError as error:
                why = one_line(error)
                if why == _NO_PIXELS:
                    why = "its pixels are missing or cut short, or compressed in a way that is not known"
                msg = f"The image {name} of {what} cannot be read ({why}); copy or export the series again."
                raise ValueError(msg) from None
        for number, image in zip(numbers, found):
            images[number] = image
    return np.stack(images)
