"""Exporting organs of the scene for CAD and simulation, and loading their meshes."""

from __future__ import annotations

import os
from pathlib import Path

import slicer
from slicer.i18n import tr as _

from .organ_nodes import removeNodes
from .surfaces import movedSurface, surfaceOf
from .volumes import linearRelation

QUALITY_ATTRIBUTE = "VIC.quality"
_ASSEMBLY, _STEP = "organs", ".step"


def worldSurface(organ):
    """B-spline surface of an organ in world coordinates.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    VICRegistrationLib.geometry.surface.BSplineSurface
        World RAS mm; exact, normals outward.

    Raises
    ------
    ValueError
        If the organ has no surface, or lies under a nonlinear transform.
    """
    surface = surfaceOf(organ)
    matrix = linearRelation(organ.surface.GetParentTransformNode(), None)
    if matrix is None:
        raise ValueError(
            _(
                "The organ {name} is under a nonlinear transform, which a B-spline surface cannot follow exactly. "
                "Take the volume out of the transform, or harden the transform on the volume and fit again."
            ).format(name=organ.label)
        )
    return movedSurface(surface, matrix)


def exportSurfaces(organs, folder, suffix, *, faces=1):
    """Write organs as exact solids or as triangles; all files are written, or none.

    Parameters
    ----------
    organs : sequence of OrganParameters
    folder : path
        Is made if it does not exist.
    suffix : str
        ".step": one file, an assembly if there are several organs; ".stl", ".ply" or ".vtp": a file for each organ.
    faces : int
        Faces of each solid in the STEP file.

    Returns
    -------
    list of Path
        The files, in LPS mm as all files of Slicer.

    Raises
    ------
    ValueError
        If an organ has no valid surface, or a name that cannot be a file name.
    OSError
        If a file cannot be written.
    """
    from ..export.mesh_files import write_mesh
    from ..export.step import validate_solids, write_step
    from ..files import replacing_folder

    solids = _solids(organs)
    with replacing_folder(folder) as drafts:
        if suffix == _STEP:
            # Checks the solids by itself.
            name = solids[0].name if len(solids) == 1 else _ASSEMBLY
            write_step(solids, drafts / f"{name}{suffix}", faces=faces)
            return [Path(folder) / f"{name}{suffix}"]
        validate_solids(solids)
        for solid in solids:
            write_mesh(solid.surface, drafts / f"{solid.name}{suffix}", name=solid.name)
    return [Path(folder) / f"{solid.name}{suffix}" for solid in solids]


def meshArguments(organs, workFolder, folder, suffix, *, sizeMm, order=1, wallMm=0.0):
    """Arguments of ``vic-registration mesh`` for meshing organs in a process of its own.

    Parameters
    ----------
    organs : sequence of OrganParameters
        Where two overlap, the overlap belongs to the first.
    workFolder : path
        For the surfaces; must exist until the process has ended.
    folder : path
        For the mesh.
    suffix : str
        One of `MESH_FORMATS` in meshing/formats.py.
    sizeMm : float
        Edge length of an element.
    order : {1, 2}
    wallMm : float
        Thickness of the wall of hollow organs; 0 for solid ones.

    Returns
    -------
    arguments : list of str
    path : Path
        Of the mesh.

    Raises
    ------
    ValueError
        As :func:`exportSurfaces`.
    OSError
        If a surface cannot be written.
    """
    from ..geometry.surface_file import write_surface

    solids, surfaces = _solids(organs), []
    for solid in solids:
        path = Path(workFolder) / f"{solid.name}.json"
        write_surface(solid.surface, path, name=solid.name)
        surfaces.append(str(path))
    name = solids[0].name if len(solids) == 1 else _ASSEMBLY
    path = Path(folder) / f"{name}{suffix}"
    wall = ["--wall", f"{wallMm:g}"] if wallMm > 0.0 else []
    arguments = ["mesh", *surfaces, "--size", f"{sizeMm:g}", "--order", str(order), *wall, "--output", str(path)]
    return arguments, path


def loadMesh(path):
    """Load a mesh as a model of the scene.

    Parameters
    ----------
    path : path
        A .vtu file in LPS mm.

    Returns
    -------
    vtkMRMLModelNode
        Shown with edges. The quality report beside the file, if there is one, is stored in its attribute `VIC.quality`.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    path = Path(path)
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", _("{name} mesh").format(name=path.stem))
    storage = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelStorageNode")
    storage.SetFileName(os.fspath(path))
    node.SetAndObserveStorageNodeID(storage.GetID())
    if not storage.ReadData(node):
        removeNodes([node])
        raise ValueError(_("The mesh {path} cannot be loaded; check that the file is there.").format(path=path))
    node.CreateDefaultDisplayNodes()
    node.GetDisplayNode().SetEdgeVisibility(True)
    report = path.with_name(f"{path.name}.quality.json")
    if report.is_file():
        node.SetAttribute(QUALITY_ATTRIBUTE, report.read_text(encoding="utf-8"))
    return node


def _solids(organs):
    from ..export.step import Solid
    from ..file_names import file_key, organ_name

    solids = {}
    for organ in organs:
        name = organ_name(organ.label)
        if file_key(name) in solids:
            # Possible after two scenes were loaded: one file would replace the other.
            raise ValueError(_("Two organs are named {name}; rename one of them in the table.").format(name=name))
        solids[file_key(name)] = Solid(name, worldSurface(organ), tuple(organ.color))
    if not solids:
        raise ValueError(_("No organ has a surface yet. Fit an organ first."))
    return list(solids.values())
