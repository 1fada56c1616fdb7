"""The record of a real Slicer's widget classes: which properties, signals, slots and members there are.

``slicer_api.json`` was recorded in a running Slicer 5.8.1 (Qt 5.15.8, Python 3.11) by introspection: the properties and
methods of each class's meta object, and all names that Python sees on an instance. It holds the classes that the panel
and its stand-ins use; newer Slicers have all of it and a little more. A class that is like another one is written as
what it has beyond that one. ``update_record.py`` writes the file.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

FILE = Path(__file__).resolve().parent / "slicer_api.json"
PARTS = ("properties", "signals", "slots", "members")

# Classes that were not recorded, by what is used of them and ran in Slicer all the same: QHeaderView needs an
# orientation to be made; qMRMLPlotView as in Slicer's script repository; the last one holds a scripted module's panel.
_UNRECORDED = {
    "QHeaderView": {
        "base": "QWidget",
        "module": "qt",
        "properties": {"stretchLastSection": "bool", "defaultSectionSize": "int"},
        "members": (
            *("stretchLastSection", "setStretchLastSection", "defaultSectionSize", "setDefaultSectionSize"),
            *("resizeMode", "sectionResizeMode", "setSectionResizeMode", "hideSection", "showSection"),
            *("ResizeMode", "Interactive", "Stretch", "Fixed", "ResizeToContents"),
        ),
    },
    "qMRMLPlotView": {
        "base": "qMRMLWidget",
        "module": "slicer",
        "members": ("mrmlPlotViewNode", "setMRMLPlotViewNode"),
    },
    "qSlicerScriptedLoadableModuleWidget": {
        "base": "qMRMLWidget",
        "module": "slicer",
        "properties": {"isEntered": "bool"},
        "members": ("self", "isEntered", "setup", "enter", "exit", "reload"),
    },
}


@dataclass(frozen=True)
class ClassRecord:
    """One class: properties {name: type}, signals {name: signatures}, slots as signatures, all members."""

    module: str
    name: str
    properties: dict
    signals: dict
    slots: frozenset
    members: frozenset

    def setter(self, member):
        """Name of the property that a member such as setText sets, or None."""
        name = member[3:4].lower() + member[4:] if member.startswith("set") else None
        return name if name in self.properties else None

    def getter(self, member):
        """Name of the property that a member such as isEnabled tells, or None."""
        for prefix in ("is", "has"):
            name = member[len(prefix) : len(prefix) + 1].lower() + member[len(prefix) + 1 :]
            if member.startswith(prefix) and name in self.properties:
                return name
        return None


@functools.cache
def load():
    """Read the record.

    Returns
    -------
    dict of str to ClassRecord
    """
    classes = {}
    entries = {**json.loads(FILE.read_text()), **_UNRECORDED}
    for name, entry in unpack(entries).items():
        signals = {}
        for signature in sorted(entry["signals"]):
            signals.setdefault(signature.partition("(")[0], []).append(signature)
        slots, members = frozenset(entry["slots"]), frozenset(entry["members"])
        classes[name] = ClassRecord(entries[name]["module"], name, entry["properties"], signals, slots, members)
    return classes


def unpack(entries):
    """Complete each class by those it is like: {name: {"properties": {name: type}, "signals": set, ...}}."""
    found = {}

    def complete(name):
        if name not in found:
            entry = entries[name]
            base = complete(entry["base"]) if "base" in entry else {"properties": {}}
            found[name] = {part: base.get(part, set()) | set(entry.get(part, ())) for part in PARTS[1:]}
            found[name]["properties"] = {**base["properties"], **entry.get("properties", {})}
        return found[name]

    for name in entries:
        complete(name)
    return found


def argumentTypes(signature):
    """Types of the arguments of a signal or slot, ["double", "double"] for "valuesChanged(double,double)"."""
    inside = signature.partition("(")[2].rstrip(")")
    return inside.split(",") if inside else []
