"""Instances of a STEP file as ISO 10303-21 writes them: numbers, strings, references."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


class Entities:
    """Instances in the order in which they are added; each is written once and known by its number."""

    def __init__(self) -> None:
        self._instances: list[str] = []
        self._points: dict[tuple[float, ...], str] = {}

    def add(self, instance: str) -> str:
        """Add an instance, such as ``VERTEX_POINT('',#3)``; returns its reference, such as ``#4``."""
        self._instances.append(instance)
        return f"#{len(self._instances)}"

    def point(self, coordinates: Sequence[float]) -> str:
        """Add a point, or find the equal one that is there already; returns its reference."""
        key = tuple(float(number) for number in coordinates)
        if key not in self._points:
            self._points[key] = self.add(f"CARTESIAN_POINT('',{listed(real(number) for number in key)})")
        return self._points[key]

    def text(self) -> str:
        """All instances, one a line."""
        return "".join(f"#{number}={instance};\n" for number, instance in enumerate(self._instances, start=1))


def listed(items: Iterable[object]) -> str:
    """List of values or references that are written already."""
    return f"({','.join(str(item) for item in items)})"


def real(number: float) -> str:
    """Shortest decimal that brings the same double back, as Part 21 wants it: with a point and a capital E."""
    number = float(number)
    if not math.isfinite(number):
        msg = f"The number {number} cannot be written; give finite numbers."
        raise ValueError(msg)
    mantissa, _, exponent = repr(number).partition("e")
    mantissa = mantissa[:-1] if mantissa.endswith(".0") else mantissa
    mantissa += "" if "." in mantissa else "."
    return f"{mantissa}E{int(exponent)}" if exponent else mantissa


def string(text: str) -> str:
    """Quoted text; letters that are not printable ASCII are written with their code points in hexadecimal."""
    parts, run = [], []
    for letter in [*text, None]:
        plain = letter is not None and " " <= letter <= "~"
        if run and (letter is None or plain):
            parts.append(_encoded(run))
            run = []
        if plain:
            parts.append({"'": "''", "\\": "\\\\"}.get(letter, letter))
        elif letter is not None:
            run.append(letter)
    return f"'{''.join(parts)}'"


def _encoded(letters: Sequence[str]) -> str:
    r"""Write letters as ``\X2\...\X0\``, or as ``\X4\...\X0\`` where one of them needs more than 16 bits."""
    # Halves of a pair, which Python keeps for bytes that are no UTF-8, stand for no letter.
    codes = [0xFFFD if 0xD800 <= ord(letter) <= 0xDFFF else ord(letter) for letter in letters]
    width, control = (8, "X4") if max(codes) > 0xFFFF else (4, "X2")
    digits = "".join(f"{code:0{width}X}" for code in codes)
    return f"\\{control}\\{digits}\\X0\\"
