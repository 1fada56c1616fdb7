"""Words of the command line."""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from collections.abc import Callable, Sequence

from .. import __version__
from ..file_names import folder_name, organ_name
from ..registration.option_row import Option
from ..registration.options import OPTIONS, FitOptions
from . import (
    PROGRAM,
    commands,
    compare_command,
    export_command,
    gaps_command,
    mesh_command,
    model_command,
    references,
    validators,
)
from .console import argument

# Flags of the options of a fit.
_FLAGS = {name: "--" + name.replace("_", "-") for name in OPTIONS}
# Their values may begin with a minus sign, which argparse takes for an option unless it is one number; those
# that must not are to be refused with their own sentence.
_NUMERIC = (
    *("--seed", "--boundary", "--size", "--wall", "--time-limit", "--volume-error", "--label", "--frame", "--points"),
    *_FLAGS.values(),
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

Exit status: 0; 2 if something is wrong (one line on stderr says what, and nothing is written); 3 if --keep-going left
organs out, --strict found a poor one, or model check found something; 130 after Ctrl-C and 143 after SIGTERM (nothing
is written).
"""

_FIT_EPILOG = """\
Coordinates are RAS mm, as Slicer shows them (right, anterior and superior are positive).

DIR gets, for every organ NAME:
  NAME.vtp              triangles (LPS mm, Slicer opens them in place); control net, knots and degrees in field data
  NAME.stl              triangles (LPS mm)
  NAME.json             the B-spline surface (RAS mm)
  NAME_convergence.csv  cost and largest displacement of every iteration
  NAME.png              slices in three planes with the contour, 3D view, convergence
  NAME.step             with --step: the exact solid (LPS mm), unless the surface is no valid one
and, for all organs together:
  report.html           everything on one page for people: warnings, results, pictures, convergence, inputs, deviation
                        from a reference; one file without script or addresses, PDF by the browser's print
  report.json           the numbers, for programs
  overview.png          with several organs
  organs.step           with several organs and --step: their assembly
DIR belongs to one image: organs are added to it or replaced in it, and report.json, report.html, overview.png and
organs.step are about all of them. Older pictures and solids of the same organs are removed if none are made now. Files
that are no results are never touched.

Several organs are described in a JSON file. Its keys are the words of the flags:
  {"schema": "vic-registration/organs", "version": 1,
   "organs": [
     {"organ": "bladder", "seed": [[1.5, 42, 10], [3, 40, 22]], "threshold": [600, 1500]},
     {"organ": "rectum", "seed": [[0, -31, 2]], "erosion": 2, "dilation": 2, "net": "11x9", "closure": "smooth",
      "solver": "gauss-newton", "tau": 1.5, "smoothness": 2e-4, "boundary": [[12.5, -30, 4]]}]}
organ and seed, or organ and region, are needed. "also": ["ax.nii.gz", "cor_folder"] beside "organs" is as --also.
Flags beside --config hold for the organs that do not say otherwise.

examples:
  vic-registration fit scan.nii.gz --organ bladder --seed -3,42,10
  vic-registration fit dicom_folder --organ bladder --seed -3,42,10 --threshold 600,1500 --erosion 2 --output bladder
  vic-registration fit scan.nii.gz --config organs.json --output organs
  vic-registration fit scan.nii.gz --organ bladder --region labels.nii.gz --label 3
  vic-registration fit sag.nii.gz --also ax.nii.gz --also cor_folder --organ bladder --seed -3,42,10
  vic-registration fit scan.nii.gz --config organs.json --reference labels.nii.gz --label bladder=3 --label rectum=5
"""


class _Parser(argparse.ArgumentParser):
    """Parser whose complaints are one line."""

    def error(self, message: str) -> None:
        """Print the complaint and leave with code 2."""
        line = " ".join(message.split()).rstrip(".")
        line = line.replace("the following arguments are required: ", "this is missing: ")
        for action in self._actions:
            if action.choices and line == f"this is missing: {action.metavar}":
                line += f", one of {', '.join(action.choices)}"
        self.exit(2, f"{PROGRAM}: error: {line}; see {self.prog} --help.\n")

    def refuse_unknown(self, word: str) -> None:
        """Print the usage of this command, and what it does not know."""
        self.print_usage(sys.stderr)
        if not word.startswith("-"):
            self.error(f"{word} is one argument too many")
        flag = word.partition("=")[0]
        close = difflib.get_close_matches(flag, self._option_string_actions, n=1)
        self.error(f"{self.prog.split()[-1]} has no flag {flag}" + (f" (similar: {close[0]})" if close else ""))


class _Once(argparse.Action):
    """A name that counts once: a second one would be taken in its place, and the first forgotten."""

    def __call__(self, parser, namespace, values, option_string=None):
        before = getattr(namespace, self.dest)
        if before is not None:
            parser.error(
                f"{option_string} was given twice, {before} and {values}; give several organs by --config FILE"
            )
        setattr(namespace, self.dest, values)


def parsed_arguments(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the words of a command.

    Parameters
    ----------
    arguments : sequence of str
        Without the program's name.

    Returns
    -------
    argparse.Namespace
        With the command's function as ``run``.

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
    _add_fit(subparsers)
    phantom = _add_command(
        subparsers, "phantom", "write a synthetic pelvic MRI with its true surfaces", commands.phantom
    )
    phantom.add_argument(
        "folder",
        metavar="DIR",
        type=argument(folder_name),
        help="folder for mri.nii.gz, organs.json and truth/NAME.json",
    )
    phantom.add_argument(
        "--stacks",
        metavar="N",
        type=int,
        choices=(1, 2, 3),
        default=1,
        help="how many directions: sagittal, axial, coronal (default: 1); organs.json names the others under also",
    )
    phantom.add_argument(
        "--motion",
        metavar="MM,DEG",
        type=argument(validators.motion),
        default=(0.0, 0.0),
        help="how far the patient moves before each further stack; truth/motion.json has the matrices (default: 0,0)",
    )
    reproduce = _add_command(
        subparsers, "reproduce", "repeat the paper's section 2.3 and figures 5 and 6", commands.reproduce
    )
    reproduce.add_argument(
        "folder",
        metavar="DIR",
        type=argument(folder_name),
        help="folder for a table and plots beside the paper's values",
    )
    export_command.add_parser(subparsers, _add_command)
    compare_command.add_parser(subparsers, _add_command)
    gaps_command.add_parser(subparsers, _add_command)
    mesh_command.add_parser(subparsers, _add_command)
    model_command.add_parser(subparsers, _add_command)
    options, unknown = parser.parse_known_args(_joined(arguments))
    if unknown:
        options.parser.refuse_unknown(unknown[0])
    return options


def _add_command(subparsers, name: str, summary: str, run: Callable, **kwargs) -> argparse.ArgumentParser:
    parser = subparsers.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        **kwargs,
    )
    parser.set_defaults(run=run, parser=parser)
    return parser


def _add_fit(subparsers) -> None:
    fit = _add_command(subparsers, "fit", "fit organs in an image", commands.fit, epilog=_FIT_EPILOG)
    fit.add_argument(
        "image",
        metavar="IMAGE",
        help="file (NIfTI, NRRD, MetaImage, DICOM, ...), or a folder of DICOM slices",
    )
    fit.add_argument(
        "--also",
        metavar="IMAGE",
        action="append",
        help="another stack of the patient, file or folder: the surface is fitted to all of them; may be repeated; "
        "FOLDER@SERIES or FILE@N chooses one of several, as --series and --frame do for IMAGE",
    )
    which = fit.add_argument_group("which organs")
    which.add_argument(
        "--organ",
        metavar="NAME",
        type=argument(organ_name),
        action=_Once,
        help="name of the organ and of its files",
    )
    which.add_argument(
        "--seed",
        metavar="R,A,S",
        type=argument(validators.point),
        action="append",
        help="point in the organ, mm; may be repeated",
    )
    which.add_argument(
        "--boundary",
        metavar="R,A,S",
        type=argument(validators.point),
        action="append",
        help="point where the organ's wall is known to be, mm; pulls the surface; may be repeated",
    )
    which.add_argument(
        "--region",
        metavar="FILE",
        help="label image that holds the organ, on any grid, in place of seeds; --label says which of its labels",
    )
    which.add_argument("--config", metavar="FILE", help="JSON file with several organs, instead of --organ and --seed")
    how = fit.add_argument_group("how (the defaults need no tuning)")
    for name, option in OPTIONS.items():
        text = f"{option.help[0].lower()}{option.help[1:]} (default: {_default(name, option)})"
        how.add_argument(_FLAGS[name], metavar=option.metavar, type=argument(option.read), help=text.replace("%", "%%"))
    how.add_argument(
        "--series", metavar="UID", help="which DICOM series of the folder: its UID, its description or its number"
    )
    how.add_argument(
        "--frame",
        metavar="N",
        type=argument(validators.frame),
        help="which volume of an image with several (time points, echoes, phases), from 1",
    )
    _add_fit_outputs(fit)


def _add_fit_outputs(fit: argparse.ArgumentParser) -> None:
    beside = fit.add_argument_group("a reference for the pictures and report.html, as of compare")
    beside.add_argument(
        "--reference", metavar="FILE", help="label image, mesh, surface, or a folder of them: shown beside the fit"
    )
    references.add_words(beside, frame="--reference-frame")
    what = fit.add_argument_group("what comes out")
    what.add_argument(
        "--output",
        metavar="DIR",
        type=argument(folder_name),
        default="organs",
        help="folder for the results (default: organs)",
    )
    what.add_argument(
        "--keep-going",
        action="store_true",
        help="fit the other organs if one cannot be fitted; exit status 3 then",
    )
    what.add_argument("--strict", action="store_true", help="exit status 3 if the verdict of an organ is poor")
    what.add_argument("--step", action="store_true", help="exact B-spline solids for CAD and simulation too")
    what.add_argument("--no-pictures", action="store_true", help="leave the pictures out; they need matplotlib")
    what.add_argument("--quiet", action="store_true", help="no progress on stderr, only warnings")


def option_table() -> str:
    """Make the table of options in docs/command-line.md.

    Returns
    -------
    str
        Markdown, a row for each option of a fit.
    """
    rows = ["| flag | meaning | values | default |", "|---|---|---|---|"]
    for name, option in OPTIONS.items():
        values = "; ".join(f"`{word}`: {text}" for word, text in option.choices.items()) or option.needed
        flag = f"{_FLAGS[name]} {option.metavar}".replace("|", "\\|")
        rows.append(f"| `{flag}` | {option.help} | {values} | {_default(name, option)} |")
    return "\n".join(rows)


def _default(name: str, option: Option) -> str:
    """Say what is taken where an option is not given."""
    default = getattr(FitOptions, name)
    return option.automatic if default is None else f"{default} {option.unit}".rstrip()


def _joined(arguments: Sequence[str]) -> list[str]:
    """Write ``--seed -3,10,5`` as ``--seed=-3,10,5``."""
    joined: list[str] = []
    for word in arguments:
        if joined and joined[-1] in _NUMERIC and re.match(r"-(?:[\d.,]|inf|nan)", word, re.IGNORECASE):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined
