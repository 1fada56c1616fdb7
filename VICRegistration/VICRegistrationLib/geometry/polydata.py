"""Triangles as VTK data."""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData


def polydata(points: np.ndarray, triangles: np.ndarray) -> vtkPolyData:
    """Triangles as VTK data.

    Parameters
    ----------
    points : (n, 3) array_like
    triangles : (m, 3) array_like of int

    Returns
    -------
    vtkPolyData
        With copies of the arrays, in the frame of the points.
    """
    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(np.ascontiguousarray(points, dtype=float), deep=True))
    data = vtkPolyData()
    data.SetPoints(vertices)
    data.SetPolys(cell_array(triangles))
    return data


def cell_array(triangles: np.ndarray) -> vtkCellArray:
    """Triangles, (m, 3) of int, as VTK's cells."""
    cells = vtkCellArray()
    cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(triangles, dtype=np.int64).ravel(), deep=True))
    return cells
