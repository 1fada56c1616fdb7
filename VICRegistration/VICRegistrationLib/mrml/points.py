"""Lists of points that are placed in the views: seeds and boundary points."""

from __future__ import annotations

import numpy as np
import slicer
from slicer.i18n import tr as _


def createPoints(name, color):
    """Make an empty list of points, without labels in the views.

    Parameters
    ----------
    name : str
    color : (r, g, b)
        0 to 1.

    Returns
    -------
    vtkMRMLMarkupsFiducialNode
    """
    node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", name)
    # Slicer's default contains the list's name, and "%" in an organ's name makes a format that crashes.
    node.SetControlPointLabelFormat("%d")
    node.CreateDefaultDisplayNodes()
    display = node.GetDisplayNode()
    display.SetPointLabelsVisibility(False)
    display.SetPropertiesLabelVisibility(False)
    paintPoints(node, color)
    return node


def paintPoints(node, color):
    """Give the points of a list their colour.

    Parameters
    ----------
    node : vtkMRMLMarkupsFiducialNode
    color : (r, g, b)
        0 to 1.
    """
    display = node.GetDisplayNode()
    if display is not None:
        display.SetColor(*color)
        # New points are selected, and shown in this colour.
        display.SetSelectedColor(*color)


def placingEvents():
    """Events after which the placed points of a list have changed; movements of the mouse are not among them.

    Returns
    -------
    tuple of int
        Events of vtkMRMLMarkupsNode.
    """
    node = slicer.vtkMRMLMarkupsNode
    return (
        node.PointPositionDefinedEvent,
        node.PointPositionUndefinedEvent,
        # A landmark that is skipped.
        node.PointPositionMissingEvent,
        node.PointRemovedEvent,
        node.PointEndInteractionEvent,
    )


def addPoints(markupsNode, points):
    """Add points to a list, as if they had been placed.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode
    points : (n, 3) array_like or vtkMRMLMarkupsFiducialNode or None
        World RAS mm.

    Raises
    ------
    ValueError
        If they are no points.
    """
    if points is None:
        return
    if hasattr(points, "GetNumberOfControlPoints"):
        points = placedPoints(points)
    try:
        positions = np.atleast_2d(np.asarray(points, dtype=float))
    except (TypeError, ValueError):
        positions = np.array([[np.nan]])
    if not positions.size:
        return
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise ValueError(
            _("The points {points} were given; each needs three finite coordinates in RAS mm.").format(points=points)
        )
    for position in positions:
        markupsNode.AddControlPointWorld(*(float(coordinate) for coordinate in position))


def placedIndices(markupsNode):
    """List the indices of the points that were placed in a list.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode or None
        Points that are still being placed do not count.

    Returns
    -------
    list of int
        Empty without a list.
    """
    count = markupsNode.GetNumberOfControlPoints() if markupsNode is not None else 0
    defined = slicer.vtkMRMLMarkupsNode.PositionDefined
    return [index for index in range(count) if markupsNode.GetNthControlPointPositionStatus(index) == defined]


def placedPoints(markupsNode):
    """Points that were placed in a list, in the world.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode or None
        Points that are still being placed do not count.

    Returns
    -------
    (n, 3) ndarray
        World RAS mm; empty without a list.
    """
    placed = [markupsNode.GetNthControlPointPositionWorld(index) for index in placedIndices(markupsNode)]
    return np.reshape(placed, (-1, 3))


def placedIn(markupsNode):
    """Volumes that the slice views showed when the points of a list were placed in them.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode or None

    Returns
    -------
    list of vtkMRMLNode or None
        One for every point that was placed; None for one placed in 3D or by a script.
    """
    ids = [markupsNode.GetNthControlPointAssociatedNodeID(index) for index in placedIndices(markupsNode)]
    return [slicer.mrmlScene.GetNodeByID(nodeId) if nodeId else None for nodeId in ids]


def labelPoints(markupsNode, labels):
    """Write texts beside the points of a list.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode
    labels : sequence of str
        One for every point that was placed.
    """
    for index, label in zip(placedIndices(markupsNode), labels):
        if markupsNode.GetNthControlPointLabel(index) != label:
            markupsNode.SetNthControlPointLabel(index, label)


def removeLastPoint(markupsNode):
    """Remove the point of a list that was placed last, if there is one.

    Parameters
    ----------
    markupsNode : vtkMRMLMarkupsFiducialNode
    """
    for index in placedIndices(markupsNode)[-1:]:
        markupsNode.RemoveNthControlPoint(index)
