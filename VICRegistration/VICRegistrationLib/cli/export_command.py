"""``vic-registration export``: surfaces as STEP solids and as triangles."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from ..export.mesh_files import DEFAULT_CHORD_ERROR, write_mesh
from ..export.step import Solid, validate_solids, write_step
from ..files import keep_inputs, replacing_folder
from . import validators
from .console import LOG, add_command, argument
from .solids import file_name, read_solids

_SUFFIXES = {"step": (".step", ".stp"), "stl": (".stl",), "ply": (".ply",), "vtp": (".vtp",)}
_MOST_FACES = 1000

_EPILOG = """\
SURFACE is a file NAME.json or NAME.vtp of `vic-registration fit`. FILE is
  a file's name         organs.step: several surfaces become an assembly; triangles need one file per organ
  a folder              parts/: one file per organ, parts/NAME.step
  a name with {name}    parts/{name}_fine.stl: one file per organ
All files are LPS mm (DICOM's frame; Slicer opens the triangles in place). The STEP file (AP214) holds the exact
B-spline surfaces as closed solids with names and colours. A surface that is folded, inside out, or passes through
itself is refused, and for STEP one that is open. Either all files are written or none.

examples:
  vic-registration export bladder.json rectum.json --step pelvis.step
  vic-registration export bladder.json --step bladder.step --split 4 --stl bladder.stl --chord-error 0.02
  vic-registration export organs/*.vtp --step parts/ --ply 'parts/{name}.ply'
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "export", "write surfaces as STEP, STL, PLY or VTP", run, epilog=_EPILOG)
    parser.add_argument("surfaces", metavar="SURFACE", nargs="+", help="surface file of fit: NAME.json or NAME.vtp")
    parser.add_argument("--step", metavar="FILE", help="exact solids for CAD and simulation (AP214)")
    for kind in ("stl", "ply", "vtp"):
        parser.add_argument(f"--{kind}", metavar="FILE", help=f"triangles, {kind.upper()}")
    parser.add_argument(
        "--split",
        metavar="K",
        type=argument(validators.whole(f"a solid is split into 1 to {_MOST_FACES} faces", _MOST_FACES)),
        default=1,
        help="faces of each solid in the STEP file, from pole to pole, for programs that cannot use a seam (default: "
        "1, with a seam)",
    )
    parser.add_argument(
        "--chord-error",
        metavar="MM",
        type=argument(validators.length),
        default=DEFAULT_CHORD_ERROR,
        help=f"largest distance between triangles and surface (default: {DEFAULT_CHORD_ERROR})",
    )


def run(options: argparse.Namespace) -> None:
    """Write all files that were asked for, or none."""
    wanted = {kind: getattr(options, kind) for kind in _SUFFIXES if getattr(options, kind) is not None}
    if not wanted:
        msg = "No format was chosen; give at least one of --step FILE, --stl FILE, --ply FILE and --vtp FILE."
        raise ValueError(msg)
    solids = read_solids(options.surfaces)
    jobs = {}
    for kind, pattern in wanted.items():
        for path, part in _targets(kind, pattern, solids).items():
            if path in jobs:
                msg = f"Two results would be {path}; give them different names."
                raise ValueError(msg)
            jobs[path] = _writer(kind, part, options)
    keep_inputs(jobs, options.surfaces)
    if "step" not in wanted:
        # Triangles may be open; a STEP file is checked for all that as it is written.
        validate_solids(solids, require_closed=False)
    _write(jobs)
    LOG.info(f"written: {', '.join(map(str, jobs))}")


def _writer(kind: str, solids: Sequence[Solid], options: argparse.Namespace) -> Callable[[Path], None]:
    """Make the function that writes a file."""
    if kind == "step":
        return partial(write_step, solids, faces=options.split)
    return partial(write_mesh, solids[0].surface, name=solids[0].name, chord_error=options.chord_error)


def _targets(kind: str, pattern: str, solids: Sequence[Solid]) -> dict[Path, Sequence[Solid]]:
    """Files of a format with the organs that each holds."""
    suffixes = _SUFFIXES[kind]
    if pattern.endswith(("/", os.sep)) or Path(pattern).is_dir():
        pattern = os.path.join(pattern, "{name}" + suffixes[0])
    if Path(pattern).suffix.lower() not in suffixes:
        msg = f"--{kind} {pattern} was given; the file's name must end in {' or '.join(suffixes)}."
        raise ValueError(msg)
    if "{name}" in pattern:
        return {Path(pattern.replace("{name}", file_name(solid.name))): [solid] for solid in solids}
    if kind != "step" and len(solids) > 1:
        msg = (
            f"{len(solids)} surfaces cannot share the file {pattern}; give a folder such as --{kind} parts/, or a name "
            f"with {{name}} in it such as --{kind} '{{name}}{suffixes[0]}'."
        )
        raise ValueError(msg)
    return {Path(pattern): solids}


def _write(jobs: dict[Path, Callable[[Path], None]]) -> None:
    """Write drafts of all files, then put them in their places."""
    with ExitStack() as stack:
        folders = {folder: stack.enter_context(replacing_folder(folder)) for folder in {path.parent for path in jobs}}
        for path, write in jobs.items():
            if path.is_dir():
                msg = f"{path} is a folder; give the file another name."
                raise OSError(msg)
            write(folders[path.parent] / path.name)
