"""Builds widgets from a .ui file, and refuses what Qt would only pass over in silence."""

from __future__ import annotations

import functools
import operator
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

from . import enums
from .record import argumentTypes, load


@dataclass(frozen=True)
class UiFile:
    """What a .ui file says, without building it.

    widgets is {name: class}, properties is [(widget's name, class, property's name, element)], connections is
    [(sender, signal, receiver, slot)].
    """

    root: ElementTree.Element
    widgets: dict = field(default_factory=dict)
    layouts: dict = field(default_factory=dict)
    properties: list = field(default_factory=list)
    connections: list = field(default_factory=list)
    customs: dict = field(default_factory=dict)


def readUi(path):
    """Read a .ui file.

    Raises
    ------
    RuntimeError
        If it is not there or is no XML, as in Slicer.
    ValueError
        If two widgets have the same name, or one has none.
    """
    if not Path(path).is_file():
        msg = f"Could not load UI file: file not found {path}"
        raise RuntimeError(msg)
    try:
        tree = ElementTree.parse(path)
    except ElementTree.ParseError as error:
        msg = f"Could not load UI file: {path}"
        raise RuntimeError(msg) from error
    ui = UiFile(tree.getroot())
    for element in ui.root.iter("widget"):
        _note(ui.widgets, element, ui)
    for element in ui.root.iter("layout"):
        _note(ui.layouts, element, ui)
    for element in ui.root.iter("connection"):
        ui.connections.append(tuple(element.findtext(tag) for tag in ("sender", "signal", "receiver", "slot")))
    for element in ui.root.iter("customwidget"):
        ui.customs[element.findtext("class")] = element.findtext("header")
    return ui


def _note(names, element, ui):
    name = element.get("name")
    if not name or name in names:
        msg = f"The name {name!r} of a {element.get('class')} is missing or is there twice"
        raise ValueError(msg)
    names[name] = element.get("class")
    for child in element.findall("property"):
        ui.properties.append((name, element.get("class"), child.get("name"), child))


def problems(ui):
    """What a .ui file asks for and Slicer does not have.

    Returns
    -------
    list of str
    """
    record, found = load(), []
    for name, cls in ui.widgets.items():
        if cls not in record:
            found.append(f"{name}: there is no class {cls}")
        elif record[cls].module != "qt" and cls not in ui.customs:
            found.append(f"{name}: class {cls} has no customwidget entry")
    for name, cls, member, element in ui.properties:
        dynamic = element.get("stdset") == "0"
        if cls in record and member not in record[cls].properties and not dynamic and not _isMargin(cls, member):
            found.append(f"{name}: {cls} has no property {member}")
    for sender, signal, receiver, slot in ui.connections:
        found += _connectionProblems(ui, record, sender, signal, receiver, slot)
    return found


def _connectionProblems(ui, record, sender, signal, receiver, slot):
    missing = [name for name in (sender, receiver) if name not in ui.widgets]
    if missing:
        return [f"connection: there is no widget {name}" for name in missing]
    sends, receives = record.get(ui.widgets[sender]), record.get(ui.widgets[receiver])
    found = []
    if sends and signal not in sends.signals.get(signal.partition("(")[0], ()):
        found.append(f"connection: {sends.name} has no signal {signal}")
    if receives and slot not in receives.slots | {f"{name}()" for name in ("show", "hide")}:
        bool_slots = {f"set{name[0].upper()}{name[1:]}(bool)" for name in ("enabled", "visible", "hidden", "disabled")}
        if slot not in bool_slots:
            found.append(f"connection: {receives.name} has no slot {slot}")
    if argumentTypes(slot) != argumentTypes(signal)[: len(argumentTypes(slot))]:
        found.append(f"connection: {signal} does not fit to {slot}")
    return found


def _isMargin(cls, name):
    """Margins and spacings of layouts are made from these by the form loader, they are no properties."""
    return cls.endswith("Layout") and name in ("leftMargin", "rightMargin", "topMargin", "bottomMargin")


class Loader:
    """Builds the tree of one file."""

    def __init__(self, classes):
        self._classes, self._named = classes, {}

    def load(self, path):
        """Build the widgets of a .ui file.

        Raises
        ------
        RuntimeError
            If it cannot be read.
        ValueError
            If it asks for something that is not there.
        """
        ui = readUi(path)
        found = problems(ui)
        if found:
            msg = f"{Path(path).name}: " + "; ".join(found)
            raise ValueError(msg)
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
            if _isMargin(element.get("class"), name):
                continue
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
        if owner == "Qt" and name in enums.QT:
            return enums.QT[name]
        return getattr(self._classes[owner], name) if owner in self._classes else 0
