"""Text of an .inp file (Abaqus, CalculiX): solid elements, sets, and surfaces made of their faces."""

from __future__ import annotations

import numpy as np

from ..export.frames import RAS_TO_LPS
from .elements import FACES
from .tetrahedra import TetrahedralMesh
from .text_tables import ascii_names, lists_text, rows_text

_TYPES = {4: "C3D4", 10: "C3D10"}


def abaqus_text(mesh: TetrahedralMesh) -> str:
    """Write a mesh as text, LPS mm.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm.

    Returns
    -------
    str
        ASCII. Names are those of the groups as far as Abaqus allows; nodes of a surface are NAME_nodes, the elements
        of its faces NAME_S1 to NAME_S4.
    """
    names = ascii_names([*mesh.tetrahedron_groups, *mesh.triangle_groups])
    points = np.column_stack([np.arange(1, len(mesh.points) + 1), mesh.points * RAS_TO_LPS])
    parts = [
        "*HEADING\nOrgans meshed by vic-registration; LPS (DICOM), mm\n*NODE\n",
        rows_text(points, "%d, %.14g, %.14g, %.14g"),
    ]
    kind, numbers = _TYPES[mesh.tetrahedra.shape[1]], np.arange(1, len(mesh.tetrahedra) + 1)
    for name, rows in mesh.tetrahedron_groups.items():
        table = np.column_stack([numbers[rows], mesh.tetrahedra[rows] + 1])
        parts += [f"*ELEMENT, TYPE={kind}, ELSET={names[name]}\n", rows_text(table, "%d", delimiter=", ")]
    for name, rows in mesh.triangle_groups.items():
        nodes = np.unique(mesh.triangles[rows]) + 1
        parts += [f"*NSET, NSET={names[name]}_nodes\n", lists_text(nodes, 16)]
        parts += _surface(mesh, rows, names[name])
    return "".join(parts)


def _surface(mesh: TetrahedralMesh, rows: np.ndarray, name: str) -> list[str]:
    """Write the sets of elements with a face in a surface, by the number of that face, and the surface of them."""
    cell, side = owners(mesh, rows)
    parts, lines = [], []
    for number in range(4):
        mine = np.sort(cell[side == number]) + 1
        if len(mine):
            parts += [f"*ELSET, ELSET={name}_S{number + 1}\n", lists_text(mine, 16)]
            lines.append(f"{name}_S{number + 1}, S{number + 1}\n")
    return [*parts, f"*SURFACE, NAME={name}, TYPE=ELEMENT\n", *lines]


def owners(mesh: TetrahedralMesh, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedron that each triangle is a face of, seen from outside of it, and the number of that face.

    Parameters
    ----------
    mesh : TetrahedralMesh
    rows : (k,) ndarray of int
        Triangles.

    Returns
    -------
    cells, sides : (k,) ndarray of int
        Sides count from 0, in the order of Abaqus.
    """
    # Rotated so that the smallest node stands first, faces of both sides of an interface stay different.
    faces = _rotated(mesh.tetrahedra[:, FACES[:, :3]].reshape(-1, 3))
    wanted = _rotated(mesh.triangles[rows][:, :3])
    size = len(mesh.points)
    key = (faces[:, 0] * size + faces[:, 1]) * size + faces[:, 2]
    order = np.argsort(key)
    place = order[np.searchsorted(key[order], (wanted[:, 0] * size + wanted[:, 1]) * size + wanted[:, 2])]
    return place // 4, place % 4


def _rotated(faces: np.ndarray) -> np.ndarray:
    first = np.argmin(faces, axis=1)
    return np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1).astype(np.int64)
