"""Text of a .bdf file (Nastran): CTETRA elements, a property for every organ, sets of the surfaces' nodes."""

from __future__ import annotations

import numpy as np

from ..export.frames import RAS_TO_LPS
from .tetrahedra import TetrahedralMesh
from .text_tables import ascii_names, rows_text


def nastran_text(mesh: TetrahedralMesh) -> str:
    """Write a mesh as text, LPS mm.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm.

    Returns
    -------
    str
        ASCII, bulk data only. Every organ has a PSOLID, whose material of the same number is for the user to give;
        every surface a SET1 of nodes. Comments tell which is which.
    """
    names = ascii_names([*mesh.tetrahedron_groups, *mesh.triangle_groups])
    points = np.column_stack([np.arange(1, len(mesh.points) + 1), mesh.points * RAS_TO_LPS])
    parts = [
        "$ Organs meshed by vic-registration; LPS (DICOM), mm\n",
        "$ Materials MAT1 of the numbers in PSOLID are to be added\nBEGIN BULK\n",
        # Large fields, so that coordinates keep nine digits at least.
        rows_text(points, "GRID*   %16d                %16.8E%16.8E\n*       %16.8E"),
    ]
    for number, (name, rows) in enumerate(mesh.tetrahedron_groups.items(), start=1):
        parts.append(f"$ {names[name]}\nPSOLID  {number:8d}{number:8d}\n")
        property_id = np.full(len(rows), number)
        parts.append(_elements(np.column_stack([rows + 1, property_id, mesh.tetrahedra[rows] + 1])))
    for number, (name, rows) in enumerate(mesh.triangle_groups.items(), start=1):
        parts.append(f"$ {names[name]}\n" + _set(number, np.unique(mesh.triangles[rows]) + 1))
    return "".join([*parts, "ENDDATA\n"])


def _elements(table: np.ndarray) -> str:
    """Rows of number, property and 4 or 10 nodes."""
    if table.shape[1] == 6:
        return rows_text(table, "CTETRA  " + "%8d" * 6)
    return rows_text(table, "CTETRA  " + "%8d" * 8 + "+\n+       " + "%8d" * 4)


def _set(number: int, nodes: np.ndarray) -> str:
    """Entry SET1: seven nodes in its first line, eight in the others."""
    words = [f"{node:8d}" for node in nodes.tolist()]
    lines = [[f"SET1    {number:8d}", *words[:7]]]
    lines += [["+       ", *words[start : start + 8]] for start in range(7, len(words), 8)]
    return "+\n".join("".join(line).ljust(72) for line in lines) + "\n"
