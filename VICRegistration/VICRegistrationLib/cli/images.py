"""Reading the images of a fit, with warnings about their files."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ..imaging.image import Image
from ..imaging.labels import few_values
from ..imaging.reading import read_image
from ..imaging.volumes import SeveralVolumes
from ..registration.stacks import Stack
from ..segmentation.checks import check_scale
from .console import LOG
from .process import silenced_stderr
from .stack_entries import stack_place


def read_with_warnings(
    path: str | os.PathLike, *, series: str | None = None, frame: int | None = None
) -> tuple[Image, list[str]]:
    """Read an image, and log warnings about its file.

    Parameters
    ----------
    path : path
        File or folder of DICOM slices.
    series, frame
        As of :func:`..imaging.reading.read_image`.

    Returns
    -------
    image : Image
    notes : list of str
        A sentence each.

    Raises
    ------
    ValueError
        With a message for the user.
    """
    notes: list[str] = []
    # Readers written in C print errors, which they also raise, and warnings, which are collected.
    with silenced_stderr():
        image = read_image(path, series=series, frame=frame, warn=notes.append)
    try:
        check_scale(image)
    except ValueError as error:
        # The notes may say why, for instance that the header has another unit.
        msg = " ".join([*(f"{note}." for note in notes), str(error)] if notes else [f"{path}: {error}"])
        raise ValueError(msg) from None
    count = few_values(image)
    if count:
        notes.append(f"{path}: it has only {count} different values, like a label map; a fit needs an MRI")
    for note in notes:
        LOG.warning(f"warning: {note}")
    return image, notes


def further_stacks(names: Iterable[str]) -> dict[str, Stack]:
    """Read further stacks, each once.

    Parameters
    ----------
    names : iterable of str
        As users name them, see :func:`.stack_entries.stack_place`.

    Returns
    -------
    dict of str to Stack
        By these names.

    Raises
    ------
    ValueError
        With a message for the user.
    """
    stacks = {}
    for given in dict.fromkeys(names):
        path, choice = stack_place(given)
        try:
            image, _ = read_with_warnings(path, **choice)
        except SeveralVolumes as error:
            # The message of the error names --series and --frame, which are for the first image.
            which = "the number of the series" if Path(path).is_dir() else "the number of the volume"
            other = ", or give a file that holds it alone" if choice else ""
            way_out = f"Choose it with --also {path}@N, N {which}{other}."
            msg = f"{error.found}; a further stack is one volume. {way_out}"
            raise ValueError(msg) from error
        LOG.info(f"{given}: {described(image)}")
        stacks[given] = Stack(image, given)
    return stacks


def described(image: Image) -> str:
    """Size and spacing of an image in words."""
    size = " x ".join(str(count) for count in image.size)
    spacing = " x ".join(f"{step:.4g}" for step in image.spacing)
    return f"{size} voxels of {spacing} mm"
