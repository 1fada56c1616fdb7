"""Parameters of an organ bound to widgets, and released without a trace."""

from __future__ import annotations


class Binding:
    """Keeps parameters and widgets equal, both ways, until it is released.

    Parameters
    ----------
    wrapper : parameterNodeWrapper object
    mapping : dict of str to QWidget
        Parameter name to the widget that shows it.

    Notes
    -----
    `connectParametersToGui` also observes the node, and in Slicer 5.8 `disconnectGui` forgets to end that; so the
    observers are noted here while they are added.
    """

    def __init__(self, wrapper, mapping):
        self._wrapper, self._node = wrapper, wrapper.parameterNode
        self._observers = []
        wrapper.AddObserver = self._observe
        try:
            self._tag = wrapper.connectParametersToGui(mapping)
        finally:
            del wrapper.AddObserver

    def release(self):
        """Let widgets and parameters go their own ways."""
        self._wrapper.disconnectGui(self._tag)
        for tag in self._observers:
            self._node.RemoveObserver(tag)
        self._observers = []

    def _observe(self, event, callback, priority=0.0):
        tag = self._node.AddObserver(event, callback, priority)
        self._observers.append(tag)
        return tag
