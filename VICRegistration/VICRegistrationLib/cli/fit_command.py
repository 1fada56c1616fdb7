"""``vic-registration fit``: organs of an image."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

from ..file_names import folder_name, organ_name
from ..registration.option_row import Option
from ..registration.options import OPTIONS, FitOptions
from ..registration.verdict import POOR
from . import SOME_FAILED, references, validators
from .configuration import OrganRequest, files_of, organ_request, read_requests
from .console import LOG, add_command, argument
from .fitting import fit_to_folder
from .references import OrganReference, chosen_labels, read_references, reference_paths

# Flags of the options of a fit.
FLAGS = {name: "--" + name.replace("_", "-") for name in OPTIONS}
_FRAMES = "the number of a volume is 1 or more"

_EPILOG = """\
Coordinates are RAS mm, as Slicer shows them (right, anterior and superior are positive).

DIR gets, for every organ NAME:
  NAME.vtp              triangles (LPS mm, Slicer opens them in place); control net, knots and degrees in field data
  NAME.stl              triangles (LPS mm)
  NAME.json             the B-spline surface (RAS mm)
  NAME_convergence.csv  cost and largest displacement of every iteration
  NAME.png              slices in three planes with the contour, 3D view, convergence
  NAME.step             with --step: the exact solid (LPS mm), unless the surface is no valid one
and, for all organs together:
  report.html           all results on one page to read: warnings, pictures, convergence, inputs, deviation from a
                        reference; one file that opens offline in any browser
  report.json           the figures, for programs
  overview.png          with several organs
  organs.step           with several organs and --step: their assembly
DIR belongs to one image: organs are added to it or replaced in it, and report.json, report.html, overview.png and
organs.step have all of them. Older pictures and solids of the same organs are removed if they are not written again.
Other files are never touched.

Several organs are described in a JSON file, whose keys have the names of the flags:
  {"schema": "vic-registration/organs", "version": 1,
   "organs": [
     {"organ": "bladder", "seed": [[1.5, 42, 10], [3, 40, 22]], "threshold": [600, 1500]},
     {"organ": "rectum", "seed": [[0, -31, 2]], "erosion": 2, "dilation": 2, "net": "11x9", "closure": "smooth",
      "solver": "gauss-newton", "tau": 1.5, "smoothness": 2e-4, "boundary": [[12.5, -30, 4]]}]}
organ and seed, or organ and region, are needed. "also": ["ax.nii.gz", "cor_folder"] beside "organs" is like --also.
Flags beside --config apply to all organs that have no such key.

examples:
  vic-registration fit scan.nii.gz --organ bladder --seed -3,42,10
  vic-registration fit dicom_folder --organ bladder --seed -3,42,10 --threshold 600,1500 --erosion 2 --output bladder
  vic-registration fit scan.nii.gz --config organs.json --output organs
  vic-registration fit scan.nii.gz --organ bladder --region labels.nii.gz --label 3
  vic-registration fit sag.nii.gz --also ax.nii.gz --also cor_folder --organ bladder --seed -3,42,10
  vic-registration fit scan.nii.gz --config organs.json --reference labels.nii.gz --label bladder=3 --label rectum=5
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    fit = add_command(subparsers, "fit", "fit organs in an image", run, epilog=_EPILOG)
    add_image(fit, frames=f"{_FRAMES} (the frame of a mesh is --reference-frame)")
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
        help="point inside the organ, RAS mm; may be repeated",
    )
    which.add_argument(
        "--boundary",
        metavar="R,A,S",
        type=argument(validators.point),
        action="append",
        help="point on the organ's wall, RAS mm, that the surface is to pass through; may be repeated",
    )
    which.add_argument(
        "--region",
        metavar="FILE",
        help="label image of the organ, on any grid, in place of seeds; --label chooses one of its labels",
    )
    which.add_argument("--config", metavar="FILE", help="JSON file with several organs, instead of --organ and --seed")
    how = fit.add_argument_group("how to fit (the defaults suit most organs)")
    for name, option in OPTIONS.items():
        text = f"{option.help[0].lower()}{option.help[1:]} (default: {_default(name, option)})"
        how.add_argument(FLAGS[name], metavar=option.metavar, type=argument(option.read), help=text.replace("%", "%%"))
    beside = fit.add_argument_group("a reference for the pictures and report.html, as for compare")
    beside.add_argument(
        "--reference", metavar="FILE", help="label image, mesh, surface, or a folder of them: shown beside the fit"
    )
    references.add_words(beside, frame="--reference-frame")
    what = fit.add_argument_group("results")
    add_output(what, "organs")
    what.add_argument(
        "--keep-going",
        action="store_true",
        help="if an organ cannot be fitted, fit the others; exit status 3 then",
    )
    what.add_argument("--strict", action="store_true", help="exit status 3 if the verdict of an organ is poor")
    what.add_argument("--step", action="store_true", help="also write exact B-spline solids for CAD and simulation")


def add_image(parser: argparse.ArgumentParser, *, frames: str = _FRAMES) -> None:
    """Add the arguments for the image and further stacks; `frames` says what the number of a volume may be."""
    parser.add_argument(
        "image", metavar="IMAGE", help="file (NIfTI, NRRD, MetaImage, DICOM, ...), or a folder of DICOM slices"
    )
    parser.add_argument(
        "--also",
        metavar="IMAGE",
        action="append",
        help="another stack of the patient, file or folder; the surface is fitted to all stacks; may be repeated; "
        "FOLDER@SERIES or FILE@N chooses one of several, as --series and --frame do for IMAGE",
    )
    parser.add_argument(
        "--series",
        metavar="UID",
        help="one DICOM series of the folder, if there are several: its UID, description or number",
    )
    parser.add_argument(
        "--frame",
        metavar="N",
        type=argument(validators.whole(frames)),
        help="one volume of an image that has several (time points, echoes, phases), from 1",
    )


def add_output(group: argparse._ActionsContainer, folder: str) -> None:
    """Add the arguments for the results; `folder` is the default name of their folder."""
    group.add_argument(
        "--output",
        metavar="DIR",
        type=argument(folder_name),
        default=folder,
        help=f"folder for the results (default: {folder})",
    )
    group.add_argument(
        "--no-pictures", action="store_true", help="no pictures and no report.html, which need matplotlib and Jinja2"
    )
    group.add_argument("--quiet", action="store_true", help="no progress on stderr, only warnings")


class _Once(argparse.Action):
    """An argument that may be given once; argparse would replace the first value by the second."""

    def __call__(self, parser, namespace, values, option_string=None):
        before = getattr(namespace, self.dest)
        if before is not None:
            parser.error(
                f"{option_string} was given twice, {before} and {values}; give several organs by --config FILE"
            )
        setattr(namespace, self.dest, values)


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
        flag = f"{FLAGS[name]} {option.metavar}".replace("|", "\\|")
        rows.append(f"| `{flag}` | {option.help} | {values} | {_default(name, option)} |")
    return "\n".join(rows)


def _default(name: str, option: Option) -> str:
    """Text for the default of an option."""
    default = getattr(FitOptions, name)
    return option.automatic if default is None else f"{default} {option.unit}".rstrip()


def run(options: argparse.Namespace) -> int:
    """Fit organs in an image and write everything about them into a folder.

    Parameters
    ----------
    options : argparse.Namespace

    Returns
    -------
    int
        0, or 3 if ``--keep-going`` was given and some organs could not be fitted, or ``--strict`` and one is poor.

    Raises
    ------
    ValueError, OSError, RuntimeError
        With a message for the user.
    """
    requests = _requests(options)
    references = _references(options, [request.name for request in requests])
    read = [*(reference.path for reference in references.values()), *files_of(requests)]
    found = fit_to_folder(
        options.image,
        requests,
        options.output,
        series=options.series,
        frame=options.frame,
        inputs=read if options.config is None else [options.config, *read],
        references=references,
        pictures=not options.no_pictures,
        step=options.step,
        keep_going=options.keep_going,
    )
    poor = [organ.name for organ in found.organs if organ.verdict.word == POOR] if options.strict else []
    if poor:
        LOG.warning(f"the verdict is poor: {', '.join(poor)}")
    if found.failed:
        count = len(found.failed) + len(found.organs)
        LOG.warning(f"{len(found.failed)} of {count} organs could not be fitted: {', '.join(found.failed)}")
    return SOME_FAILED if poor or found.failed else 0


def _references(options: argparse.Namespace, names: Sequence[str]) -> dict[str, OrganReference]:
    """Read the references of the organs before the fit, so that errors are found early."""
    if options.reference is None:
        flags = {"label": "--label", "largest": "--largest", "mesh_frame": "--reference-frame"}
        if options.region is not None:
            del flags["label"]
        own = [flag for word, flag in flags.items() if getattr(options, word)]
        if own:
            needed = "--reference or --region" if own[0] == "--label" else "--reference"
            msg = f"{own[0]} was given without {needed}, which it belongs to; give both, or leave {own[0]} out."
            raise ValueError(msg)
        return {}
    if options.no_pictures:
        msg = "--reference was given with --no-pictures, but only pictures and report.html show it; leave one out."
        raise ValueError(msg)
    return read_references(names, reference_paths(options.reference, names), options)


def _requests(options: argparse.Namespace) -> tuple[OrganRequest, ...]:
    """Make the requests that the flags describe."""
    chosen = {word: getattr(options, word) for word in OPTIONS}
    if options.config is not None:
        own = [word for word in ("organ", "seed", "threshold", "boundary") if getattr(options, word) is not None]
        if own:
            msg = (
                f"Both --config and --{own[0]} were given; leave --{own[0]} out, and write {own[0]!r} into the "
                "configuration for each organ."
            )
            raise ValueError(msg)
        requests = read_requests(options.config, defaults={**chosen, "region": options.region, "also": options.also})
        labels = chosen_labels(options.label, [request.name for request in requests]) if options.region else {}
        return tuple(replace(request, label=request.label or labels.get(request.name)) for request in requests)
    missing = [word for word in ("organ", "seed") if getattr(options, word) is None]
    if options.region is not None and "seed" in missing:
        missing.remove("seed")
    if missing:
        msg = (
            f"No --{missing[0]} was given; give --organ NAME and --seed R,A,S or --region FILE, or --config FILE for "
            "several organs."
        )
        raise ValueError(msg)
    label = chosen_labels(options.label, [options.organ]).get(options.organ) if options.region else None
    start = {"boundary": options.boundary, "region": options.region, "label": label, "also": options.also}
    return (organ_request(options.organ, options.seed or (), **start, **chosen),)
