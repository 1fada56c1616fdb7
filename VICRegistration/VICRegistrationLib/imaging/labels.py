"""Organs in label images: by value, or by the name of the segment in Slicer's .seg.nrrd files."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .image import Image
from .reading import read_header, read_image

# So many labels are listed before the rest is only counted.
_LISTED = 12
# An image with more values than this is hardly a segmentation.
_MANY = 255


@dataclass(frozen=True)
class Segment:
    """One organ of a label image.

    Parameters
    ----------
    value : int
        Of its voxels.
    name : str
        Empty where the file tells none.
    layer : int
        Which of the values of a voxel it is; segments of different layers may overlap.
    """

    value: int
    name: str = ""
    layer: int = 0

    def __str__(self) -> str:
        """Value, and name if there is one."""
        return f"{self.value} ({self.name})" if self.name else str(self.value)


def read_label(path: str | os.PathLike, label: int | str | None = None, *, organ: str = "") -> tuple[Image, Segment]:
    """Read the voxels of one label.

    Parameters
    ----------
    path : path
        Any image that SimpleITK reads; segments of Slicer's .seg.nrrd files have names, and may be in several layers.
    label : int or str, optional
        Value or name of the segment, in upper or lower case. If not given, the only one that there is, or the one that
        has the organ's name.
    organ : str
        Name of the organ.

    Returns
    -------
    mask : Image
        True in the label's voxels, RAS mm.
    segment : Segment

    Raises
    ------
    ValueError
        If the file cannot be read, is no label image, or it is not clear which label is meant; the sentence lists them.
    """
    path = Path(path)
    named, layers = _named_segments(path)
    if named and layers > 1:
        segment = _chosen(named, label, organ, path)
        image = read_image(path, component=segment.layer)
    else:
        image = read_image(path)
        names = {segment.value: segment.name for segment in named}
        found = [Segment(value, names.get(value, "")) for value in _values(image, path)]
        segment = _chosen(found, label, organ, path)
    mask = image.array == segment.value
    if not mask.any():
        msg = f"{path}: the segment {segment} has no voxels; choose another label."
        raise ValueError(msg)
    return Image(mask, image.ijk_to_ras), segment


def _named_segments(path: Path) -> tuple[list[Segment], int]:
    """Segments that a file's header tells of, and the number of values in a voxel."""
    header, layers = read_header(path)
    told: dict[int, dict[str, str]] = {}
    for key, text in header.items():
        match = re.fullmatch(r"Segment(\d+)_(Name|LabelValue|Layer)", key)
        if match:
            told.setdefault(int(match[1]), {})[match[2]] = text
    segments = [
        Segment(int(parts["LabelValue"]), parts.get("Name", ""), int(parts.get("Layer", "0")))
        for _, parts in sorted(told.items())
        if re.fullmatch(r"\d+", parts.get("LabelValue", "")) and re.fullmatch(r"\d+", parts.get("Layer", "0"))
    ]
    return [segment for segment in segments if segment.layer < layers], layers


def _values(image: Image, path: Path) -> list[int]:
    """Labels of an image: its values other than 0."""
    values = np.unique(image.array)
    values = values[values != 0]
    if not np.array_equal(values, np.round(values)):
        msg = (
            f"{path} holds {values[values != np.round(values)][0]:g}; a label image holds whole numbers, 0 for the "
            "background. Give a segmentation, not the image itself."
        )
        raise ValueError(msg)
    if not len(values):
        msg = f"{path} holds no label: all of its voxels are 0. Give a segmentation with the organ in it."
        raise ValueError(msg)
    return [int(value) for value in values]


def _chosen(segments: Sequence[Segment], label: int | str | None, organ: str, path: Path) -> Segment:
    """Choose the one segment that is meant."""
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
        msg = f"{path} holds {len(segments)} labels, {listed}{rest}; choose one with the option label (value or name)."
    elif matching:
        msg = f"{path} holds {len(matching)} labels {label}: {', '.join(map(str, matching))}; choose one by its name."
    else:
        msg = f"{path} holds no label {label}, but {listed}{rest}; choose one of these."
    raise ValueError(msg)
