"""A cube of tetrahedra in two halves, without any mesher; and a reader of meshes in VTK files."""

from __future__ import annotations

import itertools

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import VTK_QUADRATIC_TETRA, VTK_QUADRATIC_TRIANGLE, VTK_TETRA, VTK_TRIANGLE
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from VICRegistrationLib.frames import RAS_TO_LPS
from VICRegistrationLib.meshing.elements import EDGES, TetrahedralMesh, faces_of

SIDE, CELLS = 10.0, 4


def cube(*, order: int = 1, names: tuple[str, str] = ("left", "right")) -> TetrahedralMesh:
    """Six tetrahedra in each of 4 x 4 x 4 cells; the halves meet at R = 5 mm."""
    nodes = np.stack(np.meshgrid(*[np.arange(CELLS + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    cells = []
    for steps in itertools.permutations(np.eye(3, dtype=int)):
        corners = np.cumsum([np.zeros(3, dtype=int), *steps], axis=0)
        turned = corners if np.linalg.det(steps) > 0.0 else corners[[0, 2, 1, 3]]
        starts = nodes[(nodes < CELLS).all(axis=1)]
        cells.append((starts[:, None] + turned) @ [(CELLS + 1) ** 2, CELLS + 1, 1])
    points, cells = nodes * (SIDE / CELLS), np.concatenate(cells)
    cells = cells[np.argsort(points[cells, 0].mean(axis=1) > SIDE / 2.0, kind="stable")]
    if order == 2:
        ends, number = np.unique(np.sort(cells[:, EDGES].reshape(-1, 2), axis=1), axis=0, return_inverse=True)
        cells = np.column_stack([cells, len(points) + number.reshape(-1, 6)])
        points = np.concatenate([points, points[ends].mean(axis=1)])
    right = points[cells[:, :4], 0].mean(axis=1) > SIDE / 2.0
    faces, first, second = faces_of(cells)
    outer, between = second < 0, (second >= 0) & (right[first] != right[second])
    flip = [0, 2, 1] if order == 1 else [0, 2, 1, 5, 4, 3]
    faces[between & right[first]] = faces[between & right[first]][:, flip]
    parts = [np.flatnonzero(outer & ~right[first]), np.flatnonzero(outer & right[first]), np.flatnonzero(between)]
    ends = np.cumsum([0, *map(len, parts)])
    titles = [f"{names[0]}_surface", f"{names[1]}_surface", f"{names[0]}_{names[1]}_interface"]
    return TetrahedralMesh(
        points - [2.0, 3.0, 4.0],
        cells,
        {names[0]: np.flatnonzero(~right), names[1]: np.flatnonzero(right)},
        faces[np.concatenate(parts)],
        {title: np.arange(a, b) for title, a, b in zip(titles, ends[:-1], ends[1:])},
        dict.fromkeys(names, SIDE**3 / 2.0),
    )


def read_vtu(path) -> TetrahedralMesh:
    """What VTK finds in a .vtu file; RAS mm."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    kinds = np.array([grid.GetCellType(cell) for cell in range(grid.GetNumberOfCells())])
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray())
    nodes = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
    group = vtk_to_numpy(grid.GetCellData().GetArray("group"))
    names = grid.GetFieldData().GetAbstractArray("group_names")
    parts = []
    for linear, quadratic in ((VTK_TETRA, VTK_QUADRATIC_TETRA), (VTK_TRIANGLE, VTK_QUADRATIC_TRIANGLE)):
        rows = np.flatnonzero(np.isin(kinds, (linear, quadratic)))
        width = offsets[rows[0] + 1] - offsets[rows[0]]
        groups = {names.GetValue(n): np.flatnonzero(group[rows] == n) for n in np.unique(group[rows])}
        parts += [nodes[offsets[rows][:, None] + np.arange(width)], groups]
    return TetrahedralMesh(vtk_to_numpy(grid.GetPoints().GetData()) * RAS_TO_LPS, *parts)
