"""``vic-registration compare``: deviation of fitted surfaces from segmentations, meshes or other surfaces."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..export.mesh_reading import READABLE_MESHES
from ..file_names import folder_name
from ..files import keep_inputs, replacing_folder
from ..geometry.validity import check_surface
from ..report.contents import TOLERANCES, ComparedOrgan, compared_organ
from ..report.figure import require_packages
from . import references, validators
from .comparison_files import CSV, JSON, comparison_table, organ_files, organs_before, write_numbers, write_organ
from .console import LOG, add_command, argument
from .solids import file_name, read_solids

_MOST_POINTS = 10_000_000

_EPILOG = f"""\
SURFACE is a file NAME.json or NAME.vtp of `vic-registration fit`. REFERENCE is
  a label image    that SimpleITK reads (NIfTI, NRRD, .seg.nrrd, ...); --label chooses the organ by value or name
  a mesh           {", ".join(READABLE_MESHES)}, closed, in mm; frame as Slicer marks it in the file, else LPS
  a surface        NAME.json, or NAME.vtp with a control net
  a folder         with a file NAME.json, NAME.stl, NAME.nii.gz, ... for each organ
Without --label, a label image with several labels is searched for the segment with the name of the organ.

Distances are taken from points of the reference to the exact fitted surface, and from points of the fitted surface to
the reference. Signed ones are positive where the fitted surface lies outside of the reference.

DIR, which should be a folder of its own (an earlier comparison in it is replaced), gets
  NAME_deviation.vtp  triangles of the fitted surface with their distance from the reference as "Deviation" (mm); LPS
  NAME_deviation.png  the surface coloured by it, histogram and table
  {CSV}      the figures, a line for each organ
  {JSON}     the same with points, tolerances and files

examples:
  vic-registration compare organs/bladder.json segmentation.seg.nrrd
  vic-registration compare organs/bladder.json label.nii.gz --label 3 --largest --output deviation
  vic-registration compare organs/*.vtp label.nii.gz --label bladder=3 --label rectum=5
  vic-registration compare organs/*.vtp truth/ --tolerance 0.3 --tolerance 1 --output deviation
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    summary = "measure how far surfaces are from a segmentation or a mesh"
    parser = add_command(subparsers, "compare", summary, run, epilog=_EPILOG)
    parser.add_argument("surfaces", metavar="SURFACE", nargs="+", help="surface file of fit: NAME.json or NAME.vtp")
    parser.add_argument("reference", metavar="REFERENCE", help="label image, mesh, surface, or a folder of them")
    which = parser.add_argument_group("which reference")
    references.add_words(which)
    how = parser.add_argument_group("how to measure")
    how.add_argument(
        "--points",
        metavar="N",
        type=argument(validators.whole(f"distances are taken at 1 to {_MOST_POINTS} points", _MOST_POINTS)),
        default=10_000,
        help="number of points on each surface, spread evenly over its area (default: 10000)",
    )
    how.add_argument(
        "--tolerance",
        metavar="MM",
        type=argument(validators.length),
        action="append",
        help="tolerance of the surface Dice; may be repeated (default: 0.5, 1 and 2)",
    )
    what = parser.add_argument_group("results, besides the table on stdout")
    what.add_argument("--output", metavar="DIR", type=argument(folder_name), help="folder for the results")
    what.add_argument("--no-pictures", action="store_true", help="no pictures, which need matplotlib")


def run(options: argparse.Namespace) -> None:
    """Print the deviation of every surface, and write the results if a folder was given."""
    solids = read_solids(options.surfaces)
    paths = references.reference_paths(options.reference, [solid.name for solid in solids])
    before = [] if options.output is None else organs_before(Path(options.output))
    organs = _compared(solids, paths, options) if options.output is None else _written(solids, paths, options)
    print(comparison_table(organs))
    for solid, organ in zip(solids, organs):
        # Distances from an invalid surface are computed as well, so say that it is one.
        for warning in (*organ.warnings, *(problem.message for problem in check_surface(solid.surface))):
            LOG.warning(f"warning: {organ.name}: {warning}")
    if options.output is not None:
        instead = f", in place of the comparison of {', '.join(before)} there" if before else ""
        LOG.info(f"results written to {options.output}{instead}")


def _written(solids, paths, options: argparse.Namespace) -> list[ComparedOrgan]:
    """Compare, and write everything into the folder or nothing."""
    pictures = not options.no_pictures
    if pictures:
        require_packages("matplotlib")
    names = [file_name(solid.name) for solid in solids]
    files = [file for name in names for file in organ_files(name, pictures=True)]
    inputs = [*options.surfaces, *paths.values()]
    keep_inputs([Path(options.output, file) for file in (*files, CSV, JSON)], inputs)
    outdated = () if pictures else [file for file in files if file.endswith(".png")]
    with replacing_folder(options.output, outdated=outdated) as drafts:
        # Inside the block: a folder that cannot be written to is found before the comparison.
        organs = _compared(solids, paths, options)
        for organ in organs:
            write_organ(organ, drafts, pictures=pictures)
        write_numbers(organs, drafts, points=options.points, pictures=pictures)
    return organs


def _compared(solids, paths, options: argparse.Namespace) -> list[ComparedOrgan]:
    found = references.read_references([solid.name for solid in solids], paths, options)
    tolerances = tuple(dict.fromkeys(options.tolerance or TOLERANCES))
    how = {"points": options.points, "tolerances": tolerances}
    return [
        compared_organ(solid.name, solid.surface, found[solid.name].read, found[solid.name].path, **how)
        for solid in solids
    ]
