"""Formats a model is saved in, by the ending of the file's name."""

from __future__ import annotations

import os
from pathlib import Path

from .file import write_model
from .model import MultiPatchModel
from .step import write_model_step
from .vtp import write_model_vtp

_WRITERS = {".json": write_model, ".step": write_model_step, ".stp": write_model_step, ".vtp": write_model_vtp}
PICTURE = ".png"
SUFFIXES = (PICTURE, *_WRITERS)


def check_suffix(path: str | os.PathLike) -> str:
    """Return the ending of a file's name.

    Raises
    ------
    ValueError
        If no format of models has it.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        msg = f"The file {os.fspath(path)} was asked for; give a file name that ends in {', '.join(SUFFIXES)}."
        raise ValueError(msg)
    return suffix


def save_model(model: MultiPatchModel, path: str | os.PathLike) -> None:
    """Write a model in the format that the file's name asks for; see :meth:`.model.MultiPatchModel.save`."""
    suffix = check_suffix(path)
    if suffix == PICTURE:
        from .picture import draw_model

        draw_model(model, path)
    else:
        _WRITERS[suffix](model, path)
