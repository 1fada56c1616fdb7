"""``vic-registration reproduce``: the paper's validation."""

from __future__ import annotations

import argparse

from ..file_names import folder_name
from ..files import replacing_folder
from ..report.figure import require_packages
from .console import LOG, add_command, argument


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "reproduce", "repeat the paper's section 2.3 and figures 5 and 6", run)
    parser.add_argument(
        "folder",
        metavar="DIR",
        type=argument(folder_name),
        help="folder for a table and plots beside the paper's values",
    )


def run(options: argparse.Namespace) -> None:
    """Repeat the paper's validation and write a table and plots."""
    from ..validation.report import reproduce

    require_packages("matplotlib", otherwise="")
    with replacing_folder(options.folder) as drafts:
        reproduce(drafts, say=LOG.info)
    LOG.info(f"table and plots written to {options.folder}")
