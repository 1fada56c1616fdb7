"""Surfaces as model nodes: triangles that are shown, and the control net in the field data of the polydata.

Hardened transforms and filters move the triangles and leave the field data as it is. So a stored net is valid only if
the triangles lie on its surface, or on an affine image of it; that image then is the surface.
"""

from __future__ import annotations

import numpy as np
import slicer
from slicer.i18n import tr as _
from vtk.util.numpy_support import vtk_to_numpy

from .colors import STANDARD_DEVIATION, addScalars, exchangePolyData
from .volumes import linearRelation, worldPoints

# Triangles stay this close to the surface, mm.
_CHORD_ERROR_MM = 0.1
_SLICE_THICKNESS_PX = 2
_UNCORRECTED = "uncorrected_"
# Triangles this close to a surface, mm, are its own; single precision in a file moves them by less.
_OWN_MM = 1e-2
_CHECKED_POINTS = 64
# Grid of a surface that moves during a fit: its triangles keep their parameters; fine enough for every organ.
_MOVING_RESOLUTION = (64, 40)


def createModel(name, color):
    """Make an empty model node that is shown in 3D and as a contour in slice views.

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
    """Show a surface in a model, and store its control net there.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    surface : VICRegistrationLib.geometry.surface.BSplineSurface
        Local RAS mm of the node.
    name : str
        Name of the organ, stored beside the surface.
    uncorrected : VICRegistrationLib.geometry.surface.BSplineSurface, optional
        The surface before boundary points corrected it; stored as well.
    standardDeviation : callable, optional
        Returns the standard deviation of the surface along its normal, (n,) mm, at surface parameters, (n, 2); stored
        as point scalars, so that the model can be coloured by it.
    """
    from ..export.surface_data import add_surface, polydata_of_mesh
    from ..geometry.triangulation import triangulate

    mesh = triangulate(surface, chord_error=_CHORD_ERROR_MM)
    data = polydata_of_mesh(mesh)
    add_surface(data, surface, name=name)
    if uncorrected is not None:
        add_surface(data, uncorrected, name=name, role=_UNCORRECTED)
    if standardDeviation is not None:
        addScalars(data, STANDARD_DEVIATION, standardDeviation(mesh.parameters))
    exchangePolyData(modelNode, data)


def moveSurface(modelNode, surface):
    """Show a surface that is being fitted: fast, and without storing its control net.

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
    """Whether triangles are those of an earlier step; those of a finished fit stay for when this one is cancelled."""
    return (
        data is not None
        and data.GetNumberOfPoints() == count
        and data.GetPointData().GetNormals() is not None
        and not data.GetFieldData().HasArray("control_net")
    )


def surfaceIfAny(modelNode):
    """Surface that a model stores and shows, if there is one.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode

    Returns
    -------
    VICRegistrationLib.geometry.surface.BSplineSurface or None
        As of :func:`surfaceFromModel`; also None if another module has changed the triangles.
    """
    try:
        return surfaceFromModel(modelNode)
    except ValueError:
        return None


def surfaceOf(organ, *, corrected=True):
    """Surface of an organ.

    Parameters
    ----------
    organ : OrganParameters
    corrected : bool
        As boundary points have pulled it, or as it was before.

    Returns
    -------
    VICRegistrationLib.geometry.surface.BSplineSurface
        As of :func:`surfaceFromModel`.

    Raises
    ------
    ValueError
        If it has none yet, or as :func:`surfaceFromModel`.
    """
    if organ.surface is None:
        raise ValueError(_("The organ {name} has no surface yet. Fit it first.").format(name=organ.label))
    return surfaceFromModel(organ.surface, corrected=corrected)


def surfaceFromModel(modelNode, *, corrected=True):
    """Surface that a model stores.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    corrected : bool
        As boundary points have pulled it, or as it was before.

    Returns
    -------
    VICRegistrationLib.geometry.surface.BSplineSurface
        Local RAS mm of the node, bit for bit as it was fitted; moved if a linear transform was hardened.

    Raises
    ------
    ValueError
        If the model stores none, or its triangles are no longer those of its surface.
    """
    from ..export.surface_data import surface_in

    data = modelNode.GetPolyData() if modelNode is not None else None
    name = modelNode.GetName() if modelNode is not None else ""
    if data is None:
        raise ValueError(_("The model {name} is empty; a fitted surface is needed. Fit the organ.").format(name=name))
    fields = data.GetFieldData()
    where, remedy = _("model {name}").format(name=name), _("fit the organ")
    shown = surface_in(fields, where, remedy=remedy)
    matrix = _matrixTo(data, shown)
    if matrix is None:
        raise ValueError(
            _(
                "The triangles of the model {name} have been changed, by hardening a nonlinear transform or by "
                "another module; those of its B-spline surface are needed. Fit the organ again."
            ).format(name=name)
        )
    uncorrected = not corrected and fields.HasArray(_UNCORRECTED + "control_net")
    surface = surface_in(fields, where, remedy=remedy, role=_UNCORRECTED) if uncorrected else shown
    return movedSurface(surface, matrix)


def _matrixTo(data, surface):
    """Affine map, (4, 4), from a surface to its present triangles; None if they are no affine image of it."""
    from ..geometry.projection import closest_points
    from ..geometry.triangulation import triangulate

    if not data.GetNumberOfPoints():
        return None
    points = vtk_to_numpy(data.GetPoints().GetData()).astype(float)
    places = triangulate(surface, chord_error=_CHORD_ERROR_MM).points
    matrix = affineMap(places, points) if len(places) == len(points) else None
    if matrix is not None:
        return matrix
    # Perhaps another triangulation of the same surface, such as one from a file; slower to check.
    some = points[:: max(len(points) // _CHECKED_POINTS, 1)]
    return np.eye(4) if np.abs(closest_points(surface, some).distances).max() <= _OWN_MM else None


def movedSurface(surface, matrix):
    """Surface moved by an affine map, with its normals outward even if the map mirrors it.

    Parameters
    ----------
    surface : VICRegistrationLib.geometry.surface.BSplineSurface
    matrix : (4, 4) ndarray

    Returns
    -------
    VICRegistrationLib.geometry.surface.BSplineSurface
        The same object for the identity.
    """
    if np.array_equal(matrix, np.eye(4)):
        return surface
    moved = surface.transformed(matrix)
    return moved.turned() if np.linalg.det(matrix[:3, :3]) < 0.0 else moved


def affineMap(before, now):
    """Affine map that points were moved by.

    Parameters
    ----------
    before, now : (n, 3) ndarray
        mm.

    Returns
    -------
    (4, 4) ndarray or None
        The identity if no point has moved by more than the rounding of a file in single precision. None if no affine
        map takes the points that close to where they are now.
    """
    if np.abs(before - now).max() <= _OWN_MM:
        return np.eye(4)
    matrix = np.eye(4)
    matrix[:3] = np.linalg.lstsq(np.column_stack([before, np.ones(len(before))]), now, rcond=None)[0].T
    return matrix if np.abs(before @ matrix[:3, :3].T + matrix[:3, 3] - now).max() <= _OWN_MM else None


def worldVolumeMl(modelNode, surface):
    """Volume that a surface encloses in world coordinates.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    surface : VICRegistrationLib.geometry.surface.BSplineSurface
        The one that the model stores.

    Returns
    -------
    float
        Millilitres; exact under linear transforms, the volume inside the triangles under others.
    """
    from ..export.surface_data import triangles_in
    from ..geometry.triangles import enclosed_volume

    matrix = linearRelation(modelNode.GetParentTransformNode(), None)
    if matrix is not None:
        return surface.volume() * abs(np.linalg.det(matrix)) / 1000.0
    points, triangles = triangles_in(modelNode.GetPolyData())
    return abs(enclosed_volume(worldPoints(modelNode, points), triangles)) / 1000.0
