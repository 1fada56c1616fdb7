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

    def mrmlScene(self):
        return self._scene

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
        if isinstance(node, str):
            node = self._scene.GetNodeByID(node) if self._scene is not None else None
        if node is not None and not node.IsA("vtkMRMLNode"):
            msg = f"{type(self).__name__}.setCurrentNode takes a node, not {node!r}"
            raise ValueError(msg)
        if not self._allows(node):
            node = None
        if node is not self._node:
            self._node = node
            self._chosen()

    def setCurrentNodeID(self, nodeID):
        self.setCurrentNode(nodeID)

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

    def _listed(self):
        """Nodes to choose from."""
        raise NotImplementedError

    def _instead(self, node):
        # As QComboBox: the one that comes to stand in its row, None too, or else the last one.
        rows = [None] * bool(self._get("noneEnabled")) + self._listed()
        at = rows.index(node)
        rows.remove(node)
        return rows[min(at, len(rows) - 1)] if rows else None


class qMRMLNodeComboBox(NodeList):
    """Lists the scene's nodes of some types; ``_choose`` is what a user does."""

    _defaults = {
        **{"enabled": True, "visible": True, "addEnabled": True, "removeEnabled": True, "editEnabled": False},
        **{"showChildNodeTypes": True, "noneDisplay": "None", "selectNodeUponCreation": True},
        **{"nodeTypes": (), "hideChildNodeTypes": ()},
    }

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._attributes = {}

    def addAttribute(self, nodeType, name, value=None):
        self._attributes[nodeType, name] = value

    def nodeCount(self):
        return len(self._listed())

    def nodeFromIndex(self, index):
        listed = self._listed()
        return listed[index] if 0 <= index < len(listed) else None

    def _choose(self, node):
        """A user chooses a node that is listed."""
        if node not in self._listed() and not (node is None and self._get("noneEnabled")):
            msg = f"{self._get('objectName')} does not list {node and node.GetName()}"
            raise AssertionError(msg)
        self.setCurrentNode(node)
        self._emit("nodeActivated", node)

    def _listed(self):
        count = self._scene.GetNumberOfNodes() if self._scene is not None else 0
        return [node for node in map(self._scene.GetNthNode, range(count)) if self._fits(node)] if count else []

    def _fits(self, node):
        names = self._get("nodeTypes")
        exact = not self._get("showChildNodeTypes")
        ofType = any(node.GetClassName() == name if exact else node.IsA(name) for name in names)
        shown = self._get("showHidden") or not node.GetHideFromEditors()
        hidden = any(node.IsA(name) and not exact for name in self._get("hideChildNodeTypes"))
        wanted = all(
            node.GetAttribute(name) is not None if value is None else node.GetAttribute(name) == value
            for (nodeType, name), value in self._attributes.items()
            if node.IsA(nodeType)
        )
        return ofType and shown and wanted and not hidden

    def _allows(self, node):
        return node is None or (self._scene is not None and self._fits(node))

    def _chosen(self):
        super()._chosen()
        self._emit("currentNodeIDChanged", self._get("currentNodeID"))

    def _nodeAdded(self, node):
        if self._fits(node):
            self._emit("nodeAdded", node)
            self._fill()

    def _nodeGoes(self, node):
        if self._fits(node):
            self._emit("nodeAboutToBeRemoved", node)
        super()._nodeGoes(node)

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
        names = (value,) if isinstance(value, str) else tuple(value)
        for name in names:
            if not hasattr(slicer, name):
                msg = f"'slicer' has no attribute '{name}'"
                raise AttributeError(msg)
        self._store("nodeTypes", names)
        if not self._allows(self._node):
            self.setCurrentNode(None)
        self._fill()

    def _get_currentNodeID(self):
        return self._node.GetID() if self._node is not None else ""

    _get_currentNodeId = _get_currentNodeID

    def _set_currentNodeID(self, value):
        self.setCurrentNode(value)


class qMRMLSegmentSelectorWidget(NodeList):
    """A segmentation and one of its segments; ``_choose`` is what a user does."""

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

    def _choose(self, node, segmentID):
        self.setCurrentNode(node)
        self.setCurrentSegmentID(segmentID)

    def _allows(self, node):
        return node is None or node.IsA("vtkMRMLSegmentationNode")

    def _listed(self):
        return list(slicer.util.getNodesByClass("vtkMRMLSegmentationNode"))

    def _chosen(self):
        super()._chosen()
        segments = self.segmentIDs()
        self.setCurrentSegmentID(segments[0] if segments and not self._get("noneEnabled") else "")


class qSlicerMarkupsPlaceWidget(NodeChooser):
    """Switches the mode on and off in which clicks place points; ``_place`` is such a click, ended by Single mode."""

    _defaults = {"enabled": True, "visible": True, "buttonsVisible": True}

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._placing = False
        self._buttons = [QToolButton(self), QToolButton(self)]
        self._buttons[0]._set("checkable", True)
        self._buttons[0]._connect("toggled", None, lambda on: self._set("placeModeEnabled", on))

    def placeButton(self):
        return self._buttons[0]

    def deleteButton(self):
        return self._buttons[1]

    def deleteLastPoint(self):
        if self._node is not None and self._node.GetNumberOfControlPoints():
            self._node.RemoveNthControlPoint(self._node.GetNumberOfControlPoints() - 1)

    def interactionNode(self):
        return slicer.app.applicationLogic().GetInteractionNode()

    def selectionNode(self):
        return slicer.app.applicationLogic().GetSelectionNode()

    def _place(self, *position):
        """A user's click into a slice at a place of the world."""
        if not self._placing:
            msg = f"A click places no point: the place mode of {self._get('objectName')} is off"
            raise AssertionError(msg)
        self._node.AddControlPointWorld(*position)
        if self._get("placeMultipleMarkups") == type(self).ForcePlaceSingleMarkup:
            self._set("placeModeEnabled", False)

    def _nodeGoes(self, node):
        # As in Slicer the dead node stays the current one.
        if node is self._node:
            self._set("placeModeEnabled", False)

    def _sceneChanged(self, nothing):
        self._set("placeModeEnabled", False)

    def _chosen(self):
        self._set("placeModeEnabled", False)

    def _get_placeModeEnabled(self):
        return self._placing

    def _set_placeModeEnabled(self, value):
        value = value and self._node is not None and self._scene is not None
        if value == self._placing:
            self._buttons[0]._values["checked"] = value
            return
        self._placing = self._buttons[0]._values["checked"] = value
        interaction = self.interactionNode()
        if value:
            self.selectionNode().SetReferenceActivePlaceNodeClassName(self._node.GetClassName())
            self.selectionNode().SetReferenceActivePlaceNodeID(self._node.GetID())
            interaction.SetCurrentInteractionMode(interaction.Place)
        else:
            interaction.SetCurrentInteractionMode(interaction.ViewTransform)
        self._emit("activeMarkupsPlaceModeChanged", value)
        self._emit("activeMarkupsFiducialPlaceModeChanged", value)


class qMRMLPlotView(SceneWidget):
    """A plot view; it is not in the record, and has what the recipes show to work."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._view = None

    def setMRMLPlotViewNode(self, node):
        self._view = node

    def mrmlPlotViewNode(self):
        return self._view


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
