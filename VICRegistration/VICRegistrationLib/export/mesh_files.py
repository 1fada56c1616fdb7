"""Triangles in files that Slicer opens in place: VTP, with the B-spline surface inside, and STL.

Points and normals are LPS mm, marked as Slicer marks them: a VTP file has the text ``SPACE``, "LPS", in its field data,
beside the surface as :mod:`.surface_data` puts it there.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from vtkmodules.vtkCommonCore import vtkObject
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from ..files import reason, replacing
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh
from .surface_data import add_surface, add_text, polydata_of_mesh, surface_in

_RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
_STL_HEADER = b"3D Slicer output. SPACE=LPS"
_STL_HEADER_SIZE = 80


def write_vtp(mesh: TriangleMesh, surface: BSplineSurface, path: str | os.PathLike, *, name: str) -> None:
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

    Raises
    ------
    OSError
        If the file cannot be written; a file of that name is left as it was.
    """
    data = polydata_of_mesh(mesh, axes=_RAS_TO_LPS)
    add_text(data, "SPACE", "LPS")
    add_surface(data, surface, name=name)
    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    # Into memory first: a full disk is then noticed by Python, which says so.
    writer.WriteToOutputStringOn()
    writer.Write()
    with replacing(path) as draft:
        draft.write_text(writer.GetOutputString(), encoding="utf-8")


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
    corners = (mesh.points * _RAS_TO_LPS)[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    layout = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    facets = np.zeros(len(corners), dtype=layout)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    facets["corners"] = corners
    header = _STL_HEADER + b" " + name.encode("ascii", "replace")
    count = np.array(len(facets), dtype="<u4")
    with replacing(path) as draft:
        draft.write_bytes(header[:_STL_HEADER_SIZE].ljust(_STL_HEADER_SIZE) + count.tobytes() + facets.tobytes())


def _field_data(path: Path):
    """Field data of a VTP file; empty if it is none."""
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(path))
    shown = vtkObject.GetGlobalWarningDisplay()
    # What is wrong is told by the caller, in one sentence.
    vtkObject.SetGlobalWarningDisplay(0)
    try:
        reader.Update()
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
    return reader.GetOutput().GetFieldData()
