"""Write slicer_api.json anew: ``python Testing/Python/recorded_widgets/update_record.py FOLDER``.

The folder holds the full record of a Slicer in qt.json, ctk.json and slicer.json: {class: {"properties": {name: type},
"signals": [signature], "slots": [signature], "members": [name]}}. The classes that the panel or the stand-ins use are
taken from it.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
FILE = FOLDER / "slicer_api.json"
ROOT = FOLDER.parents[2]
PARTS = ("properties", "signals", "slots", "members")


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
