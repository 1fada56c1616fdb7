"""Mesh files: VTP, with the B-spline surface inside, STL and PLY. Slicer shows them at the right place.

Points and normals are LPS mm. As Slicer does, STL and PLY files have SPACE=LPS in their headers, and VTP files the text
``SPACE``, "LPS", in their field data, beside the surface (see :mod:`.surface_data`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from vtkmodules.vtkIOGeometry import vtkSTLWriter
from vtkmodules.vtkIOPLY import vtkPLYWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

from ..files import replacing, write_text
from ..frames import RAS_TO_LPS
from ..geometry.polydata import polydata
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh, triangulate
from ..imaging.library_messages import silent_vtk
from .surface_data import add_surface, add_text, number_array, polydata_of_mesh, xml_text

MESH_SUFFIXES = (".stl", ".ply", ".vtp")
DEFAULT_CHORD_ERROR = 0.05
_HEADER = "3D Slicer output. SPACE=LPS"


def write_mesh(
    surface: BSplineSurface, path: str | os.PathLike, *, name: str, chord_error: float = DEFAULT_CHORD_ERROR
) -> None:
    """Write the triangles of a surface in the format of the file's suffix.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm.
    path : path
        File to write: .stl, .ply or .vtp; its folder must exist.
    name : str
        Name of the organ.
    chord_error : float
        Largest distance between triangles and surface, mm.

    Raises
    ------
    ValueError
        If the suffix is another one, or the chord error is not positive.
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    write_triangles(triangulate(surface, chord_error=chord_error), surface, path, name=name)


def write_triangles(mesh: TriangleMesh, surface: BSplineSurface, path: str | os.PathLike, *, name: str) -> None:
    """Write triangles in the format of the file's suffix.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    surface : BSplineSurface
        The surface that they were made of; a .vtp file holds it too. RAS mm.
    path, name
        As for :func:`write_mesh`.

    Raises
    ------
    ValueError, OSError
        As :func:`write_mesh`.
    """
    suffix = _suffix(path)
    if suffix == ".vtp":
        write_vtp(mesh, surface, path, name=name)
    else:
        {".stl": write_stl, ".ply": write_ply}[suffix](mesh, path, name=name)


def write_vtp(
    mesh: TriangleMesh,
    surface: BSplineSurface,
    path: str | os.PathLike,
    *,
    name: str,
    scalars: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write triangles and the surface they were made of as a VTP file.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    surface : BSplineSurface
        RAS mm; it is stored exactly in the field data.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ.
    scalars : mapping of str to (n,) ndarray, optional
        Numbers at the points by their names, such as "Deviation"; the first is the active one.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    data = polydata_of_mesh(mesh, axes=RAS_TO_LPS)
    for key, values in (scalars or {}).items():
        data.GetPointData().AddArray(number_array(key, np.asarray(values, dtype=float)))
    if scalars:
        data.GetPointData().SetActiveScalars(next(iter(scalars)))
    add_text(data, "SPACE", "LPS")
    add_surface(data, surface, name=name)
    write_text(path, xml_text(vtkXMLPolyDataWriter(), data))


def write_stl(mesh: TriangleMesh, path: str | os.PathLike, *, name: str) -> None:
    """Write triangles as a binary STL file.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ, appended to the header and cut off where that is full.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    writer = vtkSTLWriter()
    writer.SetHeader(f"{_HEADER} {name}".encode("ascii", "replace").decode("ascii"))
    _write_binary(writer, mesh, path, header_end=b"", least_size=84 + 50 * len(mesh.triangles))


def write_ply(mesh: TriangleMesh, path: str | os.PathLike, *, name: str) -> None:
    """Write triangles as a binary PLY file.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ, for a comment in the header.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    writer = vtkPLYWriter()
    # A comment is one line: line breaks in the name become blanks.
    for comment in (_HEADER, " ".join(name.split())):
        writer.AddComment(comment.encode("ascii", "replace").decode("ascii"))
    least_size = 12 * len(mesh.points) + 13 * len(mesh.triangles)
    _write_binary(writer, mesh, path, header_end=b"end_header\n", least_size=least_size)


def _write_binary(writer, mesh: TriangleMesh, path: str | os.PathLike, *, header_end: bytes, least_size: int) -> None:
    """Write by a writer of VTK. It does not report a full disk, so the size after the header is checked."""
    writer.SetInputData(polydata(mesh.points * RAS_TO_LPS, mesh.triangles))
    writer.SetFileTypeToBinary()
    with replacing(path) as draft:
        writer.SetFileName(os.fspath(draft))
        with silent_vtk():
            writer.Write()
        content = draft.read_bytes() if draft.is_file() else b""
        if len(content[content.find(header_end) + len(header_end) :]) < least_size:
            msg = "the disk is full"
            raise OSError(msg)


def _suffix(path: str | os.PathLike) -> str:
    """Return the suffix of a file, or refuse one that is of no format."""
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        msg = f"The file {path} was asked for; its name must end in one of {', '.join(MESH_SUFFIXES)}."
        raise ValueError(msg)
    return suffix
