"""What a type in a parameterNodeWrapper class can be annotated with, and FloatRange."""

from __future__ import annotations

from dataclasses import dataclass


class Default:
    """Annotation: the value a parameter has before it is set."""

    def __init__(self, value):
        self.value = value


class WithinRange:
    """Annotation: the smallest and the largest value; others are refused with a ValueError."""

    def __init__(self, minimum, maximum):
        self.minimum, self.maximum = minimum, maximum

    def validate(self, value):
        if not self.allows(value):
            msg = f"The value is {value}; {type(self).__name__}{self.minimum, self.maximum} is needed"
            raise ValueError(msg)

    def allows(self, value):
        return self.minimum <= value <= self.maximum


class RangeBounds(WithinRange):
    """Annotation: bounds for a FloatRange."""

    def allows(self, value):
        # Slicer's own condition lacks a pair of brackets; so a maximum above the bound passes.
        return self.minimum <= value.minimum or value.maximum > self.maximum


@dataclass(frozen=True)
class FloatRange:
    """Two numbers, the first not above the second. Slicer's can be changed in place too, which this module does not."""

    minimum: float = 0
    maximum: float = 0

    def __post_init__(self):
        for value in (self.minimum, self.maximum):
            if not isinstance(value, (int, float)):
                msg = f"The value must be a float, is of type {type(value)}: {value}"
                raise (ValueError if value is None else TypeError)(msg)
        if not self.minimum <= self.maximum:
            msg = f"FloatRange must have minimum <= maximum: {self.minimum} <= {self.maximum}"
            raise ValueError(msg)
