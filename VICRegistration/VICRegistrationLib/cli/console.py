"""What the commands have in common: words that are checked, tables, and lines for the user."""

from __future__ import annotations

import argparse
import contextlib
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import TextIO

from .process import flush_or_drop

# Progress is information, which --quiet leaves out; what has to be looked at is a warning.
LOG = logging.getLogger("vic-registration")


def add_command(subparsers, name: str, summary: str, run: Callable | None, **choices) -> argparse.ArgumentParser:
    """Add the parser of a command.

    Parameters
    ----------
    subparsers : object
        Of argparse.
    name, summary : str
    run : callable or None
        Gets what was parsed; None for a command with commands of its own.
    **choices
        Of the parser, such as ``epilog``.

    Returns
    -------
    argparse.ArgumentParser
    """
    parser = subparsers.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        **choices,
    )
    parser.set_defaults(run=run, parser=parser)
    return parser


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


@contextlib.contextmanager
def lines_to(stream: TextIO) -> Iterator[None]:
    """Print what is logged in the block, a line each.

    Parameters
    ----------
    stream : text file
        stdout or stderr.
    """
    lines = _Lines(stream)
    LOG.addHandler(lines)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(lines)


class _Lines(logging.StreamHandler):
    """Prints lines; the work goes on where nobody reads about it any more."""

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(BrokenPipeError):
            print(record.getMessage(), file=self.stream)
        flush_or_drop(self.stream)
