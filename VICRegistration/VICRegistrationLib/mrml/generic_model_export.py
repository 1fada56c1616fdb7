"""Exporting a fitted generic model of the scene for CAD and simulation."""

from __future__ import annotations

from pathlib import Path

from .generic_model_nodes import modelOfVolume


def exportModel(volumeNode, folder):
    """Write the fitted model of a volume; all files are written, or none.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    folder : path
        Is made if it does not exist.

    Returns
    -------
    paths : list of Path
        ``model.json`` and a JSON file for every organ that the image shows (RAS mm), ``model.step`` and ``model.vtp``
        (LPS mm), in world coordinates.
    problem : str
        Why there is no STEP file; empty if there is one.

    Raises
    ------
    ValueError
        If there is no fitted model, or its transform cannot be applied to it exactly.
    OSError
        If a file cannot be written.
    """
    from ..file_names import organ_name
    from ..files import replacing_folder
    from ..geometry.surface_file import write_surface
    from ..multipatch.formats import MODEL_STEP, write_model_files

    model = modelOfVolume(volumeNode)
    organs = {organ_name(name): model.parents[name] for name in model.organs if not model.part(name).estimated}
    outdated = []
    with replacing_folder(folder, outdated=outdated) as drafts:
        names, problem = write_model_files(model, drafts)
        if problem:
            # A STEP file of an earlier model would be taken for this one's.
            outdated.append(MODEL_STEP)
        for name, parent in organs.items():
            write_surface(parent, drafts / f"{name}.json", name=name)
            names.append(f"{name}.json")
    return [Path(folder) / name for name in names], problem


def modelMeshArguments(volumeNode, workFolder, folder, suffix, *, sizeMm):
    """Arguments of ``vic-registration mesh`` for meshing the fitted model of a volume.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    workFolder : path
        For the model; must exist until the process has ended.
    folder : path
        For the mesh.
    suffix : str
        One of `MESH_FORMATS` in meshing/formats.py.
    sizeMm : float
        Edge length of an element.

    Returns
    -------
    arguments : list of str
    path : Path
        Of the mesh.

    Raises
    ------
    ValueError, OSError
        As :func:`exportModel`.
    """
    from ..multipatch.file import write_model
    from ..multipatch.formats import MODEL

    source, path = Path(workFolder) / MODEL, Path(folder) / f"{Path(MODEL).stem}{suffix}"
    write_model(modelOfVolume(volumeNode), source)
    return ["mesh", str(source), "--size", f"{sizeMm:g}", "--output", str(path)], path
