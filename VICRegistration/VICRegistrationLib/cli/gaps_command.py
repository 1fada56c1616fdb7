"""``vic-registration gaps``: gaps and overlaps between organs."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from ..analysis.gaps import Gap, gaps
from ..files import keep_inputs, write_json
from .console import add_command
from .solids import read_solids

SCHEMA, VERSION = "vic-registration/gaps", 2

_EPILOG = """\
SURFACE is a file NAME.json or NAME.vtp of `vic-registration fit`. For every pair of organs a line has the gap or the
overlap, with its place (RAS mm). Distances are those of the exact surfaces.

examples:
  vic-registration gaps bladder.json vagina.json rectum.json
  vic-registration gaps organs/*.vtp --output gaps.json
"""


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "gaps", "measure gaps and overlaps between organs", run, epilog=_EPILOG)
    parser.add_argument("surfaces", metavar="SURFACE", nargs="+", help="surface file of fit: NAME.json or NAME.vtp")
    parser.add_argument("--output", metavar="FILE", type=Path, help="JSON file for the figures")


def run(options: argparse.Namespace) -> None:
    """Print gap or overlap of every pair, and write them if a file was given."""
    if options.output is not None:
        if options.output.suffix.lower() != ".json":
            msg = (
                f"--output {options.output} was given; the figures are written as JSON, so the name must end in .json."
            )
            raise ValueError(msg)
        keep_inputs([options.output], options.surfaces)
    solids = read_solids(options.surfaces)
    if len(solids) < 2:
        msg = f"One surface was given, {solids[0].name}; gaps are between two organs or more. Give more surfaces."
        raise ValueError(msg)
    found = gaps({solid.name: solid.surface for solid in solids})
    if options.output is not None:
        content = {"schema": SCHEMA, "version": VERSION, "frame": "RAS", "unit": "mm", "gaps": _entries(found)}
        write_json(options.output, content)
    for gap in found:
        print(gap)


def _entries(found: Sequence[Gap]) -> list[dict]:
    return [{**dataclasses.asdict(gap), "distance": gap.distance} for gap in found]
