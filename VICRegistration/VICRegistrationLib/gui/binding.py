"""Binding of parameters to widgets that can be released completely, in Slicer 5.8 too."""

from __future__ import annotations

import slicer

from .widgets import signalsBlocked

# Priority of observers that read parameters. Each wrapper observes the node to take over what other wrappers have
# written; observers of lower priority are called after these.
AFTER_WRAPPERS = -1.0


class Binding:
    """Keeps parameters and widgets equal, both ways, from :meth:`bind` to :meth:`release`.

    Notes
    -----
    `connectParametersToGui` also observes the node, and in Slicer 5.8 `disconnectGui` does not remove those observers;
    so they are recorded here while they are added.
    """

    def __init__(self):
        self._wrapper, self._tag, self._observers = None, None, []

    def bind(self, wrapper, mapping):
        """Release what was bound before, and bind other parameters.

        Parameters
        ----------
        wrapper : parameterNodeWrapper object
        mapping : dict of str to QWidget
            Parameter name to the widget that shows it.
        """
        self.release()
        self._wrapper = wrapper
        wrapper.AddObserver = self._observe
        try:
            self._tag = wrapper.connectParametersToGui(mapping)
        finally:
            del wrapper.AddObserver

    def release(self):
        """Disconnect widgets and parameters."""
        if self._wrapper is None:
            return
        self._wrapper.disconnectGui(self._tag)
        for tag in self._observers:
            self._wrapper.parameterNode.RemoveObserver(tag)
        self._wrapper, self._tag, self._observers = None, None, []

    def _observe(self, event, callback, priority=AFTER_WRAPPERS):
        tag = self._wrapper.parameterNode.AddObserver(event, callback, priority)
        self._observers.append(tag)
        return tag


class SegmentChoice:
    """Keeps a selector of segments and two parameters of an organ equal, both ways.

    Parameters
    ----------
    selector : qMRMLSegmentSelectorWidget
    nodeName, idName : str
        Parameters that hold the segmentation and the ID of its segment.
    """

    def __init__(self, selector, nodeName, idName):
        self._selector, self._names, self._organ = selector, (nodeName, idName), None
        selector.connect("currentNodeChanged(vtkMRMLNode*)", self._chosen)
        selector.connect("currentSegmentChanged(QString)", self._chosen)

    def show(self, organ):
        """Show the segment that is chosen for an organ, and store later choices in it.

        Parameters
        ----------
        organ : OrganParameters or None
            None: choices are not stored.
        """
        self._organ = organ
        if organ is None:
            return
        selector, (node, segmentId) = self._selector, self._kept()
        if node is not None and segmentId and node.GetSegmentation().GetSegment(segmentId) is None:
            # The segment was removed while the organ was not shown; the selector would choose another one.
            segmentId = ""
            setattr(organ, self._names[1], segmentId)
        with signalsBlocked(selector):
            if selector.currentNode() is not node:
                selector.setCurrentNode(node)
            if node is not None and selector.currentSegmentID() != segmentId:
                selector.setCurrentSegmentID(segmentId)

    def _kept(self):
        return tuple(getattr(self._organ, name) for name in self._names)

    def _chosen(self, _chosen=None):
        if self._organ is None:
            return
        node, segmentId = self._selector.currentNode(), self._selector.currentSegmentID() or ""
        keptNode, keptId = self._kept()
        if node is not None and node is keptNode and keptId:
            # If the chosen segment was removed, the selector chooses another one, which the user did not.
            segmentId = segmentId if node.GetSegmentation().GetSegment(keptId) is not None else ""
        with slicer.util.NodeModify(self._organ.parameterNode):
            for name, value in zip(self._names, (node, segmentId)):
                setattr(self._organ, name, value)
