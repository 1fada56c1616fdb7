"""Values of flags and of configuration keys: the same words, the same checks."""

from __future__ import annotations

import math
import re

from ..geometry.parametrization import CLOSURES
from ..registration.cost import LOSSES
from ..registration.solvers import SOLVERS

# Beyond this the control points lie closer together than any image has voxels.
_LARGEST_NET = 65


def seed(value: object) -> tuple[float, float, float]:
    """Check a seed: R, A, S in mm."""
    return _numbers(value, 3, "a seed is three numbers R,A,S (mm)")


def seeds(value: object) -> tuple[tuple[float, float, float], ...]:
    """Check a list of seeds; a single one may stand without the outer brackets."""
    if not isinstance(value, list) or not value:
        msg = f"{value!r} was given; seeds are a list of points [R, A, S] (mm)"
        raise ValueError(msg)
    points = value if isinstance(value[0], list) else [value]
    return tuple(seed(point) for point in points)


def threshold(value: object) -> tuple[float, float]:
    """Check a threshold: the lowest and the highest grey level."""
    return _numbers(value, 2, "a threshold is two numbers LOW,HIGH")


def boundary(value: object) -> tuple[float, float, float]:
    """Check a boundary point: R, A, S in mm."""
    return _numbers(value, 3, "a boundary point is three numbers R,A,S (mm)")


def boundaries(value: object) -> tuple[tuple[float, float, float], ...]:
    """Check a list of boundary points; a single one may stand without the outer brackets."""
    if not isinstance(value, list) or not value:
        msg = f"{value!r} was given; boundary points are a list of points [R, A, S] (mm)"
        raise ValueError(msg)
    points = value if isinstance(value[0], list) else [value]
    return tuple(boundary(point) for point in points)


def number(value: str) -> float:
    """Check that a word is a number; whether it makes sense is for others to say."""
    try:
        return float(value)
    except ValueError as error:
        msg = f"{value!r} was given; a number is needed"
        raise ValueError(msg) from error


def frame(value: str) -> int:
    """Check the number of a volume, from 1."""
    if not value.isascii() or not value.isdecimal() or int(value) < 1:
        msg = f"{value!r} was given; the number of a volume is 1 or more (the frame of a mesh is --reference-frame)"
        raise ValueError(msg)
    return int(value)


def erosion(value: object) -> float:
    """Check the radius of the erosion, mm."""
    return _radius(value, "an erosion")


def dilation(value: object) -> float:
    """Check the radius of the dilation, mm."""
    return _radius(value, "a dilation")


def tau(value: object) -> float:
    """Check the width of the profile's ramp, mm."""
    number = _number(value)
    if number is None or number <= 0.0:
        msg = f"{value!r} was given; tau is a positive length in mm"
        raise ValueError(msg)
    return number


def smoothness(value: object) -> float:
    """Check the weight of the bending energy, dimensionless."""
    number = _number(value)
    if number is None or number < 0.0:
        msg = f"{value!r} was given; a smoothness is zero or a positive number such as 2e-4"
        raise ValueError(msg)
    return number


def net(value: object) -> tuple[int, int]:
    """Check the size of a control net, such as "9x7"."""
    match = re.fullmatch(r"(\d{1,6})[xX×](\d{1,6})", value) if isinstance(value, str) else None
    if match is None:
        msg = f"{value!r} was given; a net is ROWSxCOLUMNS such as 9x7"
        raise ValueError(msg)
    size = int(match[1]), int(match[2])
    if max(size) > _LARGEST_NET:
        msg = f"{value!r} was given; a net has at most {_LARGEST_NET} rows and columns"
        raise ValueError(msg)
    return size


def closure(value: object) -> str:
    """Check how the surface is closed."""
    return _choice(value, CLOSURES)


def loss(value: object) -> str:
    """Check the loss."""
    return _choice(value, LOSSES)


def solver(value: object) -> str:
    """Check the solver."""
    return _choice(value, SOLVERS)


def _choice(value: object, choices) -> str:
    if value not in tuple(choices):
        msg = f"{value!r} was given; choose one of {', '.join(choices)}"
        raise ValueError(msg)
    return value


def _radius(value: object, what: str) -> float:
    number = _number(value)
    if number is None or number < 0.0:
        msg = f"{value!r} was given; {what} is zero or a positive length in mm"
        raise ValueError(msg)
    return number


def _numbers(value: object, count: int, needed: str) -> tuple[float, ...]:
    """Numbers out of a list, or out of a text with commas."""
    parts = value.split(",") if isinstance(value, str) else value
    numbers = [_number(part) for part in parts] if isinstance(parts, list) else []
    if len(numbers) != count or None in numbers:
        msg = f"{value!r} was given; {needed}"
        raise ValueError(msg)
    return tuple(numbers)


def _number(value: object) -> float | None:
    """Read a finite number; None if it is none."""
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None
