"""A row of the table of options: what an option of a fit is called, what it does, and which values it takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real


@dataclass(frozen=True)
class Option:
    """What is to be known of an option: a word out of `choices`, or one or two numbers.

    Parameters
    ----------
    label : str
        What it is called in the panel and in sentences.
    help : str
        What it does, without a full stop.
    automatic : str
        What is taken where it is None; empty for an option that always has a value.
    limits : (low, high)
        The least and the largest number.
    unit : str
    whole : bool
        Whether only whole numbers are meant.
    or_zero : bool
        Whether zero is allowed below the least number; it means none.
    pair : str
        How two numbers are written, such as "LOW,HIGH"; empty for one.
    ascending : bool
        Whether the second of two must not be less than the first.
    choices : mapping of str to str
        The words, and what they are called in the panel.
    known : callable
        Gives a mapping whose keys are words too, with those that are added to it; asked when a value is checked.
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
        """Check a value, and return it in its own type.

        Parameters
        ----------
        value : object

        Returns
        -------
        str, float, int, tuple of two numbers, or None

        Raises
        ------
        ValueError
            If it is no value of this option: the same sentence wherever it was given.
        """
        if value is None and self.automatic:
            return None
        try:
            return self._converted(value)
        except (OverflowError, TypeError, ValueError):
            raise ValueError(self.refusal(repr(value) if isinstance(value, str) else str(value))) from None

    def read(self, written: object) -> object:
        """Read a value as it is written on the command line or in a configuration, and check it.

        Parameters
        ----------
        written : object
            A text, or what JSON makes of a value.

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
        """Say that a value, in the words given, is none of this option."""
        return f"The {self.label} is {given}; it must be {self.needed}."

    def nearest(self, value: float | tuple[float, float]) -> float | tuple[float, float]:
        """Return the number within the limits that is nearest to one that is not zero, or both of two."""
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
        """What a value must be, in words that go on a sentence."""
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
        """What is between the two numbers of a pair."""
        return "x" if "x" in self.pair else ","

    def _converted(self, value: object) -> object:
        """Return a value in its own type; an error if it is none."""
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
        """Return a number within the limits; an error if it is none."""
        number = int(value) if self.whole else float(value)
        within = self.limits[0] <= number <= self.limits[1] or (self.or_zero and number == 0.0)
        if isinstance(value, bool) or not isinstance(value, Real) or number != value or not within:
            raise ValueError
        return number
