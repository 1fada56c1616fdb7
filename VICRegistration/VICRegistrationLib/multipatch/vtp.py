"""Models as VTP files: triangles with the names of their patch and part.

Cell arrays: ``patch`` and ``part``, the names; ``patch_number`` and ``part_number``, from 1 in the order of the model;
``estimated``, 1 if the image does not show the part. Names of estimated parts and patches end in "(estimated)". Points
are LPS mm, and the field ``SPACE`` says so, as in the files of single organs.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

from ..export.surface_data import add_text, number_array, text_array, xml_text
from ..files import write_text
from ..frames import RAS_TO_LPS
from ..geometry.polydata import polydata
from .model import MultiPatchModel
from .triangles import model_triangles


def write_model_vtp(model: MultiPatchModel, path: str | os.PathLike) -> None:
    """Write the triangles of a model as a VTP file.

    Parameters
    ----------
    model : MultiPatchModel
    path : path
        File to write; its folder must exist.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    mesh = model_triangles(model)
    data = _named(model, mesh.points * RAS_TO_LPS, mesh.triangles, mesh.patch_of)
    add_text(data, "SPACE", "LPS")
    write_text(path, xml_text(vtkXMLPolyDataWriter(), data))


def holds_patches(path: str | os.PathLike) -> bool:
    """Whether a file is the VTP file of a model; false if it cannot be read."""
    try:
        return Path(path).suffix.lower() == ".vtp" and b'Name="patch_number"' in Path(path).read_bytes()
    except OSError:
        return False


def part_polydata(model: MultiPatchModel) -> dict[str, vtkPolyData]:
    """Make VTK data of each part's triangles, with the arrays of the VTP file.

    Parameters
    ----------
    model : MultiPatchModel

    Returns
    -------
    dict of str to vtkPolyData
        By the parts' names, RAS mm.
    """
    mesh = model_triangles(model)
    found = {}
    for part in model.parts:
        rows = mesh.of(model.patches_of(part.name))
        used, triangles = np.unique(mesh.triangles[rows], return_inverse=True)
        found[part.name] = _named(model, mesh.points[used], triangles.reshape(-1, 3), mesh.patch_of[rows])
    return found


def _named(model: MultiPatchModel, points: np.ndarray, triangles: np.ndarray, patch_of: np.ndarray) -> vtkPolyData:
    """Make VTK data of triangles, with the patch and the part of each."""
    data = polydata(points, triangles)
    cells = data.GetCellData()
    parts = [part.name for part in model.parts]
    part_of = np.array([parts.index(patch.part) for patch in model.patches])[patch_of]
    names = {
        "patch": ([model.part(patch.part).labelled(patch.name) for patch in model.patches], patch_of),
        "part": ([part.labelled() for part in model.parts], part_of),
    }
    numbers = {
        "patch_number": patch_of + 1,
        "part_number": part_of + 1,
        "estimated": np.array([part.estimated for part in model.parts])[part_of].astype(np.uint8),
    }
    for key, (words, rows) in names.items():
        cells.AddArray(text_array(key, [words[row] for row in rows.tolist()]))
    for key, values in numbers.items():
        cells.AddArray(number_array(key, values))
    cells.SetActiveScalars("patch_number")
    return data
