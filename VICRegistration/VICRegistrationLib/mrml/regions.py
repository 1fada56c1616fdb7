"""Separated regions as segments, and segments as regions."""

from __future__ import annotations

import numpy as np
import slicer
import vtk
from slicer.i18n import tr as _
from vtk.util.numpy_support import numpy_to_vtk

from .volumes import putUnderVolume, worldPoints

TYPE_ATTRIBUTE = "VIC.type"
_REGIONS = "regions"
_FILL_OPACITY = 0.35
_SAMPLED_VOXELS = 1000


def regionsOf(volumeNode):
    """Segmentation node that holds the regions of all organs of a volume; made where there is none.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLSegmentationNode
        Under the volume's parent transform, shown in slice views only.
    """
    node = findRegions(volumeNode)
    if node is not None:
        putUnderVolume(node, volumeNode)
        return node
    node = slicer.mrmlScene.AddNewNodeByClass(
        "vtkMRMLSegmentationNode", _("{volume} regions").format(volume=volumeNode.GetName())
    )
    node.SetAttribute(TYPE_ATTRIBUTE, _REGIONS)
    node.CreateDefaultDisplayNodes()
    # The transform first: Slicer takes the reference geometry relative to the segmentation.
    putUnderVolume(node, volumeNode)
    node.SetReferenceImageGeometryParameterFromVolumeNode(volumeNode)
    display = node.GetDisplayNode()
    display.SetVisibility3D(False)
    display.SetOpacity2DFill(_FILL_OPACITY)
    return node


def findRegions(volumeNode):
    """Segmentation node that holds the regions of all organs of a volume, if there is one.

    Parameters
    ----------
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLSegmentationNode or None
    """
    role = slicer.vtkMRMLSegmentationNode.GetReferenceImageGeometryReferenceRole()
    for node in slicer.util.getNodesByClass("vtkMRMLSegmentationNode"):
        if node.GetAttribute(TYPE_ATTRIBUTE) == _REGIONS and node.GetNodeReference(role) is volumeNode:
            return node
    return None


def addSegment(segmentationNode, segmentId, name, color):
    """Add an empty segment, or give an existing one its name and colour.

    Parameters
    ----------
    segmentationNode : vtkMRMLSegmentationNode
    segmentId, name : str
    color : (r, g, b)
        0 to 1.
    """
    segment = segmentationNode.GetSegmentation().GetSegment(segmentId)
    if segment is None:
        segmentationNode.GetSegmentation().AddEmptySegment(segmentId, name, list(color))
        return
    if segment.GetName() != name:
        segment.SetName(name)
    if tuple(segment.GetColor()) != tuple(color):
        segment.SetColor(*color)


def showRegion(segmentationNode, segmentId, region):
    """Let a segment show a region.

    Parameters
    ----------
    segmentationNode : vtkMRMLSegmentationNode
        Under the parent transform of the region's volume.
    segmentId : str
    region : VICRegistrationLib.imaging.region.Region or None
        None empties the segment.
    """
    logic = slicer.vtkSlicerSegmentationsModuleLogic
    if region is None:
        logic.ClearSegment(segmentationNode, segmentId)
        return
    depth, height, width = region.mask.shape
    labelmap = slicer.vtkOrientedImageData()
    # The extent counts from the volume's first voxel, so that the segment lies on the volume's own grid.
    k, j, i = region.offset
    labelmap.SetExtent(i, i + width - 1, j, j + height - 1, k, k + depth - 1)
    toVolume = region.ijk_to_ras.copy()
    toVolume[:3, 3] -= toVolume[:3, :3] @ np.array([i, j, k], dtype=float)
    labelmap.SetImageToWorldMatrix(slicer.util.vtkMatrixFromArray(toVolume))
    voxels = numpy_to_vtk(region.mask.astype(np.uint8).ravel(), deep=True, array_type=vtk.VTK_UNSIGNED_CHAR)
    voxels.SetName("ImageScalars")
    labelmap.GetPointData().SetScalars(voxels)
    logic.SetBinaryLabelmapToSegment(labelmap, segmentationNode, segmentId, logic.MODE_REPLACE)


def regionVolumeMl(region, volumeNode):
    """Volume of a region in world coordinates, where the transform of its volume node may change it.

    Parameters
    ----------
    region : VICRegistrationLib.imaging.region.Region
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    float
        Millilitres; exact under linear transforms, by a sample of the voxels under others.
    """
    if volumeNode.GetParentTransformNode() is None:
        return float(region.volume_ml)
    voxels = np.argwhere(region.mask)[:, ::-1]
    voxels = voxels[:: max(len(voxels) // _SAMPLED_VOXELS, 1)]
    # Edges of every voxel in world coordinates.
    corners = np.concatenate([voxels, *(voxels + edge for edge in np.eye(3))])
    first, *others = np.split(worldPoints(volumeNode, region.image.to_ras(corners)), 4)
    edges = np.stack(others, axis=1) - first[:, None]
    return float(np.abs(np.linalg.det(edges)).mean() * np.count_nonzero(region.mask) / 1000.0)


def regionFromSegment(segmentationNode, segmentId, volumeNode, image):
    """Take a region from a segment on any grid.

    Parameters
    ----------
    segmentationNode : vtkMRMLSegmentationNode or None
    segmentId : str
    volumeNode : vtkMRMLScalarVolumeNode
        Its grid is that of the region; the transforms of both nodes are respected.
    image : VICRegistrationLib.imaging.image.Image
        Image of that volume.

    Returns
    -------
    VICRegistrationLib.imaging.region.Region
        The largest piece of the segment.

    Raises
    ------
    ValueError
        If there is no such segment, or none of it lies in the volume.
    """
    from ..imaging.region import region_from_mask

    segment = segmentationNode.GetSegmentation().GetSegment(segmentId) if segmentationNode and segmentId else None
    if segment is None:
        raise ValueError(_("No segment is chosen. Choose a segmentation and a segment."))
    mask = _voxelsOf(segmentationNode, segmentId, volumeNode)
    if not np.any(mask):
        raise ValueError(
            _(
                "The segment {segment} holds no voxel of the volume {volume}; it must cover the organ. Choose another "
                "segment, or paint it."
            ).format(segment=segment.GetName(), volume=volumeNode.GetName())
        )
    return region_from_mask(image, mask, largest_component=True)


def _voxelsOf(segmentationNode, segmentId, volumeNode):
    """Voxels of a segment on a volume's grid, (nk, nj, ni).

    Like slicer.util.arrayFromSegmentBinaryLabelmap, which leaves a display node in the scene and shows the labelmap.
    """
    labelmap = slicer.mrmlScene.CreateNodeByClass("vtkMRMLLabelMapVolumeNode")
    labelmap.UnRegister(None)
    labelmap.SetHideFromEditors(True)
    slicer.mrmlScene.AddNode(labelmap)
    segments = vtk.vtkStringArray()
    segments.InsertNextValue(segmentId)
    logic = slicer.vtkSlicerSegmentationsModuleLogic
    try:
        made = logic.ExportSegmentsToLabelmapNode(segmentationNode, segments, labelmap, volumeNode)
        return np.array(slicer.util.arrayFromVolume(labelmap)) if made else np.zeros(0)
    finally:
        display = labelmap.GetDisplayNode()
        for node in (display.GetColorNode() if display else None, display, labelmap):
            if node is not None:
                slicer.mrmlScene.RemoveNode(node)
