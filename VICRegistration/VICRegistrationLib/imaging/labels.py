"""Organs in label images, chosen by value or by the name of a segment (Slicer's .seg.nrrd, DICOM segmentations)."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import dicom, multiframe
from .image import Image
from .reading import LPS_TO_RAS, read_header, read_image
from .volumes import SeveralVolumes

# Largest number of labels listed in a message.
_LISTED = 12
# An image with more values than this is probably no segmentation.
_MANY = 255
# Largest deviation of labels from integers by rounding (float32 in programs that interpolate).
_ROUNDING = 1e-3
# An image with fewer values than this is probably a label map: those of whole bodies have about a hundred values, 8-bit
# MRI twice that.
_FEW = 100
# Number of voxels that are sampled to count the values.
_SAMPLED = 1 << 20


@dataclass(frozen=True)
class Segment:
    """One organ of a label image.

    Parameters
    ----------
    value : int
        Of its voxels.
    name : str
        Empty if the file has none.
    layer : int
        Component of the voxels that holds the segment; segments of different layers may overlap.
    """

    value: int
    name: str = ""
    layer: int = 0

    def __str__(self) -> str:
        """Value, and name if there is one."""
        return f"{self.value} ({self.name})" if self.name else str(self.value)


def read_label(
    path: str | os.PathLike,
    label: int | str | None = None,
    *,
    organ: str = "",
    warn: Callable[[str], None] | None = None,
) -> tuple[Image, Segment]:
    """Read the voxels of one label.

    Parameters
    ----------
    path : path
        Any image that `read_image` reads, or a folder with one DICOM segmentation; segments of Slicer's .seg.nrrd files
        and of DICOM segmentations have names, and may overlap.
    label : int or str, optional
        Value or name of the segment, in upper or lower case. If not given, the only segment, or the one with the
        organ's name.
    organ : str
        Name of the organ.
    warn : callable, optional
        As of `read_image`.

    Returns
    -------
    mask : Image
        True in the label's voxels, RAS mm.
    segment : Segment

    Raises
    ------
    ValueError
        If the file cannot be read or is no label image, or if the choice is not unique; the message lists the labels.
    """
    path = Path(path)
    warn = warn or warnings.warn
    path = (dicom.segmentation_in(path) if path.is_dir() else None) or path
    if path.is_file() and dicom.is_segmentation(path):
        image, segment = _dicom_segment(path, label, organ)
    else:
        image, segment = _labelled(path, label, organ, warn)
    if not image.array.any():
        msg = f"{path}: the segment {segment} has no voxels; choose another label."
        raise ValueError(msg)
    return image, segment


def few_values(image: Image) -> int:
    """Count the values of an image that has few, as a label map has; 0 for other images.

    Parameters
    ----------
    image : Image

    Returns
    -------
    int
    """
    step = max(1, image.array.size // _SAMPLED)
    values = np.unique(image.array.reshape(-1)[::step])
    if len(values) >= _FEW or not np.array_equal(values, np.round(values)):
        return 0
    count = len(np.unique(image.array))
    return count if 1 < count < _FEW else 0


def _dicom_segment(path: Path, label: int | str | None, organ: str) -> tuple[Image, Segment]:
    """Read one segment of a DICOM segmentation, with an empty slice added at both ends, which such files leave out."""
    found = [Segment(number, name) for number, name in multiframe.segments_of(str(path)).items()]
    segment = _chosen(found, label, organ, path)
    mask, matrix = multiframe.segment_in(str(path), segment.value)
    matrix = matrix.copy()
    matrix[:3, 3] -= matrix[:3, 2]
    return Image(np.pad(mask, ((1, 1), (0, 0), (0, 0))), LPS_TO_RAS @ matrix), segment


def _labelled(path: Path, label: int | str | None, organ: str, warn: Callable[[str], None]) -> tuple[Image, Segment]:
    """Read the voxels of one label of an image."""
    named, layers = _named_segments(path)
    if named and layers > 1:
        segment = _chosen(named, label, organ, path)
        image = read_image(path, frame=segment.layer + 1, warn=warn)
        values = _whole(image, path)
    else:
        try:
            image = read_image(path, warn=warn)
        except SeveralVolumes as error:
            msg = f"{error.found}; a label image is one volume. Save the one with the labels as a file of its own."
            raise ValueError(msg) from error
        values = _whole(image, path)
        names = {segment.value: segment.name for segment in named}
        found = [Segment(int(value), names.get(int(value), "")) for value in np.unique(values) if value != 0]
        if label is not None:
            # A segment without voxels can be chosen too, to be reported as empty.
            found += [segment for segment in named if segment.value not in {each.value for each in found}]
        if not found:
            msg = f"{path} holds no label: all of its voxels are 0. Give a segmentation with the organ in it."
            raise ValueError(msg)
        segment = _chosen(found, label, organ, path)
    return Image(values == segment.value, image.ijk_to_ras), segment


def _named_segments(path: Path) -> tuple[list[Segment], int]:
    """Return the segments in a file's header, and the number of layers.

    Slicer up to 4.10 wrote one layer for each segment, with the value 1, and wrote neither into the header.
    """
    header, layers = read_header(path) if path.is_file() else ({}, 1)
    listed: dict[int, dict[str, str]] = {}
    for key, text in header.items():
        match = re.fullmatch(r"Segment(\d+)_(ID|Name|LabelValue|Layer)", key)
        if match:
            listed.setdefault(int(match[1]), {})[match[2]] = text
    segments = []
    for number, parts in sorted(listed.items()):
        value, layer = parts.get("LabelValue", "1"), parts.get("Layer", str(number if "LabelValue" not in parts else 0))
        if value.isdecimal() and layer.isdecimal() and int(layer) < layers:
            segments.append(Segment(int(value), parts.get("Name", parts.get("ID", "")), int(layer)))
    return segments, layers


def _whole(image: Image, path: Path) -> np.ndarray:
    """Round the voxels to integers, if they deviate from these only by rounding."""
    values = image.array
    if values.dtype.kind != "f":
        return values
    rounded = np.round(values)
    off = np.abs(values - rounded) > _ROUNDING
    if off.any():
        msg = (
            f"{path} holds {values[off][0]:g}; a label image holds whole numbers, 0 for the background. Give a "
            "segmentation, not the image itself; of one that was resampled by interpolation, or of probabilities, save "
            "the voxels above one half as a mask."
        )
        raise ValueError(msg)
    return rounded


def _chosen(segments: Sequence[Segment], label: int | str | None, organ: str, path: Path) -> Segment:
    """Choose a segment by its label, or by the organ's name."""
    if label is None:
        matching = [segment for segment in segments if organ and segment.name.casefold() == organ.casefold()]
        if len(segments) == 1:
            matching = list(segments)
    else:
        word = str(label)
        ways = (
            [segment for segment in segments if segment.name == word],
            [segment for segment in segments if str(segment.value) == word],
            [segment for segment in segments if segment.name.casefold() == word.casefold()],
        )
        matching = next(filter(None, ways), [])
    if len(matching) == 1:
        return matching[0]
    listed = ", ".join(str(segment) for segment in segments[:_LISTED])
    rest = f" and {len(segments) - _LISTED} more" if len(segments) > _LISTED else ""
    if label is None and len(segments) > _MANY:
        msg = f"{path} holds {len(segments)} different values; give a segmentation, not the image itself."
    elif label is None:
        msg = f"{path} holds {len(segments)} labels, {listed}{rest}; choose one with --label (value or name)."
    elif matching:
        way = "value" if len({segment.name for segment in matching}) == 1 else "name"
        msg = f"{path} holds {len(matching)} labels {label}: {', '.join(map(str, matching))}; choose one by its {way}."
    else:
        msg = f"{path} holds no label {label}, but {listed}{rest}; choose one of these."
    raise ValueError(msg)
