"""Tetrahedral meshes in files for finite element programs, in LPS mm: the format is chosen by the suffix.

====== ======================================================================================================
.msh   gmsh 4.1, text; groups are physical groups
.vtu   VTK, tetrahedra and triangles; cell array ``group`` with the number of each cell's group, field data
       ``group_names`` with the names
.inp   Abaqus and CalculiX: solid elements, C3D4 or C3D10; ELSET of every organ, SURFACE and NSET of
       every surface; sheets of models as S3 or STRI65 with their thickness; NSET of fixed nodes
.med   Salome and Code_Aster; groups are families
.unv   I-deas; groups are sets of nodes and of elements
.bdf   Nastran: CTETRA, and CTRIA3 or CTRIA6 of the surfaces; a property number for every group
.vtk   VTK's legacy format; cell array ``CellEntityIds`` with the number of each cell's group
====== ======================================================================================================

gmsh writes all but .vtu and .inp: its .inp would have triangles as elements too, and no surfaces for loads.
"""

from __future__ import annotations

import io
import os
import re
import unicodedata
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from ..export.surface_data import number_array, text_array, xml_text
from ..files import replacing
from ..frames import RAS_TO_LPS
from .elements import FACES, TetrahedralMesh
from .process import GMSH_WORKER, require_gmsh, run_worker

MESH_FORMATS = (".msh", ".vtu", ".inp", ".med", ".unv", ".bdf", ".vtk")
# Formats with ASCII names only, and formats with numbers instead of names.
_ASCII, _NUMBERED = (".inp", ".unv"), (".bdf", ".vtk")
# gmsh reads names of up to 127 letters, a .med file holds 80.
_LONGEST_NAME = 60
# Kinds of cells by their number of nodes: triangles and tetrahedra, linear and second order.
_VTK_TYPES = {3: 5, 6: 22, 4: 10, 10: 24}
_ABAQUS_TYPES = {3: "S3", 6: "STRI65", 4: "C3D4", 10: "C3D10"}


def write_tetrahedra(mesh: TetrahedralMesh, path: str | os.PathLike) -> dict[str, str]:
    """Write a mesh in the format of the file's suffix.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm; the file is LPS mm.
    path : path
        File to write; its folder must exist.

    Returns
    -------
    dict of str to str
        Name of each group in the file, or the number of its property if the format has no names.

    Raises
    ------
    ValueError
        If the suffix is none of `MESH_FORMATS`.
    MeshingError
        If gmsh is not installed or fails.
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    suffix = mesh_format(path)
    groups = [*mesh.tetrahedron_groups, *mesh.triangle_groups]
    names = names_in_file(groups, ascii_only=suffix in _ASCII)
    # Outside of `replacing`, which reports errors as those of the disk.
    if suffix == ".vtu":
        content, names = _vtu(mesh), {name: name for name in groups}
    elif suffix == ".inp":
        content = _abaqus(mesh, names).encode("ascii")
    else:
        content = _by_gmsh(mesh, names, suffix)
    with replacing(path) as draft:
        draft.write_bytes(content)
    return {name: str(tag) for tag, name in enumerate(groups, start=1)} if suffix in _NUMBERED else names


def mesh_format(path: str | os.PathLike) -> str:
    """Return the suffix of a mesh file.

    Raises
    ------
    ValueError
        If the suffix is none of `MESH_FORMATS`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_FORMATS:
        msg = f"{Path(path).name} was asked for; give a file name that ends in {', '.join(MESH_FORMATS)}."
        raise ValueError(msg)
    return suffix


def names_in_file(names: Iterable[str], *, ascii_only: bool) -> dict[str, str]:
    """Make names that a file can hold: distinct, not too long, in one line without quotation marks.

    Parameters
    ----------
    names : iterable of str
    ascii_only : bool
        Whether to use only ASCII letters, digits and underscores, with a letter first.

    Returns
    -------
    dict of str to str
        The new name of each; two of them differ by more than upper and lower case.
    """
    found: dict[str, str] = {}
    for name in names:
        plain = " ".join(name.replace('"', "'").split())
        if ascii_only:
            plain = unicodedata.normalize("NFKD", plain.replace("ß", "ss")).encode("ascii", "ignore").decode("ascii")
            plain = re.sub(r"\W+", "_", plain).strip("_")
            plain = plain if plain[:1].isalpha() else f"organ_{plain}".rstrip("_")
        plain = plain[:_LONGEST_NAME]
        taken, number, tried = {value.lower() for value in found.values()}, 1, plain
        while tried.lower() in taken:
            number += 1
            tried = f"{plain}_{number}"
        found[name] = tried
    return found


def _by_gmsh(mesh: TetrahedralMesh, names: dict[str, str], suffix: str) -> bytes:
    """Return the content of a file that gmsh writes, in a process of its own."""
    require_gmsh()
    groups = [
        *((3, name, mesh.tetrahedra[rows]) for name, rows in mesh.tetrahedron_groups.items()),
        *((2, name, mesh.triangles[rows]) for name, rows in mesh.triangle_groups.items()),
    ]
    arrays = {"points": mesh.points * RAS_TO_LPS}
    arrays.update({f"cells{tag}": cells for tag, (_, _, cells) in enumerate(groups, start=1)})
    described = [{"dimension": dimension, "name": names[name]} for dimension, name, _ in groups]
    job = {"task": "write", "mesh": "mesh.npz", "groups": described, "file": f"mesh{suffix}"}
    return run_worker(GMSH_WORKER, job, {"mesh.npz": arrays}).arrays["content"].tobytes()


def _vtu(mesh: TetrahedralMesh) -> bytes:
    """Return the content of a VTU file: tetrahedra, then triangles."""
    points = vtkPoints()
    points.SetData(numpy_to_vtk(mesh.points * RAS_TO_LPS, deep=True))
    kinds = [cells for cells in (mesh.tetrahedra, mesh.triangles) if len(cells)]
    sizes = np.concatenate([np.full(len(cells), cells.shape[1]) for cells in kinds])
    types = np.concatenate([np.full(len(cells), _VTK_TYPES[cells.shape[1]], dtype=np.uint8) for cells in kinds])
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
    grid.GetCellData().AddArray(number_array("group", group))
    for key, texts in (("SPACE", ["LPS"]), ("unit", ["mm"]), ("group_names", names)):
        grid.GetFieldData().AddArray(text_array(key, texts))
    return xml_text(vtkXMLUnstructuredGridWriter(), grid).encode("utf-8")


# ------------------------------------------------------------------ Abaqus


def _abaqus(mesh: TetrahedralMesh, names: dict[str, str]) -> str:
    """Return the text of an .inp file: a surface has the nodes NAME_nodes, and elements NAME_S1 to NAME_S4."""
    points = np.column_stack([np.arange(1, len(mesh.points) + 1), mesh.points * RAS_TO_LPS])
    parts = [
        "*HEADING\nOrgans meshed by vic-registration; LPS (DICOM), mm\n*NODE\n",
        _rows(points, "%d, %.14g, %.14g, %.14g"),
    ]
    kind, numbers = _ABAQUS_TYPES[mesh.tetrahedra.shape[1]], np.arange(1, len(mesh.tetrahedra) + 1)
    for name, rows in mesh.tetrahedron_groups.items():
        table = np.column_stack([numbers[rows], mesh.tetrahedra[rows] + 1])
        parts += [f"*ELEMENT, TYPE={kind}, ELSET={names[name]}\n", _rows(table, ", ".join(["%d"] * table.shape[1]))]
    for name, rows in mesh.triangle_groups.items():
        nodes = np.unique(mesh.triangles[rows]) + 1
        parts += [f"*NSET, NSET={names[name]}_nodes\n", _lists(nodes)]
        parts += _shell(mesh, rows, names[name], name) if name in mesh.shells else _surface(mesh, rows, names[name])
    taken = [*mesh.tetrahedron_groups, *mesh.triangle_groups]
    fixed = names_in_file([*taken, *(f"fixed {name}" for name in mesh.node_groups)], ascii_only=True)
    for name, nodes in mesh.node_groups.items():
        parts += [f"*NSET, NSET={fixed[f'fixed {name}']}\n", _lists(nodes + 1)]
    return "".join(parts)


def _shell(mesh: TetrahedralMesh, rows: np.ndarray, name: str, group: str) -> list[str]:
    """Write a sheet: elements numbered after the tetrahedra, the section with the thickness, and the surface."""
    table = np.column_stack([len(mesh.tetrahedra) + 1 + rows, mesh.triangles[rows] + 1])
    kind = _ABAQUS_TYPES[mesh.triangles.shape[1]]
    return [
        f"*ELEMENT, TYPE={kind}, ELSET={name}\n",
        _rows(table, ", ".join(["%d"] * table.shape[1])),
        f"*SHELL SECTION, ELSET={name}, MATERIAL={name}\n{mesh.shells[group]:g}\n",
        f"*SURFACE, NAME={name}_surface, TYPE=ELEMENT\n{name}, SPOS\n",
    ]


def _surface(mesh: TetrahedralMesh, rows: np.ndarray, name: str) -> list[str]:
    """Write a surface, and the sets of elements with a face in it, by the number of that face."""
    cell, side = _owners(mesh, rows)
    parts, lines = [], []
    for number in range(4):
        mine = np.sort(cell[side == number]) + 1
        if len(mine):
            parts += [f"*ELSET, ELSET={name}_S{number + 1}\n", _lists(mine)]
            lines.append(f"{name}_S{number + 1}, S{number + 1}\n")
    return [*parts, f"*SURFACE, NAME={name}, TYPE=ELEMENT\n", *lines]


def _owners(mesh: TetrahedralMesh, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedron that has each triangle as a face with the normal outward, and the number of that face from 0."""
    # Rotated, not sorted: faces on the two sides of an interface stay different.
    faces = _rotated(mesh.tetrahedra[:, FACES[:, :3]].reshape(-1, 3))
    wanted = _rotated(mesh.triangles[rows][:, :3])
    size = len(mesh.points)
    key = (faces[:, 0] * size + faces[:, 1]) * size + faces[:, 2]
    order = np.argsort(key)
    place = order[np.searchsorted(key[order], (wanted[:, 0] * size + wanted[:, 1]) * size + wanted[:, 2])]
    return place // 4, place % 4


def _rotated(faces: np.ndarray) -> np.ndarray:
    """Rotate the corners of faces so that the smallest one is first."""
    first = np.argmin(faces, axis=1)
    return np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1).astype(np.int64)


def _rows(table: np.ndarray, layout: str) -> str:
    """Return a table as text, a line for each row."""
    text = io.StringIO()
    np.savetxt(text, table, fmt=layout)
    return text.getvalue()


def _lists(numbers: np.ndarray) -> str:
    """Return numbers as text, 16 in a line, which is the most that Abaqus reads."""
    texts = [str(number) for number in numbers.tolist()]
    return "".join(f"{', '.join(texts[start : start + 16])}\n" for start in range(0, len(texts), 16))
