"""Checks of values for flags and keys of a configuration, except the options of a fit."""

from __future__ import annotations

import math
from collections.abc import Callable


def point(value: object) -> tuple[float, float, float]:
    """Check a point: R, A, S in mm, out of a list or a text with commas."""
    parts = value.split(",") if isinstance(value, str) else value
    numbers = [_number(part) for part in parts] if isinstance(parts, list) else []
    if len(numbers) != 3 or None in numbers:
        msg = f"{value!r} was given; a point is three numbers R,A,S in mm, with commas between them, such as -3,42,10"
        raise ValueError(msg)
    return tuple(numbers)


def points(value: object) -> tuple[tuple[float, float, float], ...]:
    """Check a list of points; a single one may stand without the outer brackets."""
    if not isinstance(value, list) or not value:
        msg = f"{value!r} was given; a list of points [R, A, S] (mm) is needed"
        raise ValueError(msg)
    return tuple(point(each) for each in (value if isinstance(value[0], list) else [value]))


def path(value: object) -> str:
    """Check the name of a file."""
    if not isinstance(value, str) or not value:
        msg = f"{value!r} was given; the name of a file is needed"
        raise ValueError(msg)
    return value


def label(value: object) -> str:
    """Check the value or name of a label."""
    if isinstance(value, bool) or not isinstance(value, (str, int)) or value == "":
        msg = f"{value!r} was given; the value or the name of a label is needed"
        raise ValueError(msg)
    return str(value)


def paths(value: object) -> list[str]:
    """Check a list of paths."""
    if not isinstance(value, list):
        msg = f"{value!r} was given; a list of files or folders is needed"
        raise ValueError(msg)
    return [path(each) for each in value]


def motion(value: str) -> tuple[float, float]:
    """Check a motion: mm and degrees, not negative."""
    found = [_number(part) for part in value.split(",")]
    if len(found) != 2 or None in found or min(found) < 0.0:
        msg = f"{value!r} was given; two numbers from 0 are needed, mm and degrees, such as 3,2"
        raise ValueError(msg)
    return found[0], found[1]


def number(value: str) -> float:
    """Check that a text is a number; its range is checked elsewhere."""
    try:
        return float(value)
    except ValueError as error:
        msg = f"{value!r} was given; a number is needed"
        raise ValueError(msg) from error


def whole(needed: str, most: float = math.inf) -> Callable[[str], int]:
    """Make a check of a whole number from 1 to `most`; `needed` says what is needed."""

    def check(value: str) -> int:
        if not value.isascii() or not value.isdecimal() or not 1 <= int(value) <= most:
            msg = f"{value!r} was given; {needed}"
            raise ValueError(msg)
        return int(value)

    return check


def length(value: str) -> float:
    """Check a length, mm."""
    found = _number(value)
    if found is None or found <= 0.0:
        msg = f"{value!r} was given; a positive length in mm is needed"
        raise ValueError(msg)
    return found


def _number(value: object) -> float | None:
    """Read a finite number; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        return None
    try:
        found = float(value)
    except (ValueError, OverflowError):
        return None
    return found if math.isfinite(found) else None
