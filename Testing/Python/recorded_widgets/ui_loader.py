"""Builds widgets from a .ui file; what Slicer does not have is an error, where Qt would pass over it in silence."""

from __future__ import annotations

import functools
import operator
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass


@dataclass(frozen=True)
class UiFile:
    """What a .ui file says, without building it.

    widgets and layouts are {name: class}, properties is [(name of widget or layout, name of property, element)],
    connections is [(sender, signal, receiver, slot)], customs is {class: header}.
    """

    root: ElementTree.Element
    widgets: dict
    layouts: dict
    properties: list
    connections: list
    customs: dict


def readUi(path):
    """Read a .ui file; a ValueError if two widgets or layouts have the same name, or one has none."""
    root = ElementTree.parse(path).getroot()
    named = [*root.iter("widget"), *root.iter("layout")]
    names = [element.get("name") for element in named]
    twice = [name for name in names if names.count(name) > 1 or not name]
    if twice:
        msg = f"The names {twice} of widgets are missing or are there twice"
        raise ValueError(msg)
    return UiFile(
        root,
        {element.get("name"): element.get("class") for element in root.iter("widget")},
        {element.get("name"): element.get("class") for element in root.iter("layout")},
        [(each.get("name"), child.get("name"), child) for each in named for child in each.findall("property")],
        [
            tuple(element.findtext(tag) for tag in ("sender", "signal", "receiver", "slot"))
            for element in root.iter("connection")
        ],
        {element.findtext("class"): element.findtext("header") for element in root.iter("customwidget")},
    )


class Loader:
    """Builds the tree of one file."""

    def __init__(self, classes):
        self._classes, self._named = classes, {}

    def load(self, path):
        """Build the widgets of a .ui file; a KeyError or an AttributeError if it asks for what is not there."""
        ui = readUi(path)
        widget = self._widget(ui.root.find("widget"), None)
        for sender, signal, receiver, slot in ui.connections:
            handler = getattr(self._named[receiver], slot.partition("(")[0])
            self._named[sender].connect(signal, handler)
        return widget

    def _widget(self, element, parent):
        widget = self._classes[element.get("class")](*([parent] if parent is not None else []))
        widget.objectName = element.get("name")
        self._named[element.get("name")] = widget
        self._properties(element, widget)
        for child in element:
            if child.tag == "widget":
                self._widget(child, widget)
            elif child.tag == "layout":
                widget.setLayout(self._layout(child, widget))
        return widget

    def _layout(self, element, owner):
        layout = self._classes[element.get("class")]()
        if element.get("name"):
            layout.objectName = element.get("name")
        self._properties(element, layout)
        for item in element.findall("item"):
            for child in item:
                if child.tag == "widget":
                    layout._add(self._widget(child, owner))
                elif child.tag == "layout":
                    layout._add(self._layout(child, owner))
                else:
                    layout._add(None)
        return layout

    def _properties(self, element, target):
        for entry in element.findall("property"):
            name = entry.get("name")
            # Margins of layouts are no properties.
            if not name.endswith("Margin"):
                setattr(target, name, self._value(entry[0]))

    def _value(self, element):
        plain = {"string": str, "cstring": str, "bool": lambda text: text == "true", "number": int, "double": float}
        if element.tag in plain:
            return plain[element.tag](element.text or "")
        if element.tag == "stringlist":
            return tuple(child.text for child in element.findall("string"))
        if element.tag in ("enum", "set"):
            return functools.reduce(operator.or_, [self._enum(name) for name in element.text.split("|")])
        return {child.tag: child.text for child in element}

    def _enum(self, text):
        """Member of an enum from "QFormLayout::FieldsStayAtSizeHint"; those of unrecorded classes are 0."""
        owner, _, name = text.rpartition("::")
        return getattr(self._classes[owner], name) if owner in self._classes else 0
