"""The image of a fit, and what its file leaves open."""

from __future__ import annotations

import os

from ..imaging.image import Image
from ..imaging.labels import few_values
from ..imaging.reading import read_image
from ..segmentation.checks import check_scale
from .console import LOG
from .process import silenced_stderr


def read_with_warnings(
    path: str | os.PathLike, *, series: str | None = None, frame: int | None = None
) -> tuple[Image, list[str]]:
    """Read an image, and warn of what is doubtful about it.

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
        With a sentence for the user.
    """
    notes: list[str] = []
    # What readers written in C print is either an error, which they raise too, or collected as a warning.
    with silenced_stderr():
        image = read_image(path, series=series, frame=frame, warn=notes.append)
    try:
        check_scale(image)
    except ValueError as error:
        # A unit in the file's header may be the wrong one.
        msg = " ".join([*(f"{note}." for note in notes), str(error)] if notes else [f"{path}: {error}"])
        raise ValueError(msg) from None
    count = few_values(image)
    if count:
        notes.append(f"{path}: it holds only {count} different values, as a label map does; an MRI is needed for a fit")
    for note in notes:
        LOG.warning(f"warning: {note}")
    return image, notes
