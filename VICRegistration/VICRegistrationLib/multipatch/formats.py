"""File formats of models, by the suffix, and the files that every fit of a model writes."""

from __future__ import annotations

import os
from pathlib import Path

from .file import write_model
from .model import MultiPatchModel
from .picture import draw_model
from .step import write_model_step
from .vtp import write_model_vtp

_WRITERS = {
    ".png": draw_model,
    ".json": write_model,
    ".step": write_model_step,
    ".stp": write_model_step,
    ".vtp": write_model_vtp,
}
SUFFIXES = tuple(_WRITERS)
# Files that the command line and Slicer write.
MODEL, MODEL_STEP, MODEL_VTP = "model.json", "model.step", "model.vtp"


def check_suffix(path: str | os.PathLike) -> str:
    """Return the suffix of a file.

    Raises
    ------
    ValueError
        If models have no such format.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        msg = f"The file {os.fspath(path)} was asked for; give a file name that ends in {', '.join(SUFFIXES)}."
        raise ValueError(msg)
    return suffix


def save_model(model: MultiPatchModel, path: str | os.PathLike) -> None:
    """Write a model in the format of the file's suffix; see :meth:`.model.MultiPatchModel.save`."""
    _WRITERS[check_suffix(path)](model, path)


def write_model_files(model: MultiPatchModel, folder: Path) -> tuple[list[str], str]:
    """Write a model as JSON, STEP and VTP.

    Parameters
    ----------
    model : MultiPatchModel
    folder : Path

    Returns
    -------
    names : list of str
        Names of the files that were written.
    problem : str
        Sentence on why there is no STEP file; empty if there is one.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    write_model(model, folder / MODEL)
    write_model_vtp(model, folder / MODEL_VTP)
    try:
        write_model_step(model, folder / MODEL_STEP)
    except ValueError as error:
        return [MODEL, MODEL_VTP], f"There is no {MODEL_STEP}: {error}"
    return [MODEL, MODEL_STEP, MODEL_VTP], ""
