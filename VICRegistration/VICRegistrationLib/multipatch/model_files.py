"""The files about a model that the command line and Slicer write alike."""

from __future__ import annotations

from pathlib import Path

from .file import write_model
from .model import MultiPatchModel
from .step import write_model_step
from .vtp import write_model_vtp

MODEL, MODEL_STEP, MODEL_VTP = "model.json", "model.step", "model.vtp"


def write_model_files(model: MultiPatchModel, folder: Path) -> tuple[list[str], str]:
    """Write a model as JSON, STEP and VTP.

    Parameters
    ----------
    model : MultiPatchModel
    folder : Path

    Returns
    -------
    names : list of str
        Of the files that were written.
    problem : str
        Why there is no STEP file, in a sentence; empty if there is one.

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
