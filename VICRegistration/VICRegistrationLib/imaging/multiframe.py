"""DICOM files with several frames, and DICOM segmentations, read by the optional package highdicom."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable, Iterator, MutableSequence, Sequence

import numpy as np

from .slices import Slice

# Enhanced MR, MR color, CT, PET, XA and X-ray 3D, legacy converted CT, MR and PET, and parametric maps.
SOP_CLASSES = tuple(
    f"1.2.840.10008.5.1.4.1.1.{number}"
    for number in ("4.1", "4.3", "2.1", "130", "13.1.1", "13.1.2", "2.2", "4.4", "128.1", "30")
)
# Elements that may distinguish frames at the same position, besides the file's own dimensions, the simplest first.
_DISTINGUISHING = (
    ("FrameContentSequence", "TemporalPositionIndex"),
    ("FrameContentSequence", "StackID"),
    ("MREchoSequence", "EffectiveEchoTime"),
    ("MRDiffusionSequence", "DiffusionBValue"),
    ("CardiacSynchronizationSequence", "NominalCardiacTriggerDelayTime"),
    ("MRImageFrameTypeSequence", "FrameType"),
    ("MRImageFrameTypeSequence", "ComplexImageComponent"),
    ("FrameContentSequence", "FrameAcquisitionNumber"),
)
# Largest distance of a frame from its place in the grid, mm, as for slices.
_MOST_OFF = 0.1
# Slices farther apart than this, in thicknesses, have missing slices between them.
_MOST_THICKNESSES = 1.9
_PLACING = (
    ("PlanePositionSequence", "ImagePositionPatient", 3),
    ("PlaneOrientationSequence", "ImageOrientationPatient", 6),
    ("PixelMeasuresSequence", "PixelSpacing", 2),
)


def header_of(name: str) -> dict[str, str]:
    """Read the texts of a file's top-level elements, for files that ITK does not understand.

    Parameters
    ----------
    name : str

    Returns
    -------
    dict of str to str
        By tags as ITK writes them, "0028|0008"; empty if pydicom is not installed, or cannot read the file either.
    """
    if importlib.util.find_spec("pydicom") is None:
        return {}
    import pydicom

    try:
        dataset = pydicom.dcmread(name, stop_before_pixels=True)
        texts = [element for element in dataset if element.VR != "SQ"]
        kind = {"0008|0016": str(dataset.file_meta.get("MediaStorageSOPClassUID", ""))}
    # pydicom raises errors of many types for damaged files, also when a value is accessed.
    except Exception:
        return {}
    return {**kind, **{f"{each.tag.group:04x}|{each.tag.element:04x}": _text(each.value) for each in texts}}


def kind_of(sop_class: str) -> str:
    """Name of a SOP class by its UID; empty if it is unknown or pydicom is not installed."""
    if importlib.util.find_spec("pydicom") is None:
        return ""
    from pydicom.uid import UID

    kind = UID(sop_class)
    return kind.name if kind.is_valid else ""


def _reports_damage(function: Callable) -> Callable:
    """Decorate a function of a file's name: errors of pydicom and highdicom become one that says it is damaged."""

    @functools.wraps(function)
    def checked(name: str, *more):
        try:
            return function(name, *more)
        except ValueError:
            raise
        except Exception as error:
            msg = f"{name} is damaged ({_reason(error)}); copy it again."
            raise ValueError(msg) from error

    return checked


@_reports_damage
def slices_of(name: str) -> list[Slice]:
    """Make the slices of all frames of a file.

    Parameters
    ----------
    name : str

    Returns
    -------
    list of Slice

    Raises
    ------
    ValueError
        If highdicom is not installed, a frame has no position, or the file is damaged.
    """
    _require_highdicom(name)
    import pydicom

    dataset = pydicom.dcmread(name, stop_before_pixels=True)
    if "PerFrameFunctionalGroupsSequence" not in dataset:
        msg = (
            f"{name} holds {dataset.get('NumberOfFrames', 1)} frames without a place for each of them, which are no "
            "volume; export the series as single slices or as an enhanced multi-frame file."
        )
        raise ValueError(msg)
    placed, count = len(dataset.PerFrameFunctionalGroupsSequence), int(dataset.get("NumberOfFrames") or 1)
    if placed < count:
        msg = (
            f"{name} holds {count} frames, but a place for {placed} of them only "
            "(PerFrameFunctionalGroupsSequence); export the series again from where it was acquired."
        )
        raise ValueError(msg)
    dimensions = _dimensions(dataset)
    found = []
    for number, frame in enumerate(dataset.PerFrameFunctionalGroupsSequence):
        groups = [frame, *dataset.get("SharedFunctionalGroupsSequence", [])]
        place = [_placing(groups, name, number, *which) for which in _PLACING]
        properties = dict(_properties(groups, dimensions))
        found.append(Slice(*place, (int(dataset.Rows), int(dataset.Columns)), (name, number), properties))
    return found


def frames_of(name: str, numbers: Sequence[int]) -> np.ndarray:
    """Read the grey levels of frames, with the slope and intercept of each applied.

    Parameters
    ----------
    name : str
        File that `slices_of` has read.
    numbers : sequence of int
        From 0.

    Returns
    -------
    (n, rows, columns) ndarray

    Raises
    ------
    ValueError
        If they cannot be decoded.
    """
    import highdicom

    try:
        image = highdicom.imread(name)
        # As in ITK and Slicer, neither real-world values nor inverted greys are applied.
        return image.get_frames(
            [number + 1 for number in numbers],
            dtype=np.float32,
            apply_real_world_transform=False,
            apply_presentation_lut=False,
        )
    except Exception as error:
        raise ValueError(_not_decoded(name, error)) from error


@_reports_damage
def segments_of(name: str) -> dict[int, str]:
    """Return the numbers and names of the segments of a DICOM segmentation.

    Parameters
    ----------
    name : str

    Returns
    -------
    dict of int to str

    Raises
    ------
    ValueError
        If highdicom is not installed, or the file is damaged.
    """
    segmentation = _segmentation(name)
    numbers = segmentation.segment_numbers
    return {number: str(segmentation.get_segment_description(number).segment_label) for number in numbers}


@_reports_damage
def segment_in(name: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Read the voxels of one segment of a DICOM segmentation.

    Parameters
    ----------
    name : str
    number : int
        Of the segment, from `segments_of`.

    Returns
    -------
    mask : (nk, nj, ni) ndarray of bool
        Slices without a frame are empty.
    ijk_to_lps : (4, 4) ndarray

    Raises
    ------
    ValueError
        If its frames make no grid, or cannot be decoded.
    """
    segmentation = _segmentation(name)
    _check_step(segmentation, name)
    try:
        volume = segmentation.get_volume(segment_numbers=[number], combine_segments=False, dtype=np.float32)
    except Exception as error:
        if "regularly-spaced" not in str(error):
            raise ValueError(_not_decoded(name, error)) from error
        msg = f"The frames of {name} are not in even steps along their normal, so they are no volume; export it again."
        raise ValueError(msg) from error
    # Fractional segmentations are thresholded at one half.
    mask = volume.array[..., 0] >= 0.5
    # highdicom has the order slices, rows, columns, which is reversed here.
    matrix = volume.affine[:, [2, 1, 0, 3]]
    _check_places(name, np.linalg.inv(matrix), matrix)
    return mask, matrix


def _check_step(segmentation, name: str) -> None:
    """Refuse a segmentation with unknown distance of its slices, because slices without voxels may be left out."""
    groups = [*segmentation.get("SharedFunctionalGroupsSequence", []), *segmentation.PerFrameFunctionalGroupsSequence]
    if _element(groups, "PixelMeasuresSequence", "SpacingBetweenSlices"):
        return
    thickness = float(_element(groups, "PixelMeasuresSequence", "SliceThickness") or np.inf)
    heights = np.unique(np.round([each.position @ each.normal for each in slices_of(name)], 3))
    if len(heights) < 2 or np.diff(heights).min() > _MOST_THICKNESSES * thickness:
        msg = (
            f"{name} does not give the distance of its slices (SpacingBetweenSlices), and its frames do not lie beside "
            "each other; export it again with all of its slices."
        )
        raise ValueError(msg)


def _check_places(name: str, lps_to_ijk: np.ndarray, ijk_to_lps: np.ndarray) -> None:
    """Refuse frames whose positions highdicom has changed: it straightens stacks tilted by up to 2.5 degrees."""
    places = np.array([each.position for each in slices_of(name)])
    ijk = places @ lps_to_ijk[:3, :3].T + lps_to_ijk[:3, 3]
    off = np.linalg.norm((ijk - np.round(ijk * [0, 0, 1])) @ ijk_to_lps[:3, :3].T, axis=1).max()
    if off > _MOST_OFF:
        msg = (
            f"The frames of {name} are shifted against each other by up to {off:.1f} mm beside their normal, which is "
            "no even grid; resample the segmentation to one, or give it as a .seg.nrrd file of 3D Slicer."
        )
        raise ValueError(msg)


# ------------------------------------------------------------------ highdicom and functional groups


def _require_highdicom(name: str) -> None:
    if importlib.util.find_spec("highdicom") is None:
        msg = (
            f"{name} is a DICOM file with several frames, which needs the package highdicom (Python 3.10 or "
            "newer); install it with: pip install highdicom."
        )
        raise ValueError(msg)


def _segmentation(name: str):
    _require_highdicom(name)
    import highdicom

    try:
        return highdicom.seg.segread(name)
    except Exception as error:
        msg = f"{name} cannot be read as a DICOM segmentation ({_reason(error)}); export it again."
        raise ValueError(msg) from error


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def _not_decoded(name: str, error: Exception) -> str:
    return (
        f"The frames of {name} cannot be decoded ({_reason(error)}); copy it again, or, if it is compressed, "
        "decompress it, for example with gdcmconv --raw, or install the package python-gdcm."
    )


def _placing(groups: Sequence, name: str, number: int, sequence: str, keyword: str, count: int) -> np.ndarray:
    """Read the numbers of an element that places a frame."""
    value = _element(groups, sequence, keyword)
    try:
        values = np.array([] if value is None else value, dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        found = f"no {keyword}" if value is None else f"{keyword} {value}"
        msg = (
            f"Frame {number + 1} of {name} has {found}, so that its place in the patient is not known; {count} numbers "
            "are needed. Export the series again from where it was acquired."
        )
        raise ValueError(msg)
    return values


def _element(groups: Sequence, sequence: str, keyword: str):
    """Value in the first of the functional groups that has it, or None."""
    for group in groups:
        for item in group.get(sequence, []):
            if keyword in item:
                return item.get(keyword)
    return None


def _text(value) -> str:
    """Value of an element as DICOM writes it."""
    return "\\".join(map(str, value)) if isinstance(value, MutableSequence) else str(value)


def _dimensions(dataset) -> list[str]:
    """Names of the dimensions by which the file indexes its frames."""
    from pydicom.datadict import keyword_for_tag

    pointers = [item.get("DimensionIndexPointer") for item in dataset.get("DimensionIndexSequence", [])]
    return [keyword_for_tag(pointer) or str(pointer) for pointer in pointers if pointer is not None]


def _properties(groups: Sequence, dimensions: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield properties that may distinguish a frame from others at the same position."""
    for sequence, keyword in _DISTINGUISHING:
        value = _element(groups, sequence, keyword)
        if value is not None:
            yield keyword, _text(value)
    indices = _element(groups, "FrameContentSequence", "DimensionIndexValues")
    if indices is not None:
        for number, index in enumerate(np.atleast_1d(indices)):
            name = dimensions[number] if number < len(dimensions) else f"dimension {number + 1}"
            yield f"{name} index", str(index)
