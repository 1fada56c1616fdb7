"""What the commands have in common: words that are checked, and lines of progress."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable


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


def speaker(quiet: bool = False) -> Callable[[str], None]:
    """Way of telling the user something on stderr, or of keeping it to oneself.

    Parameters
    ----------
    quiet : bool

    Returns
    -------
    callable
        Takes a line.
    """

    def say(line: str) -> None:
        if line and not quiet:
            print(line, file=sys.stderr, flush=True)

    return say
