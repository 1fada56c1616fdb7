"""What tests of the panel need all the time: to hear signals, and to have nodes."""

from __future__ import annotations

import slicer


def heard(widget, signature):
    """List that gets the arguments of every emission of a signal.

    Parameters
    ----------
    widget : recorded_widgets.base.Recorded
    signature : str
        Such as ``"clicked(bool)"``.
    """
    calls = []
    widget.connect(signature, lambda *arguments: calls.append(arguments))
    return calls


def add(className, name, **attributes):
    """Add a node of a class to the scene."""
    node = slicer.mrmlScene.AddNewNodeByClass(className, name)
    for key, value in attributes.items():
        node.SetAttribute(key, value)
    return node
