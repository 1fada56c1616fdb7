"""The nodes of an organ: created when they are needed, in the volume's folder and under its transform."""

from __future__ import annotations

import re

import slicer
from slicer.i18n import tr as _

from .colors import updateLegends
from .convergence import createPlot, seriesOf
from .points import createPoints, paintPoints
from .regions import TYPE_ATTRIBUTE, addSegment, findRegions, regionsOf
from .surfaces import createModel
from .volumes import VOLUME, putUnderVolume

_FOLDER = "folder"
_BOUNDARY_COLOR = (1.0, 0.95, 0.2)


def paint(organ):
    """Give the nodes of an organ its colour, and its segment its name.

    Parameters
    ----------
    organ : OrganParameters
    """
    if organ.surface is not None and organ.surface.GetDisplayNode() is not None:
        organ.surface.GetDisplayNode().SetColor(*organ.color)
    for contour in organ.contours():
        contour.GetDisplayNode().SetColor(*organ.color)
    if organ.seeds is not None:
        paintPoints(organ.seeds, organ.color)
    for series in seriesOf(organ):
        series.SetColor(*organ.color)
    if hasSegment(organ):
        addSegment(organ.regions, organ.regionSegmentId, organ.label, organ.color)


def isVisible(organ):
    """Whether the surface is shown, or the region if there is no surface yet.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    bool
    """
    if organ.surface is not None:
        display = organ.surface.GetDisplayNode()
        return bool(display is not None and display.GetVisibility())
    display = organ.regions.GetDisplayNode() if hasSegment(organ) else None
    return bool(display is None or display.GetSegmentVisibility(organ.regionSegmentId))


def setVisible(organ, visible):
    """Show or hide everything that belongs to an organ.

    Parameters
    ----------
    organ : OrganParameters
    visible : bool
    """
    for node in (organ.surface, organ.seeds, organ.boundaryPoints, *organ.contours()):
        if node is not None and node.GetDisplayNode() is not None:
            node.GetDisplayNode().SetVisibility(visible)
    updateLegends()
    # A region would hide the contour of its surface; the user can show it by its own button.
    setRegionVisible(organ, visible and organ.surface is None)


def setRegionVisible(organ, visible):
    """Show or hide the region of an organ in the slices.

    Parameters
    ----------
    organ : OrganParameters
    visible : bool
    """
    if hasSegment(organ) and organ.regions.GetDisplayNode() is not None:
        organ.regions.GetDisplayNode().SetSegmentVisibility(organ.regionSegmentId, visible)


def volumeOf(organ):
    """Volume that an organ's surface was fitted in; without a surface, the one that it was separated in last.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    vtkMRMLScalarVolumeNode or None
    """
    own = organ.surface.GetNodeReference(VOLUME) if organ.surface is not None else None
    if own is not None:
        return own
    role = slicer.vtkMRMLSegmentationNode.GetReferenceImageGeometryReferenceRole()
    return organ.regions.GetNodeReference(role) if organ.regions is not None else None


def seedsOf(organ, volumeNode):
    """List of an organ's seeds; made where there is none.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLMarkupsFiducialNode
    """
    if organ.seeds is None:
        organ.seeds = createPoints(_("{organ} seeds").format(organ=organ.label), organ.color)
    return _placed(organ.seeds, organ, volumeNode)


def boundaryPointsOf(organ, volumeNode):
    """List of an organ's boundary points; made where there is none.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLMarkupsFiducialNode
    """
    if organ.boundaryPoints is None:
        name = _("{organ} boundary points").format(organ=organ.label)
        organ.boundaryPoints = createPoints(name, _BOUNDARY_COLOR)
        organ.boundaryPoints.GetDisplayNode().SetPointLabelsVisibility(True)
    return _placed(organ.boundaryPoints, organ, volumeNode)


def segmentOf(organ, volumeNode):
    """Segment that shows an organ's region; made where there is none.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    segmentationNode : vtkMRMLSegmentationNode
    segmentId : str
    """
    regions = regionsOf(volumeNode)
    if organ.regions is not regions:
        # The organ was separated in another volume earlier.
        removeSegment(organ)
    segmentId = organ.regionSegmentId
    if organ.regions is not regions or not segmentId:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", organ.label)
        segmentId = regions.GetSegmentation().GenerateUniqueSegmentID(f"VIC_{plain}")
    # The segment first: observers of the organ look for the nodes and segments that it refers to.
    addSegment(regions, segmentId, organ.label, organ.color)
    with slicer.util.NodeModify(organ.parameterNode):
        organ.regions, organ.regionSegmentId = regions, segmentId
    return _placed(regions, organ, volumeNode), segmentId


def hasSegment(organ):
    """Whether an organ has the segment that shows its region.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    bool
    """
    if organ.regions is None or not organ.regionSegmentId:
        return False
    return organ.regions.GetSegmentation().GetSegment(organ.regionSegmentId) is not None


def modelOf(organ, volumeNode):
    """Model that shows an organ's surface; made where there is none.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLModelNode
    """
    if organ.surface is None:
        organ.surface = createModel(_("{organ} surface").format(organ=organ.label), organ.color)
    return _placed(organ.surface, organ, volumeNode)


def convergenceOf(organ, volumeNode):
    """Table and plot of an organ's convergence; made where there are none.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode

    Returns
    -------
    vtkMRMLTableNode
        The table that the plot shows.
    """
    name = _("{organ} convergence").format(organ=organ.label)
    series = seriesOf(organ)
    if organ.convergence is None:
        organ.convergence = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLTableNode", name)
    if organ.plot is None or not series:
        removeNodes([node for node in (organ.plot, *series) if node is not None])
        organ.plot = createPlot(name, organ.color)
        series = seriesOf(organ)
    for one in series:
        one.SetAndObserveTableNodeID(organ.convergence.GetID())
    for node in (*series, organ.plot, organ.convergence):
        putInFolder(node, organ, volumeNode)
    return organ.convergence


def followVolume(organ, volumeNode):
    """Put an organ's nodes under the present transform of their volume, or harden on them what was hardened on it.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode
    """
    for node in (organ.seeds, organ.boundaryPoints, organ.regions, organ.surface):
        if node is not None and node.GetNodeReference(VOLUME) in (None, volumeNode):
            putUnderVolume(node, volumeNode)


def nodesOf(organ):
    """Nodes that are removed with an organ; the segmentation, which all organs of a volume share, is not among them.

    Parameters
    ----------
    organ : OrganParameters

    Returns
    -------
    list of vtkMRMLNode
    """
    found = [organ.seeds, organ.boundaryPoints, organ.surface, organ.convergence, organ.plot]
    return [node for node in found if node is not None] + organ.contours() + seriesOf(organ)


def removeNodes(nodes):
    """Remove nodes with their display and storage nodes, and the folders of organs that are then empty.

    Parameters
    ----------
    nodes : list of vtkMRMLNode
    """
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    folders = {hierarchy.GetItemParent(hierarchy.GetItemByDataNode(node)) for node in nodes}
    for node in nodes:
        # These first: Slicer looks for the owner's scene when a display node is removed.
        for one in [*_attached(node), node]:
            if one.GetScene() is not None:
                slicer.mrmlScene.RemoveNode(one)
    for folder in folders:
        if _isFolder(hierarchy, folder) and not hierarchy.GetNumberOfItemChildren(folder):
            hierarchy.RemoveItem(folder)


def removeSegment(organ):
    """Remove the segment of an organ, and the segmentation with its last segment.

    Parameters
    ----------
    organ : OrganParameters
    """
    regions = organ.regions
    if not hasSegment(organ):
        return
    regions.GetSegmentation().RemoveSegment(organ.regionSegmentId)
    if not regions.GetSegmentation().GetNumberOfSegments():
        removeNodes([regions])


def _attached(node):
    """Display and storage nodes of a node."""
    attached = []
    if node.IsA("vtkMRMLStorableNode"):
        attached += [node.GetNthStorageNode(index) for index in range(node.GetNumberOfStorageNodes())]
    if node.IsA("vtkMRMLDisplayableNode"):
        attached += [node.GetNthDisplayNode(index) for index in range(node.GetNumberOfDisplayNodes())]
    return [one for one in attached if one is not None]


def _placed(node, organ, volumeNode):
    """Put a node under its volume's transform, and into the folder beside the volume."""
    putUnderVolume(node, volumeNode)
    putInFolder(node, organ, volumeNode)
    return node


def putInFolder(node, organ, volumeNode):
    """Put a node into the folder of the organs of a volume.

    Parameters
    ----------
    node : vtkMRMLNode
        It stays in a folder that a user has put it into.
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode
    """
    hierarchy = slicer.vtkMRMLSubjectHierarchyNode.GetSubjectHierarchyNode(slicer.mrmlScene)
    item = hierarchy.GetItemByDataNode(node)
    if not item or _isFolder(hierarchy, hierarchy.GetItemParent(item)):
        return
    hierarchy.SetItemParent(item, _folderOf(hierarchy, organ, volumeNode))


def _folderOf(hierarchy, organ, volumeNode):
    """Folder of a volume's organs: the one that holds their regions or the organ, or a new one beside the volume."""
    regions = findRegions(volumeNode)
    for node in [regions, *nodesOf(organ)]:
        folder = hierarchy.GetItemParent(hierarchy.GetItemByDataNode(node)) if node is not None else 0
        if _isFolder(hierarchy, folder):
            return folder
    folder = createFolder(hierarchy, volumeNode, _("{volume} organs").format(volume=volumeNode.GetName()))
    if regions is not None:
        hierarchy.SetItemParent(hierarchy.GetItemByDataNode(regions), folder)
    return folder


def createFolder(hierarchy, volumeNode, name):
    """Make a folder beside a volume.

    Parameters
    ----------
    hierarchy : vtkMRMLSubjectHierarchyNode
    volumeNode : vtkMRMLScalarVolumeNode
    name : str

    Returns
    -------
    int
        Item of the folder; :func:`removeNodes` removes it when it is empty.
    """
    folder = hierarchy.CreateFolderItem(hierarchy.GetItemParent(hierarchy.GetItemByDataNode(volumeNode)), name)
    hierarchy.SetItemAttribute(folder, TYPE_ATTRIBUTE, _FOLDER)
    return folder


def _isFolder(hierarchy, item):
    return bool(item) and hierarchy.GetItemAttribute(item, TYPE_ATTRIBUTE) == _FOLDER
