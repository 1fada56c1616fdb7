"""Triangles in files that Slicer opens in place: VTP, with the B-spline surface inside, STL and PLY.

Points and normals are LPS mm, marked as Slicer marks them: STL and PLY files say SPACE=LPS in their headers, a VTP file
has the text ``SPACE``, "LPS", in its field data, beside the surface as :mod:`.surface_data` puts it there.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkStringArray
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from ..files import reason, replacing
from ..geometry.surface import BSplineSurface
from ..geometry.surface_file import SurfaceRecord
from ..geometry.triangles import area_vectors
from ..geometry.triangulation import TriangleMesh, triangulate
from .frames import RAS_TO_LPS
from .surface_data import add_surface, add_text, polydata_of_mesh, surface_in
from .vtk_xml import silent_vtk, xml_text

MESH_SUFFIXES = (".stl", ".ply", ".vtp")
DEFAULT_CHORD_ERROR = 0.05
_HEADER = b"3D Slicer output. SPACE=LPS"
_STL_HEADER_SIZE = 80


def write_mesh(
    surface: BSplineSurface, path: str | os.PathLike, *, name: str, chord_error: float = DEFAULT_CHORD_ERROR
) -> None:
    """Write the triangles of a surface in the format that the file's name asks for.

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
        If the name asks for another format, or the chord error is not positive.
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        msg = f"The file {path} was asked for; its name must end in one of {', '.join(MESH_SUFFIXES)}."
        raise ValueError(msg)
    mesh = triangulate(surface, chord_error=chord_error)
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
        RAS mm; goes into the field data described above, so that nothing is lost.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ.
    scalars : mapping of str to (n,) ndarray, optional
        Numbers at the points by their names, such as "Deviation"; the first is what programs show.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    data = polydata_of_mesh(mesh, axes=RAS_TO_LPS)
    for key, values in (scalars or {}).items():
        array = numpy_to_vtk(np.ascontiguousarray(values, dtype=float), deep=True)
        array.SetName(key)
        data.GetPointData().AddArray(array)
    if scalars:
        data.GetPointData().SetActiveScalars(next(iter(scalars)))
    add_text(data, "SPACE", "LPS")
    add_surface(data, surface, name=name)
    text = xml_text(vtkXMLPolyDataWriter(), data)
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")


def read_vtp_surface(path: str | os.PathLike) -> BSplineSurface:
    """Read the B-spline surface of a VTP file.

    Parameters
    ----------
    path : path
        File written by :func:`write_vtp`, or by Slicer from a model made of one.

    Returns
    -------
    BSplineSurface
        RAS mm.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it holds no surface.
    """
    path = Path(path)
    try:
        path.open("rb").close()
    except OSError as error:
        msg = f"The file {path} cannot be read ({reason(error)}); give a file that exists."
        raise OSError(msg) from error
    return surface_in(_field_data(path), f"file {path}", remedy="give a VTP file as the program writes it")


def read_vtp_record(path: str | os.PathLike) -> SurfaceRecord:
    """Read the B-spline surface of a VTP file with its name.

    Parameters
    ----------
    path : path
        As in :func:`read_vtp_surface`.

    Returns
    -------
    SurfaceRecord
        The name is empty where the file tells none; net and closure are empty.

    Raises
    ------
    OSError, ValueError
        As in :func:`read_vtp_surface`.
    """
    surface = read_vtp_surface(path)
    name = _field_data(Path(path)).GetAbstractArray("name")
    told = isinstance(name, vtkStringArray) and name.GetNumberOfValues() == 1
    return SurfaceRecord(surface, name.GetValue(0) if told else "")


def write_stl(mesh: TriangleMesh, path: str | os.PathLike, *, name: str) -> None:
    """Write triangles as a binary STL file.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ, appended to the header as far as there is room.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    points = mesh.points * RAS_TO_LPS
    corners, normals = points[mesh.triangles], area_vectors(points, mesh.triangles)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    layout = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    facets = np.zeros(len(corners), dtype=layout)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    facets["corners"] = corners
    header = _HEADER + b" " + name.encode("ascii", "replace")
    count = np.array(len(facets), dtype="<u4")
    with replacing(path) as draft:
        draft.write_bytes(header[:_STL_HEADER_SIZE].ljust(_STL_HEADER_SIZE) + count.tobytes() + facets.tobytes())


def write_ply(mesh: TriangleMesh, path: str | os.PathLike, *, name: str) -> None:
    """Write triangles with the normals of the exact surface as a binary PLY file.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    path : path
        File to write; its folder must exist.
    name : str
        Name of the organ, a comment of the header.

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    vertices = np.hstack([mesh.points * RAS_TO_LPS, mesh.normals * RAS_TO_LPS]).astype("<f4")
    faces = np.zeros(len(mesh.triangles), dtype=[("corners", "u1"), ("triangle", "<i4", 3)])
    faces["corners"], faces["triangle"] = 3, mesh.triangles
    lines = [
        b"ply",
        b"format binary_little_endian 1.0",
        b"comment " + _HEADER,
        # A comment ends with its line, whatever the name is.
        b"comment " + " ".join(name.split()).encode("ascii", "replace"),
        b"element vertex %d" % len(vertices),
        *(b"property float " + key for key in (b"x", b"y", b"z", b"nx", b"ny", b"nz")),
        b"element face %d" % len(faces),
        b"property list uchar int vertex_indices",
        b"end_header",
    ]
    with replacing(path) as draft:
        draft.write_bytes(b"\n".join(lines) + b"\n" + vertices.tobytes() + faces.tobytes())


def _field_data(path: Path):
    """Field data of a VTP file; empty if it is none."""
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(path))
    with silent_vtk():
        reader.Update()
    return reader.GetOutput().GetFieldData()
