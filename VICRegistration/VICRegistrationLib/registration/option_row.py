"""A row of the table of options: label, help text and allowed values of one option of a fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real


@dataclass(frozen=True)
class Option:
    """Description of an option, whose value is a word out of `choices`, or one or two numbers.

    Parameters
    ----------
    label : str
        Its name in the panel and in messages.
    help : str
        What it does, without a full stop.
    automatic : str
        What None means; empty if None is not allowed.
    limits : (low, high)
        Smallest and largest number allowed.
    unit : str
    whole : bool
        Whether only whole numbers are allowed.
    or_zero : bool
        Whether zero is allowed although it lies below the limits.
    pair : str
        How two numbers are written, such as "LOW,HIGH"; empty for one number.
    ascending : bool
        Whether the second of two numbers must not be less than the first.
    choices : mapping of str to str
        The allowed words, with their labels in the panel.
    known : callable
        Returns a mapping whose keys are allowed words as well. It is called when a value is checked, so that words may
        be added later.
    """

    label: str
    help: str
    automatic: str = ""
    limits: tuple[float, float] = (-math.inf, math.inf)
    unit: str = ""
    whole: bool = False
    or_zero: bool = False
    pair: str = ""
    ascending: bool = False
    choices: Mapping[str, str] = field(default_factory=dict)
    known: Callable[[], Mapping[str, object]] = dict

    def checked(self, value: object) -> object:
        """Check a value, and convert it to the option's type.

        Parameters
        ----------
        value : object

        Returns
        -------
        str, float, int, tuple of two numbers, or None

        Raises
        ------
        ValueError
            If the value is not allowed. The message is the same wherever the value was given.
        """
        if value is None and self.automatic:
            return None
        try:
            return self._converted(value)
        except (OverflowError, TypeError, ValueError):
            raise ValueError(self.refusal(repr(value) if isinstance(value, str) else str(value))) from None

    def read(self, written: object) -> object:
        """Read and check a value from the command line or from a configuration file.

        Parameters
        ----------
        written : object
            A text, or a value read from JSON.

        Returns
        -------
        str, float, int, or tuple of two numbers

        Raises
        ------
        ValueError
            As :meth:`checked`.
        """
        if written is None:
            raise ValueError(self.refusal("None"))
        if not isinstance(written, str) or self.choices:
            return self.checked(written)
        try:
            parts = written.lower().replace("×", "x").split(self._separator) if self.pair else [written]
            numbers = [float(part) for part in parts]
        except ValueError:
            return self.checked(written)
        try:
            return self._converted(numbers if self.pair else numbers[0])
        except (OverflowError, TypeError, ValueError):
            raise ValueError(self.refusal(written)) from None

    def refusal(self, given: str) -> str:
        """Return the message that a value, given as text, is not allowed."""
        return f"The {self.label} is {given}; it must be {self.needed}."

    def nearest(self, value: float | tuple[float, float]) -> float | tuple[float, float]:
        """Clip a number, or both numbers of a pair, to the limits."""
        if self.pair:
            return tuple(replace(self, pair="").nearest(number) for number in value)
        nearest = min(max(value, self.limits[0]), self.limits[1])
        return int(nearest) if self.whole else float(nearest)

    @property
    def metavar(self) -> str:
        """How a value is written on the command line."""
        return "|".join(self.choices) or self.pair or self.unit.upper() or ("N" if self.whole else "VALUE")

    @property
    def needed(self) -> str:
        """Allowed values in words, to follow "it must be"."""
        if self.choices:
            return f"one of {', '.join({**self.choices, **self.known()})}"
        kind = "whole number" if self.whole else "number"
        kind = f"two {kind}s {self.pair}" if self.pair else f"a {kind}"
        unit = f" {self.unit}" if self.unit else ""
        order = ", the lowest first" if self.ascending else ""
        zero = "0, or " if self.or_zero else ""
        return f"{zero}{kind} from {self.limits[0]:.7g} to {self.limits[1]:.7g}{unit}{order}"

    @property
    def _separator(self) -> str:
        """Character between the two numbers of a pair."""
        return "x" if "x" in self.pair else ","

    def _converted(self, value: object) -> object:
        """Return a value in the option's type, or raise an error if it is not allowed."""
        if self.choices:
            if value not in self.choices and value not in self.known():
                raise ValueError
            return value
        if not self.pair:
            return self._number(value)
        first, second = (self._number(part) for part in value)
        if self.ascending and first > second:
            raise ValueError
        return first, second

    def _number(self, value: object) -> float:
        """Return a number, or raise an error if it is not allowed."""
        number = int(value) if self.whole else float(value)
        within = self.limits[0] <= number <= self.limits[1] or (self.or_zero and number == 0.0)
        if isinstance(value, bool) or not isinstance(value, Real) or number != value or not within:
            raise ValueError
        return number
