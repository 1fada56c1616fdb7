"""``vic-registration model``: models of several organs with ligaments, fasciae and a pelvic floor."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..files import keep_inputs
from ..multipatch.formats import SUFFIXES, check_suffix
from ..multipatch.library import DEFAULT, MODELS, find_model
from ..multipatch.model import MultiPatchModel
from . import SOME_FAILED, model_fitting
from .console import LOG, add_command, aligned

_NAMES = " or ".join(MODELS)
_EPILOG = f"""\
A model has organs, divided into named patches, and ligaments, fasciae and a pelvic floor that are attached to them. It
is a file (schema vic-registration/model), or one of the program: {_NAMES}.

examples:
  vic-registration model show --output pelvis.png
  vic-registration model show pelvis-fine --output pelvis.step
  vic-registration model check my_model.json
  vic-registration model fit scan.nii.gz --config organs.json --output pelvis
"""
_SHOW_EPILOG = f"""\
MODEL is a file, {_NAMES} (default: {DEFAULT}). Its parts and landmarks are listed.
The ending of FILE chooses what is written:
  .png           a picture from four sides: patches by colour, translucent where the image does not show them
  .step, .stp    exact faces with the names of the patches: organs and cords as solids, sheets as shells (LPS mm)
  .vtp           triangles with the names of their patch and part (LPS mm)
  .json          the model itself, to be changed or fitted (RAS mm)
Names of parts that the image does not show end in "(estimated)".

examples:
  vic-registration model show
  vic-registration model show my_model.json --output my_model.png
"""
_CHECK_EPILOG = """\
Errors are: parts that share no points with others, cords that are not closed, folded patches, organs that are no valid
solids or overlap, sheets and cords that pass through organs or one another, landmarks far from everything, and signs
of another unit or frame.
The exit status is 3 if there are errors, and 2 if the file has no model.

example:
  vic-registration model check my_model.json
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "model", "fit, show and check models of several organs", None, epilog=_EPILOG)
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    model_fitting.add_parser(actions)
    showing = add_command(actions, "show", "list, draw and export a model", show, epilog=_SHOW_EPILOG)
    showing.add_argument("model", metavar="MODEL", nargs="?", default=DEFAULT, help=f"file, {_NAMES}")
    showing.add_argument("--output", metavar="FILE", type=Path, help=f"file to write: {', '.join(SUFFIXES)}")
    checking = add_command(actions, "check", "look for errors in a model", check, epilog=_CHECK_EPILOG)
    checking.add_argument("model", metavar="MODEL", help=f"file, {_NAMES}")


def show(options: argparse.Namespace) -> None:
    """List the parts of a model, and write it if a file was given."""
    output = options.output
    if output is not None:
        check_suffix(output)
        keep_inputs([output], [options.model])
    model = find_model(options.model)
    print(parts_table(model))
    if model.landmarks:
        print(f"landmarks: {'; '.join(model.landmarks)}")
    if output is not None:
        model.save(output)
        LOG.info(f"written to {output}")


def check(options: argparse.Namespace) -> int:
    """Print the errors of a model.

    Parameters
    ----------
    options : argparse.Namespace

    Returns
    -------
    int
        0, or 3 if there are errors.

    Raises
    ------
    ValueError, OSError
        With a message for the user.
    """
    from ..multipatch.check import check_model

    model = find_model(options.model)
    found = check_model(model)
    for diagnostic in found:
        print(diagnostic.sentence())
    if not found:
        words = f"{len(model.parts)} parts, {len(model.patches)} patches, {len(model.points)} points"
        print(f"{options.model}: {words}; no errors found.")
    return SOME_FAILED if found else 0


def parts_table(model: MultiPatchModel) -> str:
    """List the parts of a model: kind, patches, points and volume or thickness.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    str
        A line for each.
    """
    rows = [("part", "kind", "patches", "points", "size")]
    for part in model.parts:
        patches = model.patches_of(part.name)
        points = len(model.indices_of(part.name))
        size = f"{part.thickness:g} mm thick" if part.thickness is not None else ""
        if part.name in model.parents:
            size = f"{model.parents[part.name].volume() / 1000.0:.1f} ml"
        rows.append((part.labelled(), part.kind, str(len(patches)), str(points), size))
    return aligned(rows)
