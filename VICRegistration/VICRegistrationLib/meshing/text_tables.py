"""Numbers and names as text: rows of tables, and names for formats that know ASCII only."""

from __future__ import annotations

import io
import re
import unicodedata
from collections.abc import Iterable

import numpy as np


def rows_text(table: np.ndarray, layout: str, *, delimiter: str = " ") -> str:
    """Rows of a table, a line each.

    Parameters
    ----------
    table : (n, m) ndarray
    layout : str
        Of a number, such as "%d"; or of a whole row.
    delimiter : str

    Returns
    -------
    str
        With a line end after every row.
    """
    text = io.StringIO()
    np.savetxt(text, table, fmt=layout, delimiter=delimiter)
    return text.getvalue()


def lists_text(numbers: np.ndarray, per_line: int, *, delimiter: str = ", ") -> str:
    """Numbers, so many in a line."""
    words = [str(number) for number in numbers.tolist()]
    lines = [delimiter.join(words[start : start + per_line]) for start in range(0, len(words), per_line)]
    return "".join(f"{line}\n" for line in lines)


def ascii_names(names: Iterable[str], *, longest: int = 60) -> dict[str, str]:
    """Different names of letters, digits and underscores that begin with a letter.

    Parameters
    ----------
    names : iterable of str
    longest : int
        Length of the longest one.

    Returns
    -------
    dict of str to str
        The new name of each; two of them differ by more than upper and lower case.
    """
    found: dict[str, str] = {}
    for name in names:
        plain = unicodedata.normalize("NFKD", name.replace("ß", "ss")).encode("ascii", "ignore").decode("ascii")
        plain = re.sub(r"\W+", "_", plain).strip("_")
        plain = (plain if plain[:1].isalpha() else f"organ_{plain}".rstrip("_"))[:longest]
        taken, number, tried = {value.lower() for value in found.values()}, 1, plain
        while tried.lower() in taken:
            number += 1
            tried = f"{plain}_{number}"
        found[name] = tried
    return found


def one_line_names(names: Iterable[str], *, longest: int = 100) -> list[str]:
    """Different names in one line each, without quotation marks.

    Parameters
    ----------
    names : iterable of str
    longest : int
        Length of the longest one: gmsh reads names of up to 127 letters.

    Returns
    -------
    list of str
    """
    found: list[str] = []
    for name in names:
        plain = " ".join(name.replace('"', "'").split())[:longest]
        number, tried = 1, plain
        while tried in found:
            number += 1
            tried = f"{plain} {number}"
        found.append(tried)
    return found
