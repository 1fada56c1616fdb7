"""Volume nodes as images of the library, and world coordinates as their local coordinates.

A volume's grey levels are taken in its local RAS mm, before its parent transform, whatever kind of transform that is.
Points in the world are brought there, and regions and surfaces are put under the same transform. So an organ is
fitted on the grid that was acquired, and shown where the transform takes it.
"""

from __future__ import annotations

import numpy as np
import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

# A node that was put under a volume's transform has a reference to the volume, and an attribute with the volume's grid
# at that time.
VOLUME, _GRID = "VIC.volume", "VIC.grid"
_GREY_VOLUME = "vtkMRMLScalarVolumeNode"


def imageFromVolume(volumeNode):
    """Image of a volume node, in the volume's local RAS mm.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    VICRegistrationLib.imaging.image.Image
        A view of the node's voxels: nothing is copied.

    Raises
    ------
    ValueError
        If there is no volume, or it holds no grey levels.
    """
    from ..imaging.image import Image

    if volumeNode is not None and not isinstance(volumeNode, slicer.vtkMRMLVolumeNode):
        name = volumeNode.GetName() if hasattr(volumeNode, "GetName") else repr(volumeNode)
        raise ValueError(
            _("The input {found} is no volume; a volume node of the scene is needed. Choose the MRI volume.").format(
                found=name
            )
        )
    if volumeNode is None or volumeNode.GetScene() is None:
        raise ValueError(_("No volume is chosen. Choose the MRI volume."))
    data = volumeNode.GetImageData()
    if data is None or data.GetPointData().GetScalars() is None:
        raise ValueError(
            _("The volume {name} holds no voxels; a volume with grey levels is needed. Load it again.").format(
                name=volumeNode.GetName()
            )
        )
    if data.GetNumberOfScalarComponents() != 1:
        raise ValueError(
            _(
                "The volume {name} has {count} values in every voxel; one grey level is needed. Convert it with the "
                "module Vector to Scalar Volume."
            ).format(name=volumeNode.GetName(), count=data.GetNumberOfScalarComponents())
        )
    try:
        return Image(slicer.util.arrayFromVolume(volumeNode), gridOf(volumeNode))
    except ValueError as error:
        msg = f"{volumeNode.GetName()}: {error}"
        raise ValueError(msg) from error


def isGreyVolume(node):
    """Whether a node is a scalar volume, and not of a derived class such as a label map.

    Parameters
    ----------
    node : vtkMRMLNode

    Returns
    -------
    bool
    """
    return node.GetClassName() == _GREY_VOLUME


def greyVolumes():
    """List the volumes of the scene that may be an MRI.

    Returns
    -------
    list of vtkMRMLScalarVolumeNode
        Without label maps and hidden volumes.
    """
    nodes = slicer.util.getNodesByClass(_GREY_VOLUME)
    return [node for node in nodes if isGreyVolume(node) and not node.GetHideFromEditors()]


def showInSlices(volumeNode):
    """Show a volume in all slice views.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode
    """
    # Without a main window there are no views to be fitted.
    slicer.util.setSliceViewerLayers(background=volumeNode, fit=slicer.app.layoutManager() is not None)


def viewsByVolume():
    """List the slice views by the volume that each shows in its background.

    Returns
    -------
    dict of vtkMRMLVolumeNode to list of str
        IDs of slice nodes.
    """
    ids = {node.GetLayoutName(): node.GetID() for node in slicer.util.getNodesByClass("vtkMRMLSliceNode")}
    found = {}
    for composite in slicer.util.getNodesByClass("vtkMRMLSliceCompositeNode"):
        volumeId = composite.GetBackgroundVolumeID()
        volume = slicer.mrmlScene.GetNodeByID(volumeId) if volumeId else None
        if volume is not None and composite.GetLayoutName() in ids:
            found.setdefault(volume, []).append(ids[composite.GetLayoutName()])
    return found


def shownVolumes():
    """List the volumes that slice views show and that may be an MRI.

    Returns
    -------
    list of vtkMRMLScalarVolumeNode
        Those in views of the layout; those in all slice views if the layout shows none of them.
    """
    views, volumes = viewsByVolume(), greyVolumes()
    slices = slicer.util.getNodesByClass("vtkMRMLSliceNode")
    laidOut = {node.GetID() for node in slices if node.IsMappedInLayout()}
    shown = [volume for volume in views if volume in volumes]
    return [volume for volume in shown if laidOut.intersection(views[volume])] or shown


def withSameGrid(volumeNode, others):
    """Find the volume whose voxels lie in the same place as those of a volume.

    Parameters
    ----------
    volumeNode : vtkMRMLVolumeNode or None
    others : sequence of vtkMRMLVolumeNode

    Returns
    -------
    vtkMRMLVolumeNode or None
        The volume itself if it is one of the others; else the first one with its grid below its parent transform,
        such as the volume that it was cloned from or filtered from.
    """
    if volumeNode is None or volumeNode in others:
        return volumeNode
    return next((node for node in others if _sameGrid(node, volumeNode)), None)


def isCopyOf(volumeNode, other):
    """Whether a volume has the voxels of another one, at the same place below its parent transform.

    Parameters
    ----------
    volumeNode, other : vtkMRMLVolumeNode

    Returns
    -------
    bool
        The transforms that the volumes are under do not matter.
    """
    return _samePlace(volumeNode, other) and np.array_equal(*map(slicer.util.arrayFromVolume, (volumeNode, other)))


def localPoints(volumeNode, worldPoints):
    """Bring points from the world into a volume's local frame.

    Parameters
    ----------
    volumeNode : vtkMRMLTransformableNode
    worldPoints : (n, 3) or (3,) array_like
        World RAS mm.

    Returns
    -------
    (n, 3) ndarray
        Local RAS mm.
    """
    return transformedPoints(None, volumeNode.GetParentTransformNode(), worldPoints)


def worldPoints(volumeNode, points):
    """Bring points of a volume's local frame into the world; the inverse of :func:`localPoints`.

    Parameters
    ----------
    volumeNode : vtkMRMLTransformableNode
    points : (n, 3) or (3,) array_like
        Local RAS mm.

    Returns
    -------
    (n, 3) ndarray
        World RAS mm.
    """
    return transformedPoints(volumeNode.GetParentTransformNode(), None, points)


def putUnderVolume(node, volumeNode):
    """Put a node under the parent transform of a volume, so that both lie in one local frame.

    Parameters
    ----------
    node : vtkMRMLTransformableNode
    volumeNode : vtkMRMLScalarVolumeNode

    Notes
    -----
    If the transform was hardened on the volume, it is hardened on the node. Points that were placed in another volume
    stay where they are in the world.
    """
    parent, before = volumeNode.GetParentTransformNode(), node.GetParentTransformNode()
    remembered, own = node.GetAttribute(_GRID), node.GetNodeReference(VOLUME)
    hardened = own in (None, volumeNode) and _wasHardened(volumeNode, before, remembered)
    if hardened:
        node.HardenTransform()
    elif own is not volumeNode and before is not parent and remembered is not None and node.IsA("vtkMRMLMarkupsNode"):
        node.ApplyTransform(_between(before, parent))
    node.SetAndObserveTransformNodeID(parent.GetID() if parent else None)
    if hardened and node.IsA("vtkMRMLSegmentationNode"):
        node.SetReferenceImageGeometryParameterFromVolumeNode(volumeNode)
    text = " ".join(f"{number!r}" for number in gridOf(volumeNode).ravel().tolist())
    if remembered != text:
        node.SetAttribute(_GRID, text)
    if own is not volumeNode:
        node.SetNodeReferenceID(VOLUME, volumeNode.GetID())


def _wasHardened(volumeNode, before, remembered):
    """Whether a volume, whose grid is remembered as a text, was below a transform node and bears it itself now."""
    if before is None or before is volumeNode.GetParentTransformNode() or remembered is None:
        return False
    old, new = np.array(remembered.split(), dtype=float).reshape(4, 4), gridOf(volumeNode)
    matrix = linearRelation(before, None)
    # A nonlinear transform resamples the voxels on another grid when it is hardened.
    moved = matrix is None or np.allclose(new, matrix @ old, atol=1e-3)
    return moved and not np.allclose(new, old)


def gridOf(volumeNode):
    """Matrix from voxels to a volume's local RAS mm.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    (4, 4) ndarray
    """
    matrix = vtk.vtkMatrix4x4()
    volumeNode.GetIJKToRASMatrix(matrix)
    return slicer.util.arrayFromVTKMatrix(matrix)


def linearRelation(source, target):
    """Matrix that takes points from below one transform node to below another.

    Parameters
    ----------
    source, target : vtkMRMLTransformNode or None
        None is the world.

    Returns
    -------
    (4, 4) ndarray or None
        None if the transform between them is nonlinear.
    """
    if source is target:
        return np.eye(4)
    one, other = (source, target) if source is not None else (target, None)
    if not one.IsTransformToNodeLinear(other):
        return None
    matrix = vtk.vtkMatrix4x4()
    slicer.vtkMRMLTransformNode.GetMatrixTransformBetweenNodes(source, target, matrix)
    return slicer.util.arrayFromVTKMatrix(matrix)


def transformedPoints(source, target, points):
    """Take points from below one transform node to below another.

    Parameters
    ----------
    source, target : vtkMRMLTransformNode or None
        None is the world.
    points : (n, 3) or (3,) array_like
        RAS mm.

    Returns
    -------
    (n, 3) ndarray
        RAS mm.
    """
    points = np.atleast_2d(np.asarray(points, dtype=float)).reshape(-1, 3)
    if source is target:
        return points
    given, moved = vtk.vtkPoints(), vtk.vtkPoints()
    given.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    moved.SetDataTypeToDouble()
    _between(source, target).TransformPoints(given, moved)
    return vtk_to_numpy(moved.GetData()).reshape(-1, 3).copy()


def _sameGrid(one, other):
    return one.GetParentTransformNode() is other.GetParentTransformNode() and _samePlace(one, other)


def _samePlace(one, other):
    """Whether the voxels of two volumes lie in the same place below the transforms that the volumes are under."""
    return (
        None not in (one.GetImageData(), other.GetImageData())
        and one.GetImageData().GetDimensions() == other.GetImageData().GetDimensions()
        and np.allclose(gridOf(one), gridOf(other), rtol=0.0, atol=1e-6)
    )


def _between(source, target):
    """Transform from below one transform node, or the world, to below another."""
    transform = vtk.vtkGeneralTransform()
    slicer.vtkMRMLTransformNode.GetTransformBetweenNodes(source, target, transform)
    return transform
