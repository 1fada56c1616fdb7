"""Stand-ins of Slicer's widgets that follow the scene; they work on the real one."""

from __future__ import annotations

import weakref

import slicer
import vtk

from .widgets import QToolButton, QWidget


class SceneWidget(QWidget, record=False):
    """A widget that is told the scene and follows it."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._scene, self._tags = None, []

    def setMRMLScene(self, scene):
        if scene is self._scene:
            return
        self._unfollow()
        self._scene = scene
        if scene is not None:
            self._follow(scene, scene.NodeAddedEvent, "_nodeAdded")
            self._follow(scene, scene.NodeAboutToBeRemovedEvent, "_nodeGoes")
            self._follow(scene, scene.NodeRemovedEvent, "_nodeGone")
            self._follow(scene, scene.EndCloseEvent, "_sceneChanged")
            self._follow(scene, scene.EndImportEvent, "_sceneChanged")
        if "mrmlSceneChanged" in self.record_.signals:
            self._emit("mrmlSceneChanged", scene)
        self._sceneChanged(None)

    def _follow(self, caller, event, method):
        me = weakref.ref(self)

        @vtk.calldata_type(vtk.VTK_OBJECT)
        def happened(caller, event, node=None):
            if me() is not None and not me()._destroyed:
                getattr(me(), method)(node)

        self._tags.append((caller, caller.AddObserver(event, happened)))

    def _unfollow(self):
        for caller, tag in self._tags:
            caller.RemoveObserver(tag)
        self._tags = []

    def _destroy(self):
        self._unfollow()
        super()._destroy()

    def _nodeAdded(self, node):
        """A node was added."""

    def _nodeGoes(self, node):
        """A node is about to be removed."""

    def _nodeGone(self, node):
        """A node was removed."""

    def _sceneChanged(self, nothing):
        """There is another scene, or other contents in it."""


class qMRMLWidget(SceneWidget):
    """The panel: tells the scene to the widgets in it."""


class NodeChooser(SceneWidget, record=False):
    """What widgets share that have a current node."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._node = None

    def currentNode(self):
        return self._node

    def setCurrentNode(self, node):
        if node is not None and not node.IsA("vtkMRMLNode"):
            msg = f"{type(self).__name__}.setCurrentNode takes a node, not {node!r}"
            raise ValueError(msg)
        if not self._allows(node):
            node = None
        if node is not self._node:
            self._node = node
            self._chosen()

    def _nodeGoes(self, node):
        if node is self._node:
            self.setCurrentNode(self._instead(node))

    def _instead(self, node):
        return None

    def _sceneChanged(self, nothing):
        if self._node is not None and self._node.GetScene() is None:
            self.setCurrentNode(None)

    def _allows(self, node):
        return True

    def _chosen(self):
        self._emit("currentNodeChanged", self._node, bool=self._node is not None)


class NodeList(NodeChooser, record=False):
    """What widgets share in which a node is chosen from a list."""

    def _instead(self, node):
        # As QComboBox: the one that comes to stand in its row, None too, or else the last one.
        rows = [None] * bool(self._get("noneEnabled")) + self._listed()
        at = rows.index(node)
        rows.remove(node)
        return rows[min(at, len(rows) - 1)] if rows else None


class qMRMLNodeComboBox(NodeList):
    """Lists the scene's nodes of some types."""

    _defaults = {
        **{"enabled": True, "visible": True, "addEnabled": True, "removeEnabled": True, "editEnabled": False},
        **{"showChildNodeTypes": True, "noneDisplay": "None", "selectNodeUponCreation": True},
        "nodeTypes": (),
    }

    def _listed(self):
        count = self._scene.GetNumberOfNodes() if self._scene is not None else 0
        return [node for node in map(self._scene.GetNthNode, range(count)) if self._fits(node)] if count else []

    def _fits(self, node):
        names = self._get("nodeTypes")
        exact = not self._get("showChildNodeTypes")
        ofType = any(node.GetClassName() == name if exact else node.IsA(name) for name in names)
        shown = self._get("showHidden") or not node.GetHideFromEditors()
        return ofType and shown

    def _allows(self, node):
        return node is None or (self._scene is not None and self._fits(node))

    def _nodeAdded(self, node):
        if self._fits(node):
            self._fill()

    def _sceneChanged(self, nothing):
        super()._sceneChanged(nothing)
        self._fill()

    def _fill(self):
        if self._node is None and not self._get("noneEnabled"):
            self.setCurrentNode(next(iter(self._listed()), None))

    def _set_noneEnabled(self, value):
        self._store("noneEnabled", value)
        self._fill()

    def _set_nodeTypes(self, value):
        for name in value:
            if not hasattr(slicer, name):
                msg = f"'slicer' has no attribute '{name}'"
                raise AttributeError(msg)
        self._store("nodeTypes", tuple(value))
        if not self._allows(self._node):
            self.setCurrentNode(None)
        self._fill()


class qMRMLSegmentSelectorWidget(NodeList):
    """A segmentation and one of its segments."""

    _defaults = {"enabled": True, "visible": True, "segmentationNodeSelectorVisible": True}

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._segment = ""

    def currentSegmentID(self):
        if self._segment and self._segment not in self.segmentIDs():
            # In place of a segment that was removed it takes the first one, and says so.
            self.setCurrentSegmentID(next(iter(self.segmentIDs()), ""))
        return self._segment

    def segmentIDs(self):
        return list(self._node.GetSegmentation().GetSegmentIDs()) if self._node is not None else []

    def setCurrentSegmentID(self, segmentID):
        if segmentID and segmentID not in self.segmentIDs():
            return
        if (segmentID or "") != self._segment:
            self._segment = segmentID or ""
            self._emit("currentSegmentChanged", self._segment)

    def _allows(self, node):
        return node is None or node.IsA("vtkMRMLSegmentationNode")

    def _listed(self):
        return list(slicer.util.getNodesByClass("vtkMRMLSegmentationNode"))

    def _chosen(self):
        super()._chosen()
        segments = self.segmentIDs()
        self.setCurrentSegmentID(segments[0] if segments and not self._get("noneEnabled") else "")


class qSlicerMarkupsPlaceWidget(NodeChooser):
    """Lets the application place points in its list, a mode that all these widgets share."""

    _defaults = {
        **{"enabled": True, "visible": True, "buttonsVisible": True},
        **{"deleteAllControlPointsOptionVisible": True, "unsetAllControlPointsOptionVisible": False},
    }

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._wasPlacing = False
        self._place_, self._delete = self._buttons = [QToolButton(self), QToolButton(self)]
        self._place_._set("checkable", True)
        self._place_._connect("toggled", None, lambda on: self._set("placeModeEnabled", on))
        self._delete._connect("clicked", None, lambda: self.modifyLastPoint())

    def placeButton(self):
        return self._place_

    def deleteButton(self):
        return self._delete

    def modifyLastPoint(self):
        """What the second button does: points of a list whose number is fixed are not removed."""
        if self._node is not None and self._node.GetFixedNumberOfControlPoints():
            self.unsetLastDefinedPoint()
        else:
            self.deleteLastPoint()

    def deleteLastPoint(self):
        if self._node is not None and self._node.GetNumberOfControlPoints():
            self._node.RemoveNthControlPoint(self._node.GetNumberOfControlPoints() - 1)

    def unsetLastDefinedPoint(self):
        count = self._node.GetNumberOfControlPoints() if self._node is not None else 0
        for index in reversed(range(count)):
            if self._node.GetNthControlPointPositionStatus(index) != self._node.PositionUndefined:
                self._node.UnsetNthControlPointPosition(index)
                return

    def interactionNode(self):
        return slicer.app.applicationLogic().GetInteractionNode()

    def selectionNode(self):
        return slicer.app.applicationLogic().GetSelectionNode()

    def _chosen(self):
        # As in Slicer the application goes on to place points in the list before.
        self._update()

    def _nodeGoes(self, node):
        """As in Slicer the dead node stays the current one."""

    def _nodeGone(self, node):
        self._update()

    def _sceneChanged(self, nothing):
        self._update()

    def _get_placeModeEnabled(self):
        node, interaction, selection = self._node, self.interactionNode(), self.selectionNode()
        return (
            node is not None
            and self._scene is not None
            and _markupsLogic().GetActiveListID() == node.GetID()
            and selection.GetActivePlaceNodeClassName() == node.GetClassName()
            and interaction.GetCurrentInteractionMode() == interaction.Place
        )

    def _set_placeModeEnabled(self, value):
        if self._node is None or self._scene is None:
            return
        interaction = self.interactionNode()
        if value:
            _markupsLogic().SetActiveList(self._node)
            self._chooseHowMany()
            interaction.SetCurrentInteractionMode(interaction.Place)
        else:
            interaction.SetCurrentInteractionMode(interaction.ViewTransform)
        self._update()

    def _set_unsetAllControlPointsOptionVisible(self, value):
        self._store("unsetAllControlPointsOptionVisible", value)
        self._update()

    def _set_placeMultipleMarkups(self, value):
        self._store("placeMultipleMarkups", value)
        if self._get("placeModeEnabled"):
            self._chooseHowMany()

    def _chooseHowMany(self):
        many = self._get("placeMultipleMarkups") == type(self).ForcePlaceMultipleMarkups
        self.interactionNode().SetPlaceModePersistence(many)

    def _update(self):
        """Show what the application does, and say so where it is another thing than before."""
        placing = self._place_._values["checked"] = self._get("placeModeEnabled")
        if self._node is not None:
            fixed = self._node.GetFixedNumberOfControlPoints()
            removes = not fixed and self._get("deleteAllControlPointsOptionVisible")
            # Without a menu the button goes where points cannot be removed.
            self._delete._set("visible", removes or not fixed or self._get("unsetAllControlPointsOptionVisible"))
        if placing != self._wasPlacing:
            self._wasPlacing = placing
            self._emit("activeMarkupsPlaceModeChanged", placing)
            self._emit("activeMarkupsFiducialPlaceModeChanged", placing)


def _markupsLogic():
    return slicer.app.applicationLogic().GetModuleLogic("Markups")


class qMRMLPlotView(SceneWidget):
    """A plot view; it is not in the record, and has what the recipes show to work."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._view = None

    def setMRMLPlotViewNode(self, node):
        self._view = node


class qSlicerScriptedLoadableModuleWidget(SceneWidget):
    """What holds the panel of a scripted module."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._python = self._make = None

    def self(self):
        return self._python

    def reload(self):
        """Make the module's widget of the newest code."""
        self._python = self._make(self)
        setattr(slicer.modules, type(self._python).__name__, self._python)
        self._python.setup()
