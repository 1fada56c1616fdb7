"""What the commands have in common: words that are checked, tables, and lines of progress."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Sequence

from .process import flush_or_drop


def argument(check: Callable) -> Callable:
    """Make a check of values an argument's type: its sentence becomes argparse's complaint.

    Parameters
    ----------
    check : callable
        Takes the word and returns the value, or raises ValueError.

    Returns
    -------
    callable
    """

    def convert(text: str):
        try:
            return check(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return convert


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Put a table into columns of even width, the first to the left and the others to the right.

    Parameters
    ----------
    rows : sequence of sequence of str
        Of equal length.

    Returns
    -------
    str
        A line for each row.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    return "\n".join(
        "   ".join([row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:]))])
        for row in rows
    )


def line_printer(quiet: bool = False) -> Callable[[str], None]:
    """Make a function that prints a line for the user on stderr, or nothing if it is to be quiet.

    Parameters
    ----------
    quiet : bool

    Returns
    -------
    callable
        Takes a line.
    """

    def say(line: str) -> None:
        if not line or quiet:
            return
        # The work goes on where nobody reads about it any more.
        with contextlib.suppress(BrokenPipeError):
            print(line, file=sys.stderr)
        flush_or_drop(sys.stderr)

    return say
