"""The commands: from parsed words to work done. What cannot be done is an error with a sentence for the user."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..files import replacing_folder
from ..registration.options import OPTIONS
from ..registration.verdict import POOR
from . import SOME_FAILED
from .configuration import OrganRequest, files_of, organ_request, read_requests
from .console import LOG
from .fitting import fit_to_folder
from .process import silenced_stderr
from .references import OrganReference, chosen_labels, read_references, reference_paths


def fit(options: argparse.Namespace) -> int:
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
        With a sentence for the user.
    """
    requests = _requests(options)
    references = _references(options, [request.name for request in requests])
    read = [*(reference.path for reference in references.values()), *files_of(requests)]
    run = fit_to_folder(
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
    poor = [organ.name for organ in run.organs if organ.verdict.word == POOR] if options.strict else []
    if poor:
        LOG.warning(f"the verdict is poor: {', '.join(poor)}")
    if run.failed:
        count = len(run.failed) + len(run.organs)
        LOG.warning(f"{len(run.failed)} of {count} organs could not be fitted: {', '.join(run.failed)}")
    return SOME_FAILED if poor or run.failed else 0


def phantom(options: argparse.Namespace) -> None:
    """Write the synthetic MRI with its true surfaces."""
    from ..phantoms.pelvis import pelvis_phantom, write_phantom
    from ..phantoms.stacks import further_stacks, write_stacks

    shift, turn = options.motion
    if options.stacks == 1 and (shift or turn):
        msg = "--motion was given without --stacks; it moves the patient before a further stack. Give --stacks 2 or 3."
        raise ValueError(msg)
    _keep_files_of_the_user(Path(options.folder))
    # ITK prints to stderr when the disk is full, and the error says so too.
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
        msg = f"{there[0]} is there and is not of a phantom; choose another folder, or move it elsewhere."
        raise ValueError(msg)


def reproduce(options: argparse.Namespace) -> None:
    """Repeat the paper's validation and write a table and plots."""
    from ..report.figure import require_packages
    from ..validation.report import reproduce as run

    require_packages("matplotlib", otherwise="")
    with replacing_folder(options.folder) as drafts:
        run(drafts, say=LOG.info)
    LOG.info(f"table and plots written to {options.folder}")


def _references(options: argparse.Namespace, names: Sequence[str]) -> dict[str, OrganReference]:
    """Read what the organs are compared with, before the work."""
    if options.reference is None:
        flags = {"label": "--label", "largest": "--largest", "mesh_frame": "--reference-frame"}
        if options.region is not None:
            del flags["label"]
        own = [flag for word, flag in flags.items() if getattr(options, word)]
        if own:
            needed = "--reference or --region" if own[0] == "--label" else "--reference"
            msg = f"{own[0]} was given without {needed}, whose file it is about; give both, or leave {own[0]} out."
            raise ValueError(msg)
        return {}
    if options.no_pictures:
        msg = "--reference was given with --no-pictures, but pictures and report.html show it; leave one of them out."
        raise ValueError(msg)
    return read_references(names, reference_paths(options.reference, names), options)


def _requests(options: argparse.Namespace) -> tuple[OrganRequest, ...]:
    """Put together what the flags ask for."""
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
