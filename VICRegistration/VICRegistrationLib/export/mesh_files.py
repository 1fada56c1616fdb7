"""Triangles in files that Slicer opens in place: VTP, with the B-spline surface inside, and STL.

Points and normals are LPS mm, marked as Slicer marks them. A VTP file holds these arrays in its field data:

===================== ==================================================================================
``SPACE``             "LPS": frame of the points
``name``              name of the organ
``unit``              "mm"
``degrees``           p and q
``knots_u``           knots in u
``knots_v``           knots in v
``control_net``       n_u * n_v control points with 3 components each; p_ij is row i * n_v + j
``control_net_shape`` n_u and n_v
``control_net_space`` "RAS": frame of the control net
===================== ==================================================================================
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkObject, vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from ..files import reason, replacing
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh

_RAS_TO_LPS = np.array([-1.0, -1.0, 1.0])
_STL_HEADER = b"3D Slicer output. SPACE=LPS"
_STL_HEADER_SIZE = 80
_NUMBERS = ("degrees", "knots_u", "knots_v", "control_net", "control_net_shape")


def polydata(points: np.ndarray, triangles: np.ndarray) -> vtkPolyData:
    """Triangles as VTK data.

    Parameters
    ----------
    points : (n, 3) array_like
    triangles : (m, 3) array_like of int

    Returns
    -------
    vtkPolyData
        With copies of the arrays, in the frame of the points.
    """
    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(np.ascontiguousarray(points, dtype=float), deep=True))
    cells = vtkCellArray()
    cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(triangles, dtype=np.int64).ravel(), deep=True))
    data = vtkPolyData()
    data.SetPoints(vertices)
    data.SetPolys(cells)
    return data


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
    data = polydata(mesh.points * _RAS_TO_LPS, mesh.triangles)
    normals = numpy_to_vtk(np.ascontiguousarray(mesh.normals * _RAS_TO_LPS), deep=True)
    normals.SetName("Normals")
    data.GetPointData().SetNormals(normals)
    net = surface.control_net
    for key, text in (("SPACE", "LPS"), ("name", name), ("unit", "mm"), ("control_net_space", "RAS")):
        _add_text(data, key, text)
    numbers = (surface.degrees, surface.knots_u, surface.knots_v, net.reshape(-1, 3), net.shape[:2])
    for key, values in zip(_NUMBERS, numbers):
        _add_numbers(data, key, values)
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
    data = _field_data(path)
    found = {key: data.GetArray(key) for key in _NUMBERS}
    missing = [key for key, array in found.items() if array is None]
    if missing:
        msg = f"The file {path} lacks {', '.join(missing)} in its field data; give a VTP file as the program writes it."
        raise ValueError(msg)
    frame = data.GetAbstractArray("control_net_space")
    if not isinstance(frame, vtkStringArray) or frame.GetNumberOfValues() != 1 or frame.GetValue(0) != "RAS":
        msg = f"The file {path} does not say that its control net is in RAS; convert it, and say so."
        raise ValueError(msg)
    numbers = {key: vtk_to_numpy(array) for key, array in found.items()}
    try:
        net = numbers["control_net"].reshape(*numbers["control_net_shape"], 3)
        degrees = tuple(int(degree) for degree in numbers["degrees"])
        return BSplineSurface(degrees, numbers["knots_u"], numbers["knots_v"], net)
    except (ValueError, TypeError) as error:
        msg = f"The file {path} holds no surface: {reason(error)}."
        raise ValueError(msg) from error


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


def _add_text(data: vtkPolyData, key: str, text: str) -> None:
    array = vtkStringArray()
    array.SetName(key)
    array.InsertNextValue(text)
    data.GetFieldData().AddArray(array)


def _add_numbers(data: vtkPolyData, key: str, values) -> None:
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName(key)
    data.GetFieldData().AddArray(array)


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
