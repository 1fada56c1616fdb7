"""Tetrahedral meshes in files for finite element programs, in LPS mm: the format is chosen by the suffix.

====== ======================================================================================================
.msh   gmsh 4.1, text; groups are physical groups
.vtu   VTK, tetrahedra and triangles; the number ``group`` of each cell, their names in the field data
       ``group_names``
.inp   Abaqus and CalculiX: solid elements only, C3D4 or C3D10; ELSET of every organ, SURFACE and NSET of
       every surface
.bdf   Nastran: CTETRA only, a PSOLID for every organ, SET1 with the nodes of every surface
.med   Salome and Code_Aster, by gmsh; groups are families
====== ======================================================================================================
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from ..export.frames import RAS_TO_LPS
from ..export.vtk_xml import xml_text
from ..files import replacing
from .abaqus import abaqus_text
from .msh import msh_text
from .nastran import nastran_text
from .process import MeshingError, run_worker
from .tetrahedra import TetrahedralMesh, require_mesher

# Kinds of cells by their number of nodes: triangles and tetrahedra, linear and second order.
VTK_TYPES = {3: 5, 6: 22, 4: 10, 10: 24}


def write_tetrahedra(mesh: TetrahedralMesh, path: str | os.PathLike) -> None:
    """Write a mesh in the format of the file's suffix.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm; the file is LPS mm.
    path : path
        File to write; its folder must exist.

    Raises
    ------
    ValueError
        If the suffix is none of those known.
    MeshingError
        If gmsh, which .med needs, is not installed or fails.
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    # Before the file is begun: what fails here has nothing to do with the disk.
    content = writer_for(path)(mesh)
    with replacing(path) as draft:
        draft.write_bytes(content)


def writer_for(path: str | os.PathLike) -> Callable[[TetrahedralMesh], bytes]:
    """Find the function that makes a file's content of a mesh.

    Raises
    ------
    ValueError
        If the suffix is none of those known.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        msg = f"{Path(path).name} was asked for; give a file name that ends in {', '.join(WRITERS)}."
        raise ValueError(msg)
    return WRITERS[suffix]


def vtu_grid(mesh: TetrahedralMesh) -> vtkUnstructuredGrid:
    """Mesh as VTK data, LPS mm: tetrahedra, then triangles.

    Parameters
    ----------
    mesh : TetrahedralMesh

    Returns
    -------
    vtkUnstructuredGrid
    """
    points = vtkPoints()
    points.SetData(numpy_to_vtk(mesh.points * RAS_TO_LPS, deep=True))
    kinds = [cells for cells in (mesh.tetrahedra, mesh.triangles) if len(cells)]
    sizes = np.concatenate([np.full(len(cells), cells.shape[1]) for cells in kinds])
    types = np.concatenate([np.full(len(cells), VTK_TYPES[cells.shape[1]], dtype=np.uint8) for cells in kinds])
    array = vtkCellArray()
    array.SetData(
        numpy_to_vtkIdTypeArray(np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), deep=True),
        numpy_to_vtkIdTypeArray(np.concatenate([cells.ravel() for cells in kinds]).astype(np.int64), deep=True),
    )
    grid = vtkUnstructuredGrid()
    grid.SetPoints(points)
    grid.SetCells(numpy_to_vtk(types, deep=True), array)
    group = np.full(len(sizes), -1, dtype=np.int32)
    names = [*mesh.tetrahedron_groups, *mesh.triangle_groups]
    starts = [0] * len(mesh.tetrahedron_groups) + [len(mesh.tetrahedra)] * len(mesh.triangle_groups)
    rows = [*mesh.tetrahedron_groups.values(), *mesh.triangle_groups.values()]
    for number, (start, cells) in enumerate(zip(starts, rows)):
        group[start + cells] = number
    numbers = numpy_to_vtk(group, deep=True)
    numbers.SetName("group")
    grid.GetCellData().AddArray(numbers)
    for key, texts in (("SPACE", ["LPS"]), ("unit", ["mm"]), ("group_names", names)):
        field = vtkStringArray()
        field.SetName(key)
        for text in texts:
            field.InsertNextValue(text)
        grid.GetFieldData().AddArray(field)
    return grid


def _vtu(mesh: TetrahedralMesh) -> bytes:
    return xml_text(vtkXMLUnstructuredGridWriter(), vtu_grid(mesh)).encode("utf-8")


def _med(mesh: TetrahedralMesh) -> bytes:
    module = require_mesher("gmsh")
    job = {"convert": ["mesh.msh", "mesh.med"]}
    result = run_worker(module, job, {"mesh.msh": msh_text(mesh)}, name="gmsh", time_limit=600.0)
    content = result.arrays["content"].tobytes()
    if not content:
        msg = "gmsh wrote no .med file; choose another format, such as .msh."
        raise MeshingError(msg)
    return content


WRITERS: dict[str, Callable[[TetrahedralMesh], bytes]] = {
    ".msh": lambda mesh: msh_text(mesh).encode("utf-8"),
    ".vtu": _vtu,
    ".inp": lambda mesh: abaqus_text(mesh).encode("ascii"),
    ".bdf": lambda mesh: nastran_text(mesh).encode("ascii"),
    ".med": _med,
}
