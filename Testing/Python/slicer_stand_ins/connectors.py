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

    def annotation(self, cls):
        return next((annotation for annotation in self.annotations if isinstance(annotation, cls)), None)

    def changed(self):
        if self.callback:
            self.callback()

    def onChanged(self, callback):
        self.callback = callback
        if callback is None:
            getattr(self.widget, self.signal).disconnect(self.changed)
        else:
            getattr(self.widget, self.signal).connect(self.changed)

    def read(self):
        return getattr(self.widget, self.property)

    def write(self, value):
        setattr(self.widget, self.property, value)


class CheckBox(Connector):
    """bool in a check box."""

    signal, property = "stateChanged", "checked"


class WholeNumber(Connector):
    """int in a spin box."""

    signal, property = "valueChanged", "value"
    lowest, highest = -(2**31), 2**31 - 1

    def prepare(self):
        within = self.annotation(WithinRange)
        if within is None and type(self.widget).__name__ == "ctkSliderWidget":
            msg = "Cannot have a connection to ctkSliderWidget where the type is unbounded."
            raise RuntimeError(msg)
        self.widget.minimum = within.minimum if within else self.lowest
        self.widget.maximum = within.maximum if within else self.highest


class RealNumber(WholeNumber):
    """float in a widget for real numbers; newer Slicers take whole numbers there as well."""

    lowest, highest = -float("inf"), float("inf")


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


CONNECTORS = {
    (bool, "QCheckBox"): CheckBox,
    (int, "QSpinBox"): WholeNumber,
}
for _name in ("QDoubleSpinBox", "ctkSliderWidget"):
    CONNECTORS[float, _name] = RealNumber


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
