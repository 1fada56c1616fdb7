"""Contours of a surface in the slices of further stacks, at the position of each.

A surface lies where the first volume shows the organ. Each stack that it was fitted to has a model of its own: the same
triangles, moved to where that stack shows the organ, under the stack's transform. Slice views of the stack show this
model, and all others the surface.
"""

from __future__ import annotations

import slicer
from slicer.i18n import tr as _

from .organ_nodes import putInFolder, removeNodes
from .regions import TYPE_ATTRIBUTE
from .stacks import stacksOf, toStack
from .surfaces import createModel
from .volumes import VOLUME, putUnderVolume, viewsByVolume, withSameGrid

_CONTOUR = "stack contour"
# References of a contour.
_STACK, _SURFACE = "VIC.stack", "VIC.surface"
# Attribute of the display node of a surface whose views are restricted here.
_CHOSEN = "VIC.views"


def showStackContours(organ, volumeNode):
    """Make or move the contours of an organ's surface in the stacks of its last fit; remove those of others.

    Parameters
    ----------
    organ : OrganParameters
    volumeNode : vtkMRMLScalarVolumeNode
        Whose local frame the surface is in.
    """
    used = {node: record for node, record in stacksOf(organ).items() if record.used}
    held = {contour.GetNodeReference(_STACK): contour for contour in organ.contours()}
    outdated = [contour for node, contour in held.items() if node not in used]
    contours = []
    for node, record in used.items():
        contour = held.get(node) or _create(organ, node)
        contour.SetNodeReferenceID(_SURFACE, organ.surface.GetID())
        contour.SetAndObservePolyData(_moved(organ.surface.GetPolyData(), toStack(record, volumeNode, node)))
        putUnderVolume(contour, node)
        contours.append(contour)
    if list(organ.stackContours) != contours:
        organ.stackContours = contours
    for contour in contours:
        putInFolder(contour, organ, volumeNode)
    removeNodes(outdated)
    chooseViews()


def followStacks(organ):
    """Put the contours of an organ under the transforms of their stacks, and remove those whose stack was removed.

    Parameters
    ----------
    organ : OrganParameters
    """
    lost = [contour for contour in organ.contours() if contour.GetNodeReference(_STACK) is None]
    if lost:
        organ.stackContours = [contour for contour in organ.contours() if contour not in lost]
        removeNodes(lost)
    for contour in organ.contours():
        putUnderVolume(contour, contour.GetNodeReference(_STACK))


def chooseViews():
    """Show in each slice view the contours at the position of the stack that it shows, in place of the surface.

    A view that shows a copy of a stack, with the same grid, counts as one that shows the stack. Where there is no other
    view in the scene, a surface cannot be restricted to others, and both are seen.
    """
    views, bySurface, replaced = viewsByVolume(), {}, {}
    for contour in _contours():
        bySurface.setdefault(contour.GetNodeReference(_SURFACE), []).append(contour)
    for surface, contours in bySurface.items():
        shown = _viewsByStack(surface, contours, views) if surface is not None else {}
        for contour in contours:
            showing = shown.get(contour.GetNodeReference(_STACK), [])
            display = contour.GetDisplayNode()
            _setViews(display, showing)
            if bool(display.GetVisibility2D()) != bool(showing):
                display.SetVisibility2D(bool(showing))
            replaced.setdefault(surface, []).extend(showing)
    for surface in slicer.util.getNodesByClass("vtkMRMLModelNode"):
        display, without = surface.GetDisplayNode(), replaced.get(surface, [])
        if display is None or (not without and display.GetAttribute(_CHOSEN) is None):
            continue
        _setViews(display, [view for view in _allViews() if view not in without] if without else [])
        display.SetAttribute(_CHOSEN, "1" if without else None)


def _create(organ, stackNode):
    name = _("{organ} in {volume}").format(organ=organ.label, volume=stackNode.GetName())
    contour = createModel(name, organ.color)
    contour.SetAttribute(TYPE_ATTRIBUTE, _CONTOUR)
    contour.SetNodeReferenceID(_STACK, stackNode.GetID())
    display = contour.GetDisplayNode()
    display.SetVisibility3D(False)
    surface = organ.surface.GetDisplayNode()
    if surface is not None:
        display.SetVisibility(surface.GetVisibility())
    return contour


def _moved(surfaceData, matrix):
    """Triangles moved by a matrix (4, 4), without the arrays of the surface."""
    from ..export.surface_data import triangles_in
    from ..geometry.polydata import polydata

    points, triangles = triangles_in(surfaceData)
    return polydata(points @ matrix[:3, :3].T + matrix[:3, 3], triangles)


def _contours():
    """Contours of the scene. A copy that Slicer has made of one has no references: it is the user's own model."""
    found = []
    for node in slicer.util.getNodesByClass("vtkMRMLModelNode"):
        # One of both is left when the surface or the stack is deleted.
        isOwn = any(node.GetNodeReferenceID(role) is not None for role in (_STACK, _SURFACE))
        if isOwn and node.GetAttribute(TYPE_ATTRIBUTE) == _CONTOUR and node.GetDisplayNode() is not None:
            found.append(node)
    return found


def _viewsByStack(surface, contours, views):
    """IDs of the slice views by which of them they show: the surface's own volume, or the stack of a contour."""
    volumes = [surface.GetNodeReference(VOLUME), *(contour.GetNodeReference(_STACK) for contour in contours)]
    found = {}
    for volume, ids in views.items():
        found.setdefault(withSameGrid(volume, [node for node in volumes if node is not None]), []).extend(ids)
    # Views of other volumes: not those of a contour whose stack was deleted.
    found.pop(None, None)
    return found


def _allViews():
    """IDs of the views that show models."""
    kinds = ("vtkMRMLSliceNode", "vtkMRMLViewNode")
    return [node.GetID() for kind in kinds for node in slicer.util.getNodesByClass(kind)]


def _setViews(display, views):
    """Restrict a display node to views; without views it is shown in all."""
    if sorted(display.GetViewNodeIDs()) == sorted(views):
        return
    with slicer.util.NodeModify(display):
        display.RemoveAllViewNodeIDs()
        for view in views:
            display.AddViewNodeID(view)
