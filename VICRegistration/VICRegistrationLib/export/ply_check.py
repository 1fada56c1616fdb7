"""Whether a PLY file is complete: VTK's reader ends the process with one that is cut short or damaged."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

# Types of numbers by their names in the header, as `struct` has them.
_TYPES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"},
    **{"float32": "f", "float64": "d"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
# VTK's reader has room for so many corners of a polygon.
_MOST_CORNERS = 255
# Names of the lists that are polygons.
_CORNERS = {"vertex_indices", "vertex_index"}


@dataclass
class _Element:
    """Rows of one kind: how many, and the properties in each.

    A property is its name with its type; with the types of its length and of its entries if it is a list.
    """

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)


def check_ply(path: Path) -> None:
    """Refuse a PLY file that is not complete.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If its header is not understood, or its rows are not all there.
    """
    head, _, rest = path.read_bytes().partition(b"end_header")
    order, elements = _header(path, head.decode("latin-1"))
    # Behind the line of the header's end.
    rows = rest.partition(b"\n")[2]
    points = next(each.count for each in elements if each.name == "vertex")
    walk = _over_bytes(rows, elements, order) if order else _over_lines(rows, elements)
    try:
        whole = all(_is_sound(name, entries, points) for name, entries in walk)
    except (IndexError, ValueError, struct.error):
        whole = False
    if not whole:
        msg = f"{path} is cut short or damaged (rows or points are missing); copy or download it again."
        raise ValueError(msg)


def _header(path: Path, head: str) -> tuple[str, list[_Element]]:
    """Order of the bytes, empty for text, and the elements."""
    order, elements = None, []
    try:
        for words in map(str.split, head.splitlines()):
            if words[:1] == ["format"]:
                order = _ORDERS[words[1]]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2])))
            elif words[:1] == ["property"]:
                types = words[2:4] if words[1] == "list" else words[1:2]
                elements[-1].properties.append((words[-1], "".join(_TYPES[each] for each in types)))
    except (IndexError, KeyError, ValueError):
        elements = []
    names = {each.name: {name for name, _ in each.properties} for each in elements if each.count > 0}
    has_points, has_polygons = {"x", "y", "z"} <= names.get("vertex", set()), _CORNERS & names.get("face", set())
    if order is None or not has_points or not has_polygons:
        msg = f"The file {path} holds no triangles that can be read; give a closed mesh as a .ply file."
        raise ValueError(msg)
    return order, elements


def _is_sound(name: str, entries: Sequence[float], points: int) -> bool:
    """Whether a list is short enough, and holds numbers of points if it is a polygon."""
    if len(entries) > _MOST_CORNERS:
        return False
    return name not in _CORNERS or not entries or 0 <= min(entries) <= max(entries) < points


def _over_lines(rows: bytes, elements: list[_Element]) -> Iterator[tuple[str, list[float]]]:
    """Names and entries of all lists of a file of text; an error where a row or a number is missing."""
    lines = iter(rows.splitlines())
    for element in elements:
        for _ in range(element.count):
            words, place = next(lines, b"").split(), 0
            for name, types in element.properties:
                start = place + 1
                place = start + (int(words[place]) if len(types) == 2 else 0)
                if not start <= place <= len(words):
                    raise IndexError
                yield name, [float(word) for word in words[start:place]]


def _over_bytes(rows: bytes, elements: list[_Element], order: str) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Names and entries of all lists of a binary file; an error where bytes are missing."""
    place = 0
    for element in elements:
        if all(len(types) == 1 for _, types in element.properties):
            place += element.count * struct.calcsize("<" + "".join(types for _, types in element.properties))
            continue
        for _ in range(element.count):
            for name, types in element.properties:
                first = place
                place += struct.calcsize("<" + types[0])
                if len(types) == 2:
                    (length,) = struct.unpack_from(order + types[0], rows, first)
                    entries = struct.unpack_from(f"{order}{length}{types[1]}", rows, place)
                    place += struct.calcsize(f"<{length}{types[1]}")
                    yield name, entries
    if place > len(rows):
        raise IndexError
