"""Stand-in of the connectors of slicer.parameterNodeWrapper: which widget can show which type, and how."""

from __future__ import annotations

import enum
import typing

import slicer

from .annotations import WithinRange
from .serializers import split


class Connector:
    """Reads and writes the value of a widget."""

    def __init__(self, widget, type_, annotations):
        self.widget, self.type, self.annotations, self.callback = widget, type_, annotations, None
        self.prepare()

    def prepare(self):
        """Set the widget up for the type."""

    def onChanged(self, callback):
        """Call a function when the user changes the widget; None: no more."""
        if callback is None:
            getattr(self.widget, self.signal).disconnect(self.callback)
        else:
            getattr(self.widget, self.signal).connect(callback)
        self.callback = callback

    def read(self):
        return getattr(self.widget, self.property)

    def write(self, value):
        setattr(self.widget, self.property, value)


class CheckBox(Connector):
    """bool in a check box."""

    signal, property = "stateChanged", "checked"


class Number(Connector):
    """int or float, within a range, in a widget for such numbers."""

    signal, property = "valueChanged", "value"

    def prepare(self):
        (within,) = (annotation for annotation in self.annotations if isinstance(annotation, WithinRange))
        self.widget.minimum, self.widget.maximum = within.minimum, within.maximum


class EnumChoices(Connector):
    """A member of an enum in a combo box, shown by its label() or its name."""

    signal = "currentIndexChanged"

    def prepare(self):
        self.values = list(self.type)
        label = getattr(self.type, "label", lambda member: member.name)
        saved = self.read()
        self.widget.clear()
        for member in self.values:
            self.widget.addItem(label(member))
        self.write(saved)

    def read(self):
        return self.values[self.widget.currentIndex]

    def write(self, value):
        self.widget.currentIndex = self.values.index(value)


class NodeChoice(Connector):
    """A node in a node selector."""

    signal = "currentNodeChanged"

    def prepare(self):
        types = [type_ for type_ in _alternatives(self.type) if type_ is not type(None)]
        self.widget.nodeTypes = tuple(type_().GetClassName() for type_ in types)

    def read(self):
        return self.widget.currentNode()

    def write(self, value):
        self.widget.setCurrentNode(value)


# Newer Slicers take whole numbers in the last two as well.
CONNECTORS = {
    (bool, "QCheckBox"): CheckBox,
    (int, "QSpinBox"): Number,
    (float, "QDoubleSpinBox"): Number,
    (float, "ctkSliderWidget"): Number,
}


def connectorFor(widget, hint):
    """A connector for a widget and a type; RuntimeError if there is none."""
    type_, annotations = split(hint)
    widgetName = type(widget).__name__
    found = CONNECTORS.get((type_, widgetName))
    if isinstance(type_, type) and issubclass(type_, enum.Enum) and widgetName == "QComboBox":
        found = EnumChoices
    nodes = (type(None), slicer.vtkMRMLNode)
    if widgetName == "qMRMLNodeComboBox" and all(issubclass(each, nodes) for each in _alternatives(type_)):
        found = NodeChoice
    if found is None:
        msg = f"Unable to create GUI connector from datatype '{hint}' to widget type '{widgetName}'."
        raise RuntimeError(msg)
    return found(widget, type_, annotations)


def _alternatives(type_):
    return typing.get_args(type_) if typing.get_origin(type_) is typing.Union else (type_,)
