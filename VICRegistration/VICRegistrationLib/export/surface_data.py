"""VTK data of triangles, with the B-spline surface that they were made of in the field data.

===================== ==================================================================================
``name``              name of the organ
``unit``              "mm"
``degrees``           p and q
``knots_u``           knots in u
``knots_v``           knots in v
``control_net``       n_u * n_v control points with 3 components each; p_ij is row i * n_v + j
``control_net_shape`` n_u and n_v
``control_net_space`` "RAS": frame of the control net; the points may have another one
===================== ==================================================================================
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDataArray, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkFieldData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkTriangleFilter

from ..files import reason
from ..geometry.polydata import polydata
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh
from ..geometry.validity import check_place

_NUMBERS = ("degrees", "knots_u", "knots_v", "control_net", "control_net_shape")


def triangles_in(data: vtkPolyData) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of VTK data; polygons and strips are cut into triangles.

    Parameters
    ----------
    data : vtkPolyData

    Returns
    -------
    points : (n, 3) ndarray
        In the frame of the data.
    triangles : (m, 3) ndarray of int
        Both are empty if the data has neither polygons nor strips.
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
    """Make VTK data of triangles with their normals.

    Parameters
    ----------
    mesh : TriangleMesh
        RAS mm.
    axes : (3,) array_like
        Signs that points and normals are multiplied by: (-1, -1, 1) for LPS. The number of negative ones must be even,
        or the triangles would be inside out.

    Returns
    -------
    vtkPolyData
    """
    data = polydata(mesh.points * np.asarray(axes), mesh.triangles)
    data.GetPointData().SetNormals(number_array("Normals", mesh.normals * np.asarray(axes)))
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
        data.GetFieldData().AddArray(number_array(role + key, values))


def surface_in(data: vtkFieldData, where: str, *, remedy: str, role: str = "") -> BSplineSurface:
    """Return the surface in field data.

    Parameters
    ----------
    data : vtkFieldData
    where : str
        What holds it, for messages: "file bladder.vtp".
    remedy : str
        What to do if there is no surface, for messages: "give another file".
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
    data.GetFieldData().AddArray(text_array(key, [text]))


def text_array(name: str, texts: Sequence[str]) -> vtkStringArray:
    """Make a named VTK array of texts."""
    array = vtkStringArray()
    array.SetName(name)
    array.SetNumberOfValues(len(texts))
    for number, text in enumerate(texts):
        array.SetValue(number, text)
    return array


def number_array(name: str, values: np.ndarray) -> vtkDataArray:
    """Make a named VTK array of numbers (n,), or of n tuples (n, k); a copy."""
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName(name)
    return array


def xml_text(writer, data) -> str:
    """Return data as the text of VTK's XML file. Python writes it, because VTK does not report a full disk.

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
