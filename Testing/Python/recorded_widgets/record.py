"""Reads the record of a real Slicer's widget classes: which properties, signals, slots and members there are."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[4] / "shared" / "slicer-api"
MODULES = ("qt", "ctk", "slicer")


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

    Raises
    ------
    FileNotFoundError
        If the record is not beside the project.
    """
    classes = {}
    for module in MODULES:
        for name, entry in json.loads((FOLDER / f"{module}.json").read_text()).items():
            if "members" in entry:
                classes[name] = _classRecord(module, name, entry)
    # QHeaderView could not be recorded: it needs an orientation. What is used of it ran in Slicer all the same.
    base = classes["QWidget"]
    more = {"resizeMode", "setSectionResizeMode", "setStretchLastSection", "setDefaultSectionSize", "ResizeMode"}
    more |= {"Interactive", "Stretch", "Fixed", "ResizeToContents", "sectionResizeMode", "hideSection", "showSection"}
    properties = {**base.properties, "stretchLastSection": "bool", "defaultSectionSize": "int"}
    classes["QHeaderView"] = ClassRecord(
        "qt", "QHeaderView", properties, base.signals, base.slots, base.members | more | set(properties)
    )
    # Not recorded either; qMRMLPlotView as in the recipes, the other one as scripted modules use it.
    base = classes["qMRMLWidget"]
    for name, more, properties in (
        ("qMRMLPlotView", {"mrmlPlotViewNode", "setMRMLPlotViewNode"}, {}),
        (
            "qSlicerScriptedLoadableModuleWidget",
            {"self", "isEntered", "setup", "enter", "exit", "reload"},
            {"isEntered": "bool"},
        ),
    ):
        properties = {**base.properties, **properties}
        classes[name] = ClassRecord("slicer", name, properties, base.signals, base.slots, base.members | more)
    return classes


def _classRecord(module, name, entry):
    signals = {}
    for signature in entry.get("signals", []):
        signals.setdefault(signature.partition("(")[0], []).append(signature)
    slots = frozenset(entry.get("slots", []))
    return ClassRecord(module, name, entry.get("properties", {}), signals, slots, frozenset(entry["members"]))


def argumentTypes(signature):
    """Types of the arguments of a signal or slot, ["double", "double"] for "valuesChanged(double,double)"."""
    inside = signature.partition("(")[2].rstrip(")")
    return inside.split(",") if inside else []
