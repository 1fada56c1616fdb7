"""References that a surface is compared with: segments and other models, brought into its local frame."""

from __future__ import annotations

import numpy as np
import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import vtk_to_numpy

from .surfaces import surfaceIfAny
from .volumes import linearRelation, transformedPoints

# Chord error, mm, of the triangles that stand for an exact surface under a nonlinear transform.
_CHORD_ERROR_MM = 0.02


def referenceFor(modelNode, reference, segmentId=""):
    """Bring a reference into the local frame of a model.

    Parameters
    ----------
    modelNode : vtkMRMLModelNode
    reference : vtkMRMLSegmentationNode or vtkMRMLModelNode
        Under any transform.
    segmentId : str
        ID of the segment in a segmentation.

    Returns
    -------
    BSplineSurface or ReferenceMesh
        Local RAS mm of the model. A model that stores a B-spline surface is taken by that, not by its triangles,
        except under a nonlinear transform. A segment is taken by its voxels, on its own grid and without smoothing.

    Raises
    ------
    ValueError
        If there is no reference, it is the model itself, or it has nothing to measure against.
    """
    if reference is None or reference.GetScene() is None:
        raise ValueError(_("No reference is chosen. Choose one to compare with: a segment or a model."))
    if reference is modelNode:
        raise ValueError(
            _("The model {name} is the surface of the organ itself. Choose another one to compare it with.").format(
                name=reference.GetName()
            )
        )
    if reference.IsA("vtkMRMLSegmentationNode"):
        found = _meshOfSegment(reference, segmentId)
    elif reference.IsA("vtkMRMLModelNode"):
        surface = surfaceIfAny(reference)
        found = _meshOfModel(reference) if surface is None else surface
    else:
        raise ValueError(
            _("The input {name} is no reference; a segmentation or a model of the scene is needed.").format(
                name=reference.GetName()
            )
        )
    return _moved(found, reference.GetParentTransformNode(), modelNode.GetParentTransformNode())


def referenceName(reference, segmentId=""):
    """Name of a reference for a table.

    Parameters
    ----------
    reference : vtkMRMLSegmentationNode or vtkMRMLModelNode
    segmentId : str

    Returns
    -------
    str
        "segmentation: segment", or the name of the model.
    """
    if not reference.IsA("vtkMRMLSegmentationNode"):
        return reference.GetName()
    return f"{reference.GetName()}: {reference.GetSegmentation().GetSegment(segmentId).GetName()}"


def segmentIdOf(reference, segment=None):
    """ID of a segment that is given by its ID or its name, or of the only segment.

    Parameters
    ----------
    reference : vtkMRMLNode
    segment : str, optional

    Returns
    -------
    str
        Empty if the reference is no segmentation or has no such segment.
    """
    if reference is None or not reference.IsA("vtkMRMLSegmentationNode"):
        return ""
    segmentation = reference.GetSegmentation()
    if segment is None:
        return segmentation.GetNthSegmentID(0) if segmentation.GetNumberOfSegments() == 1 else ""
    if segmentation.GetSegment(segment) is not None:
        return segment
    return segmentation.GetSegmentIdBySegmentName(segment)


def _meshOfSegment(node, segmentId):
    """Triangles around a segment's voxels, or of the surface that it was imported from; local RAS mm."""
    segment = node.GetSegmentation().GetSegment(segmentId) if segmentId else None
    if segment is None:
        raise ValueError(
            _("No segment of {name} is chosen. Choose the one to compare with.").format(name=node.GetName())
        )
    found = None
    if node.GetSegmentation().IsSourceRepresentationPolyData():
        data = vtk.vtkPolyData()
        if node.GetClosedSurfaceRepresentation(segmentId, data):
            found = _triangles(data)
    else:
        found = _meshOfVoxels(node, segmentId)
    if found is None:
        raise ValueError(
            _("The segment {segment} is empty; it must cover the organ. Choose another segment, or paint it.").format(
                segment=segment.GetName()
            )
        )
    return found


def _meshOfVoxels(node, segmentId):
    """Triangles half-way between the voxels of a segment and their neighbours; None for an empty segment."""
    from ..analysis.reference_meshes import mesh_of_mask
    from ..imaging.image import Image, beginning_at

    labelmap = slicer.vtkOrientedImageData()
    if not node.GetBinaryLabelmapRepresentation(segmentId, labelmap) or labelmap.IsEmpty():
        return None
    scalars = labelmap.GetPointData().GetScalars()
    mask = vtk_to_numpy(scalars).reshape(labelmap.GetDimensions()[::-1]) > 0
    if not mask.any():
        return None
    toLocal = vtk.vtkMatrix4x4()
    labelmap.GetImageToWorldMatrix(toLocal)
    matrix = slicer.util.arrayFromVTKMatrix(toLocal)
    # An image needs two voxels along every axis, and a segment may have one.
    first = np.array(labelmap.GetExtent()[::2], dtype=float) - 1.0
    return mesh_of_mask(Image(np.pad(mask, 1), beginning_at(matrix, first)))


def _meshOfModel(node):
    """Triangles of a model, or the outer ones of its tetrahedra; local RAS mm."""
    data = node.GetMesh()
    if data is not None and not data.IsA("vtkPolyData"):
        outer = vtk.vtkGeometryFilter()
        outer.SetInputData(data)
        outer.Update()
        data = outer.GetOutput()
    found = _triangles(data) if data is not None else None
    if found is None:
        raise ValueError(
            _("The model {name} has no triangles; a closed surface is needed. Choose another model.").format(
                name=node.GetName()
            )
        )
    return found


def _triangles(data):
    """Triangles of polygons, or None if there are none."""
    from ..analysis.reference_meshes import ReferenceMesh
    from ..export.surface_data import triangles_in

    points, triangles = triangles_in(data)
    return ReferenceMesh(points, triangles) if len(triangles) else None


def _moved(reference, source, target):
    """Move a reference from one transform node to another; the direction of its normals is not kept."""
    from ..analysis.reference_meshes import ReferenceMesh
    from ..geometry.surface import BSplineSurface
    from ..geometry.triangulation import triangulate

    if source is target:
        return reference
    if isinstance(reference, BSplineSurface):
        matrix = linearRelation(source, target)
        if matrix is not None:
            return reference.transformed(matrix)
        reference = triangulate(reference, chord_error=_CHORD_ERROR_MM)
    return ReferenceMesh(transformedPoints(source, target, reference.points), reference.triangles)
