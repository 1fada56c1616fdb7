"""Models by their names: those that ship, and those in files."""

from __future__ import annotations

import os
from functools import partial

from .file import read_model
from .model import MultiPatchModel
from .pelvis import pelvis

DEFAULT = "pelvis"
# Functions that draw the models that ship, by name.
MODELS = {DEFAULT: pelvis, "pelvis-fine": partial(pelvis, fine=True)}


def find_model(name: str | os.PathLike = DEFAULT) -> MultiPatchModel:
    """Return a model that ships, or read one from a file.

    Parameters
    ----------
    name : str or path
        A name in `MODELS`, or the path of a file.

    Returns
    -------
    MultiPatchModel

    Raises
    ------
    OSError
        If it is neither a name nor a file that can be read.
    ValueError
        If the file holds no model.

    Examples
    --------
    >>> from VICRegistrationLib import find_model
    >>> find_model("pelvis")
    MultiPatchModel(14 parts, 107 patches, 2012 points)
    """
    if os.fspath(name) in MODELS:
        return MODELS[os.fspath(name)]()
    if not os.path.exists(name):
        msg = f"There is no model or file {os.fspath(name)}; give a file, or one of {', '.join(MODELS)}."
        raise OSError(msg)
    return read_model(name)
