"""What a type in a parameterNodeWrapper class can be annotated with, and FloatRange."""

from __future__ import annotations


class Default:
    """Annotation: the value a parameter has before it is set; generator, if given, is called for each one."""

    def __init__(self, value=None, *, generator=None):
        self.given, self.generator = value, generator

    @property
    def value(self):
        return self.generator() if self.generator else self.given


class Validator:
    """Annotation: refuses values with a ValueError."""

    def __init__(self, *bounds):
        self.bounds = bounds

    def validate(self, value):
        if not self.allows(value):
            msg = f"The value is {value}; {type(self).__name__}{self.bounds} is needed"
            raise ValueError(msg)


class WithinRange(Validator):
    """Annotation: the smallest and the largest value."""

    def __init__(self, minimum, maximum):
        super().__init__(minimum, maximum)
        self.minimum, self.maximum = minimum, maximum

    def allows(self, value):
        return self.minimum <= value <= self.maximum


class RangeBounds(WithinRange):
    """Annotation: bounds for a FloatRange."""

    def allows(self, value):
        # Slicer's own condition lacks a pair of brackets; so a maximum above the bound passes.
        return self.minimum <= value.minimum or value.maximum > self.maximum


class FloatRange:
    """Two numbers, the first not above the second."""

    def __init__(self, minimum=0, maximum=0):
        self.setRange(minimum, maximum)

    def setRange(self, minimum, maximum):
        for value in (minimum, maximum):
            if not isinstance(value, (int, float)):
                msg = f"The value must be a float, is of type {type(value)}: {value}"
                raise (ValueError if value is None else TypeError)(msg)
        if not minimum <= maximum:
            msg = f"FloatRange must have minimum <= maximum: {minimum} <= {maximum}"
            raise ValueError(msg)
        # One end after the other, which gives two events as in Slicer.
        for name, value in (("_minimum", minimum), ("_maximum", maximum)):
            if self.__dict__.get(name) != value:
                setattr(self, name, value)
                self._save()

    minimum = property(lambda self: self._minimum, lambda self, value: self.setRange(value, self._maximum))
    maximum = property(lambda self: self._maximum, lambda self, value: self.setRange(self._minimum, value))

    def __eq__(self, other):
        return isinstance(other, FloatRange) and (self.minimum, self.maximum) == (other.minimum, other.maximum)

    __hash__ = None

    def __repr__(self):
        return f"FloatRange(minimum={self.minimum}, maximum={self.maximum})"

    def __setattr__(self, name, value):
        if name not in ("minimum", "maximum") and not name.startswith("_"):
            msg = f"'FloatRange' has no attribute '{name}'"
            raise AttributeError(msg)
        super().__setattr__(name, value)

    def _save(self):
        """A range read from a node writes itself back; one made by hand has nowhere to."""
