"""Parser of the command line."""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from collections.abc import Sequence

from .. import __version__
from . import (
    PROGRAM,
    compare_command,
    export_command,
    fit_command,
    gaps_command,
    mesh_command,
    model_command,
    phantom_command,
    reproduce_command,
)

_COMMANDS = (
    fit_command,
    export_command,
    mesh_command,
    compare_command,
    gaps_command,
    model_command,
    phantom_command,
    reproduce_command,
)
# Flags whose values may begin with a minus sign, which argparse takes for an option unless it is a single number. Flags
# with values that must be positive are among them, so that a negative one is refused with their own message.
_NUMERIC = (
    *("--seed", "--boundary", "--size", "--wall", "--time-limit", "--volume-error", "--label", "--frame", "--points"),
    "--motion",
    *fit_command.FLAGS.values(),
)

_EPILOG = """\
examples:
  vic-registration phantom build/phantom
  vic-registration fit build/phantom/mri.nii.gz --config build/phantom/organs.json --output build/fit
  vic-registration fit scan.nrrd --organ bladder --seed -3,42,10 --seed 8,40,22 --threshold 600,1500
  vic-registration fit dicom_folder --organ rectum --seed 0,-31,2 --net 11x9 --output rectum --quiet
  vic-registration export build/fit/*.vtp --step organs.step
  vic-registration mesh build/fit/*.json --size 4 --output organs.msh
  vic-registration compare build/fit/*.vtp build/phantom/truth --output build/deviation
  vic-registration reproduce build/reproduce

Exit status: 0; 2 for an error (one line on stderr says what is wrong, and nothing is written); 3 if --keep-going left
organs out, --strict found a poor verdict, or model check found an error; 130 after Ctrl-C and 143 after SIGTERM
(nothing is written).
"""


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str) -> None:
        """Print the error and exit with code 2."""
        line = " ".join(message.split()).rstrip(".")
        line = line.replace("the following arguments are required: ", "this is missing: ")
        for action in self._actions:
            if action.choices and line == f"this is missing: {action.metavar}":
                line += f", one of {', '.join(action.choices)}"
        self.exit(2, f"{PROGRAM}: error: {line}; see {self.prog} --help.\n")

    def refuse_unknown(self, word: str) -> None:
        """Print the usage of this command, and an error about an unknown argument."""
        self.print_usage(sys.stderr)
        if not word.startswith("-"):
            self.error(f"{word} is one argument too many")
        flag = word.partition("=")[0]
        close = difflib.get_close_matches(flag, self._option_string_actions, n=1)
        self.error(f"{self.prog.split()[-1]} has no flag {flag}" + (f" (similar: {close[0]})" if close else ""))


def parsed_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of a command.

    Parameters
    ----------
    arguments : sequence of str
        Without the program's name.

    Returns
    -------
    argparse.Namespace
        Its ``run`` is the command's function.

    Raises
    ------
    SystemExit
        0 after ``--help`` and ``--version``, 2 for wrong usage.
    """
    parser = _Parser(
        prog=PROGRAM,
        description="Fits smooth B-spline surfaces to organs in medical images by virtual image correlation.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in _COMMANDS:
        command.add_parser(subparsers)
    options, unknown = parser.parse_known_args(_joined(arguments))
    if unknown:
        options.parser.refuse_unknown(unknown[0])
    return options


def _joined(arguments: Sequence[str]) -> list[str]:
    """Write ``--seed -3,10,5`` as ``--seed=-3,10,5``."""
    joined: list[str] = []
    for word in arguments:
        if joined and joined[-1] in _NUMERIC and re.match(r"-(?:[\d.,]|inf|nan)", word, re.IGNORECASE):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined
