"""What the commands have in common: parsers, checked arguments, tables, and messages for the user."""

from __future__ import annotations

import argparse
import contextlib
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import TextIO

from .process import flush_or_drop

# Progress is logged at level INFO, which --quiet leaves out.
LOG = logging.getLogger("vic-registration")


def add_command(subparsers, name: str, summary: str, run: Callable | None, **choices) -> argparse.ArgumentParser:
    """Add the parser of a command.

    Parameters
    ----------
    subparsers : object
        As returned by `add_subparsers` of argparse.
    name, summary : str
    run : callable or None
        Called with the parsed arguments; None for a command that has commands of its own.
    **choices
        Arguments of the parser, such as ``epilog``.

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
    """Make a check of values an argument's type, whose error message argparse prints.

    Parameters
    ----------
    check : callable
        Takes the argument's text and returns the value, or raises ValueError.

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
    """Align the columns of a table, the first to the left and the others to the right.

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
    """Prints lines, and does not stop the program if the reader has closed the stream."""

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(BrokenPipeError):
            print(record.getMessage(), file=self.stream)
        flush_or_drop(self.stream)
