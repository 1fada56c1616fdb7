"""The record of a real Slicer's widget classes: which properties, signals, slots and members there are.

``slicer_api.json`` was recorded in a running Slicer 5.8.1 (Qt 5.15.8, Python 3.11) by introspection: the properties and
methods of each class's meta object, and all names that Python sees on an instance. It holds the classes that the panel
and its stand-ins use; newer Slicers have all of it and a little more. A class that is like another one is written as
what it has beyond that one.

``python Testing/Python/recorded_widgets/record.py FOLDER`` writes the file anew. The folder holds the full record of a
Slicer in qt.json, ctk.json and slicer.json: {class: {"properties": {name: type}, "signals": [signature], "slots":
[signature], "members": [name]}}. The classes that the panel or the stand-ins use are taken from it.
"""

from __future__ import annotations

import functools
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
FILE = FOLDER / "slicer_api.json"
ROOT = FOLDER.parents[2]
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


def panel_classes():
    """Names of the widget classes in the panel's .ui file, in its code, and in its tests."""
    ui = (ROOT / "VICRegistration" / "Resources" / "UI" / "VICRegistration.ui").read_text(encoding="utf-8")
    code = [*(ROOT / "VICRegistration").rglob("*.py"), *(ROOT / "Testing" / "Slicer").rglob("*.py")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in code)
    found = re.findall(r' class="(\w+)"', ui) + re.findall(r"\b(?:qt|ctk)\.([A-Za-z]\w+)", text)
    return {*found, *re.findall(r"\bslicer\.(q\w+)", text)} - {"Qt"}


def stand_in_classes():
    """Names of the classes that have behaviour here."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in FOLDER.glob("*.py"))
    return set(re.findall(r"^class ([Qqc]\w+)", text, re.MULTILINE))


def read(folder):
    """Read a full record, {class: (module, record)}."""
    classes = {}
    for module in ("qt", "ctk", "slicer"):
        for name, record in json.loads((Path(folder) / f"{module}.json").read_text(encoding="utf-8")).items():
            if "members" in record:
                classes[name] = (module, record)
    return classes


def packed(classes):
    """Write each class as what it has beyond the largest other one that it holds completely."""
    parts = {name: _as_sets(record) for name, (_, record) in classes.items()}
    order = sorted(parts, key=lambda name: (sum(map(len, parts[name].values())), name))
    entries = {}
    for count, name in enumerate(order):
        base = next((other for other in reversed(order[:count]) if _within(parts[other], parts[name])), None)
        extra = {part: sorted(parts[name][part] - (parts[base][part] if base else set())) for part in PARTS}
        head = {"module": classes[name][0], **({"base": base} if base else {})}
        entries[name] = {**head, **extra, "properties": dict(extra["properties"])}
    return dict(sorted(entries.items()))


def _as_sets(record):
    sets = {part: set(record.get(part, ())) for part in PARTS[1:]}
    return {"properties": set(record.get("properties", {}).items()), **sets}


def _within(smaller, larger):
    return all(smaller[part] <= larger[part] for part in PARTS)


def main(folder):
    """Write the file."""
    full, names = read(folder), panel_classes() | stand_in_classes()
    entries = packed({name: full[name] for name in names if name in full})
    FILE.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
