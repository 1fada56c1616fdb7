"""``vic-registration compare``: deviation of fitted surfaces from segmentations, meshes or other surfaces."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from ..analysis.comparison import compare
from ..analysis.reference_files import ReadReference, read_reference
from ..export.mesh_reading import FRAMES, READABLE_MESHES
from ..export.step import Solid
from ..files import keep_inputs, replacing_folder
from . import values
from .comparison_files import CSV, JSON, ComparedOrgan, comparison_table, organ_files, write_numbers, write_organ
from .solids import file_name, read_solids
from .words import argument, speaker

_MOST_POINTS = 10_000_000
_TOLERANCES = (0.5, 1.0, 2.0)
# Endings of references in a folder, the first that there is.
_ENDINGS = (".json", *READABLE_MESHES, ".seg.nrrd", ".nrrd", ".nii.gz", ".nii", ".mha", ".mhd")

_EPILOG = f"""\
SURFACE is a file NAME.json or NAME.vtp of `vic-registration fit`. REFERENCE is
  a label image    that SimpleITK reads (NIfTI, NRRD, .seg.nrrd, ...); --label chooses the organ by value or name
  a mesh           {", ".join(READABLE_MESHES)}, closed; mm, in the frame that the file tells as Slicer does, else LPS
  a surface        NAME.json, or NAME.vtp with a control net
  a folder         with a file NAME.json, NAME.stl, NAME.nii.gz, ... for each organ
Of a label image with several labels, the segment that is named like the organ is taken without --label.

Distances are taken from points of the reference to the exact fitted surface, and from points of the fitted surface to
the reference. Signed ones are positive where the fitted surface lies outside of the reference.

DIR, best one of its own, gets
  NAME_deviation.vtp  triangles of the fitted surface with their distance from the reference as "Deviation" (mm); LPS
  NAME_deviation.png  the surface coloured by it, histogram and table
  {CSV}      the numbers, a line for each organ
  {JSON}     the same with points, tolerances and files

examples:
  vic-registration compare organs/bladder.json segmentation.seg.nrrd
  vic-registration compare organs/bladder.json label.nii.gz --label 3 --largest --output deviation
  vic-registration compare organs/*.vtp label.nii.gz --label bladder=3 --label rectum=5
  vic-registration compare organs/*.vtp truth/ --tolerance 0.3 --tolerance 1 --output deviation
"""


def add_parser(subparsers, add_command: Callable) -> None:
    """Add the words of the command.

    Parameters
    ----------
    subparsers
        Of argparse.
    add_command : callable
        Makes a parser from subparsers, name, summary and function.
    """
    summary = "measure how far surfaces are from a segmentation or a mesh"
    parser = add_command(subparsers, "compare", summary, run, epilog=_EPILOG)
    parser.add_argument("surfaces", metavar="SURFACE", nargs="+", help="surface file of fit: NAME.json or NAME.vtp")
    parser.add_argument("reference", metavar="REFERENCE", help="label image, mesh, surface, or a folder of them")
    which = parser.add_argument_group("which reference")
    which.add_argument(
        "--label",
        metavar="[ORGAN=]LABEL",
        action="append",
        default=[],
        help="value or name in a label image; may be repeated with ORGAN= (default: the only one)",
    )
    which.add_argument(
        "--largest",
        action="store_true",
        help="only the largest piece of a label or a mesh, its hollows filled",
    )
    which.add_argument("--frame", choices=FRAMES, help="of a mesh (default: what the file tells, else LPS)")
    how = parser.add_argument_group("how")
    how.add_argument(
        "--points",
        metavar="N",
        type=argument(_points),
        default=10_000,
        help="points of each surface, even over its area (default: 10000)",
    )
    how.add_argument(
        "--tolerance",
        metavar="MM",
        type=argument(_tolerance),
        action="append",
        help="of the surface Dice; may be repeated (default: 0.5, 1 and 2)",
    )
    what = parser.add_argument_group("what comes out, beside the table on stdout")
    what.add_argument("--output", metavar="DIR", type=argument(values.folder), help="folder for the results")
    what.add_argument("--no-pictures", action="store_true", help="leave the pictures out; they need matplotlib")


def run(options: argparse.Namespace) -> None:
    """Print the deviation of every surface, and write all about it if a folder was named.

    Parameters
    ----------
    options : argparse.Namespace

    Raises
    ------
    ValueError, OSError, RuntimeError
        With a sentence for the user.
    """
    solids = read_solids(options.surfaces)
    paths = _reference_paths(options.reference, solids)
    labels = _labels(options.label, [solid.name for solid in solids])
    if options.output is None:
        organs = _compared(solids, paths, labels, options)
    else:
        organs = _written(solids, paths, labels, options)
    print(comparison_table(organs))
    for organ in organs:
        for warning in organ.warnings:
            print(f"warning: {organ.name}: {warning}", file=sys.stderr)
    if options.output is not None:
        speaker()(f"results written to {options.output}")


def _written(solids, paths, labels, options: argparse.Namespace) -> list[ComparedOrgan]:
    """Compare, and write everything into the folder or nothing."""
    pictures = not options.no_pictures
    if pictures:
        from ..analysis.canvas import require_matplotlib

        require_matplotlib()
    names = [file_name(solid.name) for solid in solids]
    files = [file for name in names for file in organ_files(name, pictures=True)]
    inputs = [*options.surfaces, *paths.values()]
    keep_inputs([Path(options.output, file) for file in (*files, CSV, JSON)], inputs)
    outdated = () if pictures else [file for file in files if file.endswith(".png")]
    with replacing_folder(options.output, outdated=outdated) as drafts:
        # A folder that cannot be written to is found out before the work.
        organs = _compared(solids, paths, labels, options)
        for organ in organs:
            write_organ(organ, drafts, pictures=pictures)
        write_numbers(organs, drafts, points=options.points, pictures=pictures)
    return organs


def _compared(solids, paths, labels, options: argparse.Namespace) -> list[ComparedOrgan]:
    organs = []
    for solid in solids:
        read = read_reference(
            paths[solid.name],
            organ=solid.name,
            label=labels.get(solid.name),
            largest=options.largest,
            frame=options.frame,
        )
        organs.append(_organ(solid, read, paths[solid.name], options))
    return organs


def _organ(solid: Solid, read: ReadReference, path: Path, options: argparse.Namespace) -> ComparedOrgan:
    """Compare one organ; complaints about numbers name it."""
    tolerances = tuple(dict.fromkeys(options.tolerance or _TOLERANCES))
    try:
        found = compare(solid.surface, read.reference, n_points=options.points, tolerances=tolerances)
    except ValueError as error:
        msg = f"{solid.name} cannot be compared with {path}: {error}"
        raise ValueError(msg) from error
    return ComparedOrgan(solid.name, solid.surface, read, path, found)


def _reference_paths(reference: str, solids: Sequence[Solid]) -> dict[str, Path]:
    """File of the reference of each organ."""
    path = Path(reference)
    if not path.is_dir():
        return {solid.name: path for solid in solids}
    found = {}
    for solid in solids:
        wanted = {values.file_key(solid.name + ending): rank for rank, ending in enumerate(_ENDINGS)}
        files = {wanted[key]: file for file in path.iterdir() if (key := values.file_key(file.name)) in wanted}
        if not files:
            msg = (
                f"The folder {path} holds no reference for {solid.name}; give one that holds {solid.name}.json, "
                f"{solid.name}.stl or {solid.name}.nii.gz, or name the file itself."
            )
            raise ValueError(msg)
        found[solid.name] = files[min(files)]
    return found


def _labels(words: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Label of each organ out of words LABEL, for all of them, and ORGAN=LABEL."""
    common = [word for word in words if "=" not in word]
    if len(common) > 1:
        msg = f"--label was given {len(common)} times; say which is for which organ, as --label {names[0]}={common[0]}."
        raise ValueError(msg)
    chosen = {name: label for label in common for name in names}
    for word in words:
        name, own, label = word.rpartition("=")
        if own and name not in names:
            msg = f"--label {word} was given, but the organs are {', '.join(names)}; name one of them."
            raise ValueError(msg)
        if own:
            chosen[name] = label
    return chosen


def _points(text: str) -> int:
    """Check the number of points."""
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= _MOST_POINTS:
        msg = f"{text!r} was given; distances are taken at 1 to {_MOST_POINTS} points"
        raise ValueError(msg)
    return int(text)


def _tolerance(text: str) -> float:
    """Check a tolerance, mm."""
    try:
        return values.tau(text)
    except ValueError as error:
        msg = f"{text!r} was given; a tolerance is a positive length in mm"
        raise ValueError(msg) from error
