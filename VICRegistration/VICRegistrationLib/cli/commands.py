"""The commands: from parsed words to work done."""

from __future__ import annotations

import argparse

from ..files import replacing_folder
from .fitting import fit_to_folder
from .requests import OPTIONS, OrganRequest, organ_request, read_requests
from .words import speaker


def fit(options: argparse.Namespace) -> None:
    """Fit organs in an image and write everything about them into a folder.

    Parameters
    ----------
    options : argparse.Namespace

    Raises
    ------
    ValueError, OSError, RuntimeError
        With a sentence for the user.
    """
    fit_to_folder(
        options.image,
        _requests(options),
        options.output,
        series=options.series,
        inputs=() if options.config is None else (options.config,),
        pictures=not options.no_pictures,
        step=options.step,
        say=speaker(options.quiet),
    )


def phantom(options: argparse.Namespace) -> None:
    """Write the synthetic MRI with its true surfaces.

    Parameters
    ----------
    options : argparse.Namespace

    Raises
    ------
    OSError
        With a sentence for the user.
    """
    from ..phantoms.pelvis import pelvis_phantom, write_phantom

    with replacing_folder(options.folder) as drafts:
        write_phantom(pelvis_phantom(), drafts)
    speaker()(f"phantom written to {options.folder}: mri.nii.gz, organs.json and truth")


def reproduce(options: argparse.Namespace) -> None:
    """Repeat the paper's validation and write a table and plots.

    Parameters
    ----------
    options : argparse.Namespace

    Raises
    ------
    OSError, RuntimeError
        With a sentence for the user.
    """
    from ..analysis.canvas import require_matplotlib
    from ..reproduction.report import reproduce as run

    require_matplotlib(otherwise="")
    with replacing_folder(options.folder) as drafts:
        run(drafts, say=speaker())
    speaker()(f"table and plots written to {options.folder}")


def _requests(options: argparse.Namespace) -> tuple[OrganRequest, ...]:
    """Put together what the flags ask for."""
    chosen = {word: getattr(options, word) for word in OPTIONS}
    if options.config is not None:
        own = [word for word in ("organ", "seed", "threshold", "boundary") if getattr(options, word) is not None]
        if own:
            msg = f"Both --config and --{own[0]} were given; put the {own[0]} of each organ into the configuration."
            raise ValueError(msg)
        return read_requests(options.config, defaults=chosen)
    missing = [word for word in ("organ", "seed") if getattr(options, word) is None]
    if missing:
        msg = f"No --{missing[0]} was given; give --organ NAME and --seed R,A,S, or --config FILE for several organs."
        raise ValueError(msg)
    return (organ_request(options.organ, options.seed, boundary=options.boundary, **chosen),)
