"""Text of a .msh file (gmsh, version 4.1): every group is a discrete entity with a physical name."""

from __future__ import annotations

import numpy as np

from ..export.frames import RAS_TO_LPS
from .tetrahedra import TetrahedralMesh
from .text_tables import one_line_names, rows_text

# Kinds of cells by their number of nodes: triangles and tetrahedra, linear and second order.
MSH_KINDS = {3: 2, 6: 9, 4: 4, 10: 11}
# gmsh numbers the middles of the last two edges of a tetrahedron the other way round.
MSH_ORDER = {10: [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]}


def msh_text(mesh: TetrahedralMesh) -> str:
    """Write a mesh as text, LPS mm.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm.

    Returns
    -------
    str
    """
    points = mesh.points * RAS_TO_LPS
    # (dimension, tag, name, cells)
    parts = [
        *((2, tag, name, mesh.triangles[rows]) for tag, (name, rows) in enumerate(mesh.triangle_groups.items(), 1)),
        *((3, tag, name, mesh.tetrahedra[rows]) for tag, (name, rows) in enumerate(mesh.tetrahedron_groups.items(), 1)),
    ]
    return "".join([_head(parts), _entities(points, parts), _nodes(points), _elements(parts)])


def _head(parts) -> str:
    plain = one_line_names(name for _, _, name, _ in parts)
    names = "".join(f'{dim} {tag} "{name}"\n' for (dim, tag, *_), name in zip(parts, plain))
    return f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n{len(parts)}\n{names}$EndPhysicalNames\n"


def _entities(points: np.ndarray, parts) -> str:
    lines = [f"0 0 {sum(dim == 2 for dim, *_ in parts)} {sum(dim == 3 for dim, *_ in parts)}"]
    for _, tag, _, cells in parts:
        used = points[np.unique(cells)]
        box = " ".join(repr(float(number)) for number in (*used.min(axis=0), *used.max(axis=0)))
        lines.append(f"{tag} {box} 1 {tag} 0")
    return "$Entities\n" + "\n".join(lines) + "\n$EndEntities\n"


def _nodes(points: np.ndarray) -> str:
    count = len(points)
    tags = rows_text(np.arange(1, count + 1)[:, None], "%d")
    # All in one block: a node on a surface belongs to several groups.
    return f"$Nodes\n1 {count} 1 {count}\n3 1 0 {count}\n{tags}{rows_text(points, '%.17g')}$EndNodes\n"


def _elements(parts) -> str:
    total = sum(len(cells) for *_, cells in parts)
    blocks, start = [f"$Elements\n{len(parts)} {total} 1 {total}\n"], 1
    for dim, tag, _, cells in parts:
        width = cells.shape[1]
        numbers = np.arange(start, start + len(cells))
        blocks.append(f"{dim} {tag} {MSH_KINDS[width]} {len(cells)}\n")
        blocks.append(rows_text(np.column_stack([numbers, cells[:, MSH_ORDER.get(width, slice(None))] + 1]), "%d"))
        start += len(cells)
    return "".join([*blocks, "$EndElements\n"])
