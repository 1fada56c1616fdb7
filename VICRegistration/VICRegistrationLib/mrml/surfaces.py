"""Surfaces as model nodes: triangles to look at, the control net in the polydata's field data."""

from __future__ import annotations

import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import vtk_to_numpy

from .colors import STANDARD_DEVIATION, addNumbers, exchangePolyData

# Triangles stay this close to the surface, mm.
_CHORD_ERROR_MM = 0.1
_SLICE_THICKNESS_PX = 2
_UNCORRECTED = "uncorrected_"
# While a surface moves its triangles keep their places on it: as many as suit every organ.
_MOVING_RESOLUTION = (64, 40)


def createModel(name, color):
    """Make an empty model node that is seen in 3D and as a contour in the slices.

    Parameters
    ----------
    name : str
    color : (r, g, b)
        0 to 1.

    Returns
    -------
    vtkMRMLModelNode
    """
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", name)
    node.CreateDefaultDisplayNodes()
    display = node.GetDisplayNode()
    display.SetColor(*color)
    display.SetVisibility2D(True)
    display.SetSliceIntersectionThickness(_SLICE_THICKNESS_PX)
    return node


def showSurface(modelNode, surface, *, name, uncorrected=None, standardDeviation=None):
    """Let a model show a surface, and carry it.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    surface : VICRegistrationLib.geometry.surface.BSplineSurface
        Local RAS mm of the node.
    name : str
        Name of the organ, stored beside the surface.
    uncorrected : VICRegistrationLib.geometry.surface.BSplineSurface, optional
        What it was before boundary points pulled it; carried as well.
    standardDeviation : callable, optional
        Takes surface parameters, (n, 2), to the standard deviation of the surface along its normal there, (n,) mm; the
        points of the model carry it, to be coloured by.
    """
    from ..export.surface_data import add_surface, polydata_of_mesh
    from ..geometry.triangulation import triangulate

    mesh = triangulate(surface, chord_error=_CHORD_ERROR_MM)
    data = polydata_of_mesh(mesh)
    add_surface(data, surface, name=name)
    if uncorrected is not None:
        add_surface(data, uncorrected, name=name, role=_UNCORRECTED)
    if standardDeviation is not None:
        addNumbers(data, STANDARD_DEVIATION, standardDeviation(mesh.parameters))
    exchangePolyData(modelNode, data)


def moveSurface(modelNode, surface):
    """Let a model follow a surface that is being fitted: fast, and without the control net.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    surface : VICRegistrationLib.geometry.surface.BSplineSurface
        Local RAS mm of the node.
    """
    from ..export.surface_data import polydata_of_mesh
    from ..geometry.triangulation import triangulate

    mesh = triangulate(surface, resolution=_MOVING_RESOLUTION)
    data = modelNode.GetPolyData()
    if not _isMoving(data, len(mesh.points)):
        exchangePolyData(modelNode, polydata_of_mesh(mesh))
        return
    vtk_to_numpy(data.GetPointData().GetNormals())[:] = mesh.normals
    data.GetPointData().GetNormals().Modified()
    vtk_to_numpy(data.GetPoints().GetData())[:] = mesh.points
    data.GetPoints().Modified()
    data.Modified()


def _isMoving(data, count):
    """Whether triangles are those of an earlier step; those of a finished fit must stay, for when this is cancelled."""
    return (
        data is not None
        and data.GetNumberOfPoints() == count
        and data.GetPointData().GetNormals() is not None
        and not data.GetFieldData().HasArray("control_net")
    )


def carriesSurface(modelNode):
    """Whether a model carries a B-spline surface.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode

    Returns
    -------
    bool
    """
    data = modelNode.GetPolyData()
    return data is not None and bool(data.GetFieldData().HasArray("control_net"))


def surfaceFromModel(modelNode, *, corrected=True):
    """Surface that a model carries.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    corrected : bool
        As boundary points have pulled it, or as it was before.

    Returns
    -------
    VICRegistrationLib.geometry.surface.BSplineSurface
        Local RAS mm of the node, bit for bit as it was fitted.

    Raises
    ------
    ValueError
        If the model carries none.
    """
    from ..export.surface_data import surface_in

    data = modelNode.GetPolyData() if modelNode is not None else None
    name = modelNode.GetName() if modelNode is not None else ""
    if data is None:
        raise ValueError(_("The model {name} is empty; a fitted surface is needed. Fit the organ.").format(name=name))
    fields = data.GetFieldData()
    role = "" if corrected or not fields.HasArray(_UNCORRECTED + "control_net") else _UNCORRECTED
    return surface_in(fields, _("model {name}").format(name=name), remedy=_("fit the organ"), role=role)


def isAlone(modelNode):
    """Whether a model is the only one that is seen in 3D, but for the slices.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode

    Returns
    -------
    bool
    """
    others = [node for node in slicer.util.getNodesByClass("vtkMRMLModelNode") if node is not modelNode]
    shown = [node for node in others if node.GetDisplayNode() is not None and node.GetDisplayNode().GetVisibility()]
    return not [node for node in shown if not slicer.vtkMRMLSliceLogic.IsSliceModelNode(node)]


def worldVolumeMl(modelNode, surface):
    """Volume that a surface encloses where its model lies in the world.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    surface : VICRegistrationLib.geometry.surface.BSplineSurface
        The one the model carries.

    Returns
    -------
    float
        Millilitres: exact under linear transforms, that of the triangles under others.
    """
    parent = modelNode.GetParentTransformNode()
    if parent is None:
        return surface.volume() / 1000.0
    if parent.IsTransformToWorldLinear():
        matrix = vtk.vtkMatrix4x4()
        parent.GetMatrixTransformToWorld(matrix)
        return surface.volume() * abs(matrix.Determinant()) / 1000.0
    toWorld = vtk.vtkGeneralTransform()
    parent.GetTransformToWorld(toWorld)
    moved = vtk.vtkTransformPolyDataFilter()
    moved.SetTransform(toWorld)
    moved.SetInputData(modelNode.GetPolyData())
    properties = vtk.vtkMassProperties()
    properties.SetInputConnection(moved.GetOutputPort())
    return properties.GetVolume() / 1000.0
