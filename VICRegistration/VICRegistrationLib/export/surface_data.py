"""Triangles as VTK data that carry the B-spline surface they were made of, in their field data.

===================== ==================================================================================
``name``              name of the organ
``unit``              "mm"
``degrees``           p and q
``knots_u``           knots in u
``knots_v``           knots in v
``control_net``       n_u * n_v control points with 3 components each; p_ij is row i * n_v + j
``control_net_shape`` n_u and n_v
``control_net_space`` "RAS": frame of the control net, whatever that of the points is
===================== ==================================================================================
"""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkFieldData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkTriangleFilter

from ..files import reason
from ..geometry.polydata import polydata
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh
from ..geometry.validity import check_place

_NUMBERS = ("degrees", "knots_u", "knots_v", "control_net", "control_net_shape")


def triangles_in(data: vtkPolyData) -> tuple[np.ndarray, np.ndarray]:
    """Take triangles out of VTK data; polygons and strips are cut into triangles.

    Parameters
    ----------
    data : vtkPolyData

    Returns
    -------
    points : (n, 3) ndarray
        In the frame of the data.
    triangles : (m, 3) ndarray of int
        Both are empty where the data holds neither polygons nor strips.
    """
    cut = vtkTriangleFilter()
    cut.PassLinesOff()
    cut.PassVertsOff()
    cut.SetInputData(data)
    cut.Update()
    found = cut.GetOutput()
    if not found.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    triangles = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)
    return vtk_to_numpy(found.GetPoints().GetData()).astype(float), triangles


def polydata_of_mesh(mesh: TriangleMesh, *, axes: np.ndarray = (1.0, 1.0, 1.0)) -> vtkPolyData:
    """Triangles with their normals as VTK data.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    axes : (3,) array_like
        Signs that points and normals are multiplied by: (-1, -1, 1) for LPS. An even number of them may be negative,
        or the triangles would be turned inside out.

    Returns
    -------
    vtkPolyData
    """
    data = polydata(mesh.points * np.asarray(axes), mesh.triangles)
    normals = numpy_to_vtk(np.ascontiguousarray(mesh.normals * np.asarray(axes)), deep=True)
    normals.SetName("Normals")
    data.GetPointData().SetNormals(normals)
    return data


def add_surface(data: vtkPolyData, surface: BSplineSurface, *, name: str, role: str = "") -> None:
    """Put a surface into the field data of triangles.

    Parameters
    ----------
    data : vtkPolyData
    surface : BSplineSurface
        RAS mm.
    name : str
        Name of the organ.
    role : str
        Prefix of the arrays' names, for a second surface beside that of the triangles.
    """
    for key, text in (("name", name), ("unit", "mm"), ("control_net_space", "RAS")):
        add_text(data, role + key, text)
    net = surface.control_net
    numbers = (surface.degrees, surface.knots_u, surface.knots_v, net.reshape(-1, 3), net.shape[:2])
    for key, values in zip(_NUMBERS, numbers):
        array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(role + key)
        data.GetFieldData().AddArray(array)


def surface_in(data: vtkFieldData, where: str, *, remedy: str, role: str = "") -> BSplineSurface:
    """Take a surface out of field data.

    Parameters
    ----------
    data : vtkFieldData
    where : str
        What holds it, for messages: "file bladder.vtp".
    remedy : str
        What to do if it lacks a surface, for messages: "give another file".
    role : str
        As for :func:`add_surface`.

    Returns
    -------
    BSplineSurface
        RAS mm.

    Raises
    ------
    ValueError
        If there is none.
    """
    found = {key: data.GetArray(role + key) for key in _NUMBERS}
    missing = [key for key, array in found.items() if array is None]
    if missing:
        msg = f"The {where} lacks {', '.join(missing)} in its field data; {remedy}."
        raise ValueError(msg)
    frame = data.GetAbstractArray(role + "control_net_space")
    if not isinstance(frame, vtkStringArray) or frame.GetNumberOfValues() != 1 or frame.GetValue(0) != "RAS":
        msg = f"The {where} does not say that its control net is in RAS; convert it, and say so."
        raise ValueError(msg)
    numbers = {key: vtk_to_numpy(array) for key, array in found.items()}
    try:
        net = numbers["control_net"].reshape(*numbers["control_net_shape"], 3)
        degrees = tuple(int(degree) for degree in numbers["degrees"])
        surface = BSplineSurface(degrees, numbers["knots_u"], numbers["knots_v"], net)
        check_place(surface)
    except (ValueError, TypeError) as error:
        msg = f"The {where} holds no surface: {reason(error)}."
        raise ValueError(msg) from error
    return surface


def add_text(data: vtkPolyData, key: str, text: str) -> None:
    """Put a text into the field data of triangles."""
    array = vtkStringArray()
    array.SetName(key)
    array.InsertNextValue(text)
    data.GetFieldData().AddArray(array)


def xml_text(writer, data) -> str:
    """Write data as VTK's XML into memory: Python notices a full disk, VTK does not.

    Parameters
    ----------
    writer : vtkXMLWriter
        Of the kind of the data.
    data : vtkDataObject

    Returns
    -------
    str
    """
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    return writer.GetOutputString()
