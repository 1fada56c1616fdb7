"""``vic-registration phantom``: the demo's synthetic MRI with its true surfaces."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..file_names import folder_name
from ..files import replacing_folder
from . import validators
from .console import LOG, add_command, argument
from .process import silenced_stderr


def add_parser(subparsers) -> None:
    """Define the arguments of the command."""
    parser = add_command(subparsers, "phantom", "write a synthetic pelvic MRI with its true surfaces", run)
    parser.add_argument(
        "folder",
        metavar="DIR",
        type=argument(folder_name),
        help="folder for mri.nii.gz, organs.json and truth/NAME.json",
    )
    parser.add_argument(
        "--stacks",
        metavar="N",
        type=int,
        choices=(1, 2, 3),
        default=1,
        help="number of stacks: sagittal, axial, coronal (default: 1); organs.json lists the further ones as also",
    )
    parser.add_argument(
        "--motion",
        metavar="MM,DEG",
        type=argument(validators.motion),
        default=(0.0, 0.0),
        help="motion of the patient before each further stack; truth/motion.json has the matrices (default: 0,0)",
    )


def run(options: argparse.Namespace) -> None:
    """Write the synthetic MRI with its true surfaces."""
    from ..phantoms.pelvis import pelvis_phantom, write_phantom
    from ..phantoms.stacks import further_stacks, write_stacks

    shift, turn = options.motion
    if options.stacks == 1 and (shift or turn):
        msg = "--motion was given without --stacks; it moves the patient before a further stack. Give --stacks 2 or 3."
        raise ValueError(msg)
    _keep_files_of_the_user(Path(options.folder))
    # ITK prints to stderr when the disk is full; the error that it raises says so as well.
    with silenced_stderr(), replacing_folder(options.folder) as drafts:
        stacks = further_stacks(options.stacks - 1, shift_mm=shift, turn_degrees=turn)
        files = write_stacks(stacks, drafts)
        write_phantom(pelvis_phantom(), drafts, also=files)
    named = ", ".join(["mri.nii.gz", *files])
    LOG.info(f"phantom written to {options.folder}: {named}, organs.json and truth")


def _keep_files_of_the_user(folder: Path) -> None:
    """Refuse a folder that holds an MRI or a configuration without the phantom's true surfaces beside it."""
    there = [path for path in (*sorted(folder.glob("mri*.nii.gz")), folder / "organs.json") if path.exists()]
    if there and not (folder / "truth" / "bladder.json").exists():
        msg = f"{there[0]} exists and is not part of a phantom; choose another folder, or move it elsewhere."
        raise ValueError(msg)
