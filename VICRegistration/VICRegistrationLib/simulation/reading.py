"""Tetrahedral meshes out of files: VTU, and MSH 4.1 of gmsh as text; LPS mm in files, RAS mm in memory."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkStringArray
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from ..export.frames import RAS_TO_LPS
from ..export.vtk_xml import silent_vtk
from ..files import reason
from ..meshing.elements import scaled_jacobians
from ..meshing.formats import VTK_TYPES
from ..meshing.msh import MSH_KINDS, MSH_ORDER
from ..meshing.tetrahedra import TetrahedralMesh

_MSH_NODES = {kind: nodes for nodes, kind in MSH_KINDS.items()}


def read_mesh(path: str | os.PathLike) -> TetrahedralMesh:
    """Read tetrahedra, and triangles with their groups where the file has them.

    Parameters
    ----------
    path : path
        .vtu, or .msh (version 4.1, text), LPS mm.

    Returns
    -------
    TetrahedralMesh
        RAS mm.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no such file, or holds no tetrahedra or inverted ones.
    """
    path = Path(path)
    readers = {".vtu": _read_vtu, ".msh": _read_msh}
    if path.suffix.lower() not in readers:
        msg = f"The mesh {path} was given; a file .msh or .vtu is needed, as vic-registration mesh writes it."
        raise ValueError(msg)
    try:
        content = path.read_bytes()
    except OSError as error:
        msg = f"The mesh {path} cannot be read ({reason(error)}); give a file that exists."
        raise OSError(msg) from error
    try:
        points, cells, groups = readers[path.suffix.lower()](content)
        return _assembled(points, cells, groups, path)
    except (KeyError, IndexError, TypeError, OverflowError, UnicodeDecodeError) as error:
        msg = f"The mesh {path} does not hold together ({type(error).__name__}); write it again."
        raise ValueError(msg) from error


def _assembled(points, cells: Mapping[int, np.ndarray], groups: Mapping[int, Mapping[str, np.ndarray]], path: Path):
    """Mesh of cells and groups by the number of nodes: the highest order of tetrahedra that there is."""
    nodes = next((number for number in (10, 4) if len(cells.get(number, ()))), None)
    if nodes is None:
        msg = f"The mesh {path} holds no tetrahedra; give a volume mesh with linear or second-order ones."
        raise ValueError(msg)
    if nodes == 10 and len(cells.get(4, ())):
        msg = f"The mesh {path} mixes linear and second-order tetrahedra; write it with one kind."
        raise ValueError(msg)
    sides = {4: 3, 10: 6}[nodes]
    triangles = cells.get(sides, np.zeros((0, sides), dtype=np.int64))
    used = np.concatenate([cells[nodes].ravel(), triangles.ravel()])
    if used.min() < 0 or used.max() >= len(points) or not np.isfinite(points).all():
        msg = f"The mesh {path} has cells without points or points that are not finite; write it again."
        raise ValueError(msg)
    mesh = TetrahedralMesh(
        points * RAS_TO_LPS, cells[nodes], dict(groups.get(nodes, {})), triangles, dict(groups.get(sides, {}))
    )
    inverted = int(np.count_nonzero(scaled_jacobians(mesh.points, mesh.tetrahedra) <= 0.0))
    if inverted:
        msg = f"The mesh {path} has {inverted} inverted elements among {len(mesh.tetrahedra)}; mesh the organ again."
        raise ValueError(msg)
    return mesh


# ------------------------------------------------------------------ VTU


def _read_vtu(content: bytes):
    reader = vtkXMLUnstructuredGridReader()
    reader.ReadFromInputStringOn()
    reader.SetInputString(content.decode("utf-8", "surrogateescape"))
    with silent_vtk():
        reader.Update()
    grid = reader.GetOutput()
    if not grid.GetNumberOfCells():
        return np.zeros((0, 3)), {}, {}
    points = vtk_to_numpy(grid.GetPoints().GetData()).astype(float)
    # The one way to ask for the kinds that VTK has had since 9.1 without change.
    kinds = np.fromiter(map(grid.GetCellType, range(grid.GetNumberOfCells())), dtype=int)
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray())
    connectivity = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).astype(np.int64)
    names = _cell_names(grid)
    cells, groups = {}, {}
    for nodes, kind in VTK_TYPES.items():
        rows = np.flatnonzero(kinds == kind)
        if len(rows):
            cells[nodes] = connectivity[offsets[rows][:, None] + np.arange(nodes)]
            groups[nodes] = _grouped(names[rows]) if names is not None else {}
    return points, cells, groups


def _cell_names(grid) -> np.ndarray | None:
    """Name of the group of every cell of a VTU file; None if it has none."""
    named = grid.GetCellData().GetAbstractArray("group")
    if isinstance(named, vtkStringArray):
        return np.array([named.GetValue(row) for row in range(named.GetNumberOfValues())])
    if named is None:
        return None
    numbers = vtk_to_numpy(named).astype(int)
    texts = grid.GetFieldData().GetAbstractArray("group_names")
    if not isinstance(texts, vtkStringArray):
        return np.char.add("group_", numbers.astype(str))
    names = [texts.GetValue(row) for row in range(texts.GetNumberOfValues())]
    # The last name is that of the number -1: in no group.
    return np.array([*names, ""])[numbers]


def _grouped(names: np.ndarray) -> dict[str, np.ndarray]:
    """Rows of every name, in the order of their first rows."""
    unique, first, inverse = np.unique(names, return_index=True, return_inverse=True)
    rows = {str(unique[number]): np.flatnonzero(inverse == number) for number in np.argsort(first)}
    rows.pop("", None)
    return rows


# ------------------------------------------------------------------ MSH


def _read_msh(content: bytes):
    sections = dict(re.findall(r"^\$(\w+)\s*?\n(.*?)^\$End\1", content.decode("utf-8"), re.MULTILINE | re.DOTALL))
    version, binary = sections["MeshFormat"].split()[:2]
    if not version.startswith("4.1") or binary != "0":
        kind = ", binary" if binary != "0" else ""
        msg = (
            f"The mesh is of the format MSH {version}{kind}; MSH 4.1 as text is understood: write it with gmsh -format "
            "msh41 -bin 0."
        )
        raise ValueError(msg)
    tags, points = _msh_nodes(_Numbers(sections["Nodes"]))
    row = np.full(tags.max(initial=0) + 1, -1)
    row[tags] = np.arange(len(tags))
    names = _msh_names(sections)
    pieces: dict[int, list] = {}
    for name, nodes in _msh_elements(_Numbers(sections["Elements"]), names):
        width = nodes.shape[1]
        # The order of second-order tetrahedra only swaps two nodes, so that it is its own inverse.
        pieces.setdefault(width, []).append((row[nodes][:, MSH_ORDER.get(width, slice(None))], name))
    cells = {nodes: np.concatenate([piece for piece, _ in found]) for nodes, found in pieces.items()}
    groups = {
        nodes: _grouped(np.concatenate([np.full(len(piece), name) for piece, name in found]))
        for nodes, found in pieces.items()
    }
    return points, cells, groups


class _Numbers:
    """Numbers of a section, read one after the other."""

    def __init__(self, text: str) -> None:
        self.values = np.array(text.split(), dtype=float)
        self.place = 0

    def next(self, count: int) -> np.ndarray:
        found = self.values[self.place : self.place + count]
        if len(found) < count:
            msg = "the section ends early"
            raise IndexError(msg)
        self.place += count
        return found

    def whole(self, count: int) -> list[int]:
        return self.next(count).astype(np.int64).tolist()


def _msh_nodes(numbers: _Numbers) -> tuple[np.ndarray, np.ndarray]:
    blocks, *_ = numbers.whole(4)
    tags, points = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for _ in range(blocks):
        dimension, _, parametric, count = numbers.whole(4)
        width = 3 + (dimension if parametric else 0)
        tags.append(numbers.next(count).astype(np.int64))
        points.append(numbers.next(count * width).reshape(count, width)[:, :3])
    return np.concatenate(tags), np.concatenate(points)


def _msh_elements(numbers: _Numbers, names: Mapping[tuple[int, int], str]) -> Iterator[tuple[str, np.ndarray]]:
    """Names of the groups of blocks of triangles and tetrahedra, and the tags of their nodes."""
    # Points and lines are passed over.
    widths = {15: 1, 1: 2, 8: 3, **_MSH_NODES}
    blocks, *_ = numbers.whole(4)
    for _ in range(blocks):
        dimension, entity, kind, count = numbers.whole(4)
        if kind not in widths:
            msg = (
                f"The mesh holds cells of gmsh's kind {kind}; triangles and tetrahedra of order 1 or 2 are understood."
            )
            raise ValueError(msg)
        nodes = numbers.next(count * (widths[kind] + 1)).reshape(count, -1)[:, 1:].astype(np.int64)
        if kind in _MSH_NODES:
            yield names.get((dimension, entity), ""), nodes


def _msh_names(sections: Mapping[str, str]) -> dict[tuple[int, int], str]:
    """Name of the first physical group of every entity, by dimension and tag."""
    physical = {
        (int(dimension), int(tag)): name
        for dimension, tag, name in re.findall(
            r'^(\d+)\s+(-?\d+)\s+"(.*)"\s*$', sections.get("PhysicalNames", ""), re.M
        )
    }
    names = {}
    if "Entities" not in sections:
        return names
    numbers = _Numbers(sections["Entities"])
    for dimension, count in enumerate(numbers.whole(4)):
        for _ in range(count):
            (tag,) = numbers.whole(1)
            numbers.next(3 if dimension == 0 else 6)
            groups = numbers.whole(*numbers.whole(1))
            if dimension:
                numbers.next(*numbers.whole(1))
            if groups:
                names[dimension, tag] = physical.get((dimension, groups[0]), f"group_{groups[0]}")
    return names
