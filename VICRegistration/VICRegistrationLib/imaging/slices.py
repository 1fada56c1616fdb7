"""Slices of a DICOM series, and the regular grid of their positions, or the reason why there is none.

Names, instance numbers and thicknesses are not used: slices are a volume if they have one orientation and one pixel
spacing, and their positions lie on a line in even steps. The line may be inclined to the slices (a tilted gantry).

highdicom makes volumes of series too, but it gives no reason when it refuses one, and it straightens stacks that are
tilted by up to 2.5 degrees, which moves the end of a stack of 100 mm by 4 mm. So it is only used to decode frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .volumes import volume_index

# Largest distance of a slice from its place in the grid, mm and steps. Scanners write positions with two digits or
# more, and a missing slice causes distances of a fifth of a step or more.
_MOST_MM, _MOST_STEPS = 0.1, 0.1
# Images closer than this along the normal are at the same place, mm.
_SAME_PLACE = 0.01
# Largest difference of direction cosines within one orientation, and largest deviation from perpendicular unit vectors.
_SAME_DIRECTION, _PERPENDICULAR = 1e-3, 1e-2
_SAME_SPACING = 1e-3
_PLANES = ("sagittal", "coronal", "axial")
_OTHER_SERIES = "Choose another series, or put the images that belong together into a folder of their own."
# Largest number of values listed in a message.
_LISTED = 6


@dataclass(frozen=True, eq=False)
class Slice:
    """One image of a stack.

    Parameters
    ----------
    position : (3,) ndarray
        Centre of its first pixel, LPS mm.
    orientation : (6,) ndarray
        Directions along its rows and along its columns (LPS), as in DICOM's ImageOrientationPatient.
    spacing : (2,) ndarray
        Distance between rows and between columns, mm, as in DICOM's PixelSpacing.
    shape : (int, int)
        Number of rows and columns.
    source : (str, int)
        File, and number in the file from 0.
    properties : dict of str to str
        Properties that may distinguish it from other images at the same place: echo time, time point and so on.
    """

    position: np.ndarray
    orientation: np.ndarray
    spacing: np.ndarray
    shape: tuple[int, int]
    source: tuple[str, int]
    properties: dict[str, str] = field(default_factory=dict)

    @property
    def normal(self) -> np.ndarray:
        """Unit vector from one slice to the next, LPS, shape (3,)."""
        normal = np.cross(self.orientation[:3], self.orientation[3:])
        return normal / np.linalg.norm(normal)

    @property
    def plane(self) -> str:
        """The nearest plane of the body."""
        return _PLANES[int(np.argmax(np.abs(self.normal)))]


def stacked(slices: Sequence[Slice], what: str, frame: int | None = None) -> tuple[list[Slice], np.ndarray]:
    """Sort slices by their positions, and find their regular grid.

    Parameters
    ----------
    slices : sequence of Slice
        In any order.
    what : str
        Name for messages, such as "the DICOM series in FOLDER".
    frame : int, optional
        Which volume to take, from 1, if there are several (time points, echoes, orientations).

    Returns
    -------
    slices : list of Slice
        Those of one volume, sorted along their normal.
    ijk_to_lps : (4, 4) ndarray
        Takes column, row and number of the slice to LPS mm.

    Raises
    ------
    ValueError
        If they are no volume; the message names the cause and a remedy.
    """
    _check_directions(slices, what)
    volumes, why = _volumes(slices, what)
    index = volume_index(frame, len(volumes), what, f"{_capital(what)} holds {why}")
    name = what if len(volumes) == 1 else f"frame {index + 1} of {what}"
    _check_alike(volumes[index], name)
    return _grid(volumes[index], name)


# ------------------------------------------------------------------ several volumes in one series


def _check_directions(slices: Sequence[Slice], what: str) -> None:
    """Refuse directions that are not perpendicular unit vectors, and pixel spacings that are not positive."""
    for each in slices:
        along = each.orientation.reshape(2, 3)
        if np.abs(along @ along.T - np.eye(2)).max() > _PERPENDICULAR or not np.all(each.spacing > 0.0):
            msg = (
                f"{_capital(what)} holds an image with the directions {_numbers(each.orientation)} and the pixel "
                f"spacing {_numbers(each.spacing)} mm; perpendicular directions of length 1 and positive lengths are "
                "needed. Export the series again from where it was acquired."
            )
            raise ValueError(msg)


def _check_alike(slices: Sequence[Slice], what: str) -> None:
    """Refuse slices of different sizes or pixel spacings."""
    shapes = sorted({each.shape for each in slices})
    if len(shapes) > 1:
        sizes = ", ".join(f"{columns} x {rows}" for rows, columns in shapes)
        msg = f"{_capital(what)} holds images of {sizes} pixels; one size is needed. {_OTHER_SERIES}"
        raise ValueError(msg)
    spacings = np.array([each.spacing for each in slices])
    if np.any(np.ptp(spacings, axis=0) > _SAME_SPACING * spacings.min(axis=0)):
        low, high = spacings.min(axis=0), spacings.max(axis=0)
        msg = (
            f"{_capital(what)} holds images with pixel spacings from {_numbers(low)} mm to {_numbers(high)} mm; one is "
            f"needed. {_OTHER_SERIES}"
        )
        raise ValueError(msg)


def _volumes(slices: Sequence[Slice], what: str) -> tuple[list[list[Slice]], str]:
    """Divide slices that cannot be one volume; returns also a description of the volumes, for a message."""
    oriented = _by_orientation(slices)
    if len(oriented) == 1:
        return _at_places(slices, what)
    if len(oriented) == len(slices) > 2:
        msg = (
            f"{_capital(what)} holds {len(slices)} images, each of another orientation (planes about an axis?), which "
            "are no volume. Choose another series."
        )
        raise ValueError(msg)
    found = []
    for group in oriented:
        try:
            found += _at_places(group, what)[0]
        except ValueError:
            # The error is raised again if this group is chosen.
            found.append(group)
    planes = _listed([f"{len(group)} {group[0].plane}" for group in oriented])
    return found, f"images of {len(oriented)} orientations (a localizer?): {planes}"


def _at_places(slices: Sequence[Slice], what: str) -> tuple[list[list[Slice]], str]:
    """Divide images of one orientation into volumes with one image at each place; as `_volumes`."""
    _check_alike(slices, what)
    places = _places(slices)
    most = max(map(len, places))
    if most == 1:
        return [list(slices)], ""
    if len(places) == 1:
        msg = (
            f"{_capital(what)} holds {len(slices)} images that are all at one place (ImagePositionPatient): a time "
            "series, or positions that were removed. A volume needs several places; choose another series."
        )
        raise ValueError(msg)
    count = f"{'up to ' * (min(map(len, places)) < most)}{most} images at each of its {len(places)} places"
    key = _distinguishing(places, most)
    if key:
        values = sorted({_value(each, key) for each in slices})
        groups = [[each for each in slices if _value(each, key) == value] for value in values]
        return groups, f"{count} ({' and '.join(key)}: {_listed([_words(value) for value in values])})"
    if min(map(len, places)) == most:
        ordered = [sorted(place, key=_number) for place in places]
        return [list(group) for group in zip(*ordered)], f"{count}, distinguished by their numbers only"
    twice = next(place for place in places if len(place) == most)
    (one, number), (other, second) = (each.source for each in twice[:2])
    names = f"{one} and {other}" if one != other else f"frames {number + 1} and {second + 1} of {one}"
    msg = (
        f"{_capital(what)} holds {len(slices)} images at {_count(len(places), 'place')}, so that some places have "
        f"several: {names} are at one. Remove what is there twice, or choose another series."
    )
    raise ValueError(msg)


def _by_orientation(slices: Sequence[Slice]) -> list[list[Slice]]:
    """Group slices of one orientation, the largest group first."""
    groups: list[list[Slice]] = []
    for each in slices:
        for group in groups:
            if np.abs(each.orientation - group[0].orientation).max() <= _SAME_DIRECTION:
                group.append(each)
                break
        else:
            groups.append([each])
    return sorted(groups, key=len, reverse=True)


def _places(slices: Sequence[Slice]) -> list[list[Slice]]:
    """Group slices that lie in the same plane, sorted along their normal."""
    heights = np.array([each.position for each in slices]) @ slices[0].normal
    order = np.argsort(heights, kind="stable")
    starts = np.flatnonzero(np.diff(heights[order]) > _SAME_PLACE) + 1
    return [[slices[number] for number in part] for part in np.split(order, starts)]


def _distinguishing(places: list[list[Slice]], most: int) -> tuple[str, ...]:
    """Find one property, or two together, whose values distinguish the images at each place in the same way."""
    names = list(dict.fromkeys(name for place in places for each in place for name in each.properties))
    for size in (1, 2):
        for key in itertools.combinations(names, size):
            found = [[_value(each, key) for each in place] for place in places]
            if all(len(set(values)) == len(values) for values in found) and len(set(sum(found, []))) == most:
                return key
    return ()


def _value(each: Slice, key: tuple[str, ...]) -> tuple[tuple[float, str], ...]:
    """Values of properties as keys for sorting, numbers in numerical order."""
    return tuple(_sortable(each.properties.get(name, "")) for name in key)


def _sortable(text: str) -> tuple[float, str]:
    try:
        return float(text), text
    except ValueError:
        return np.inf, text


def _number(each: Slice) -> tuple[tuple[float, str], int]:
    return _sortable(each.properties.get("InstanceNumber", "")), each.source[1]


# ------------------------------------------------------------------ one volume


def _grid(slices: Sequence[Slice], what: str) -> tuple[list[Slice], np.ndarray]:
    """Sort slices of one orientation, one at each place, and fit a line with even steps to their positions."""
    normal = slices[0].normal
    places = _places(slices)
    ordered = [each for place in places for each in place]
    count = len(places)
    if count < 2:
        msg = f"{_capital(what)} holds a single slice; a surface needs several slices of one series."
        raise ValueError(msg)
    if len(ordered) > count:
        msg = f"{_capital(what)} holds {len(ordered)} images at {count} places; one at each is needed. {_OTHER_SERIES}"
        raise ValueError(msg)
    positions = np.array([each.position for each in ordered])
    numbers = np.arange(count) - (count - 1) / 2.0
    step = numbers @ positions / (numbers @ numbers)
    off = positions - positions.mean(axis=0) - numbers[:, None] * step
    heights = off @ normal
    most = min(_MOST_MM, _MOST_STEPS * abs(step @ normal))
    if np.abs(heights).max() > most:
        raise ValueError(_about_uneven(positions @ normal, what))
    sideways = np.linalg.norm(off - heights[:, None] * normal, axis=1)
    if sideways.max() > most:
        steps = np.diff(off, axis=0)
        shift = np.linalg.norm(steps - np.median(steps, axis=0), axis=1).max()
        msg = (
            f"{_capital(what)} holds slices that are shifted sideways against their neighbours by up to {shift:.1f} "
            "mm, which is no volume (slabs that were centred one by one?). Choose another series, or put one "
            "slab into a folder of its own."
        )
        raise ValueError(msg)
    directions = np.mean([each.orientation for each in ordered], axis=0).reshape(2, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    row, column = ordered[0].spacing
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([directions[0] * column, directions[1] * row, step], axis=1)
    matrix[:3, 3] = positions.mean(axis=0) + numbers[0] * step
    return ordered, matrix


def _about_uneven(heights: np.ndarray, what: str) -> str:
    """Make the message about slices that are not in even steps."""
    gaps = np.diff(heights)
    steps = gaps / gaps.min()
    apart = f"{_capital(what)} holds slices that are {gaps.min():.2f} to {gaps.max():.2f} mm apart"
    missing = int(np.round(steps).sum()) - len(gaps)
    # Slices are missing if most gaps are equal and the others are multiples of them. If more slices would be missing
    # than there are, these are rather images of several time points at slightly different places.
    usual = np.sort(steps)[(len(steps) - 1) // 2]
    multiples = max(usual - 1.0, np.abs(steps - np.round(steps)).max()) < _MOST_STEPS
    if multiples and 0 < missing <= len(heights):
        return f"{apart}, so {_count(missing, 'slice')} may be missing. Copy the series again, with all of its slices."
    return f"{apart}; even distances are needed. Choose another series, or resample this one to even steps."


# ------------------------------------------------------------------ messages


def _capital(what: str) -> str:
    """Capitalise the name at the beginning of a sentence, unless it is a file name."""
    return what[0].upper() + what[1:] if what.startswith(("the ", "frame ")) else what


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _words(value: tuple[tuple[float, str], ...]) -> str:
    return " and ".join(text or "none" for _, text in value)


def _listed(texts: Sequence[str]) -> str:
    rest = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(texts[:_LISTED]) + rest
