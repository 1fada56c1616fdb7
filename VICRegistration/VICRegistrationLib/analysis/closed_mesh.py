"""Closed triangles to measure against: made sound, and signed distances from them."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance, vtkPolyDataNormals

from ..export.surface_data import polydata, triangles_in
from ..geometry.triangles import enclosed_volume
from ..geometry.triangulation import TriangleMesh
from .distances import ReferenceMesh

# A mesh whose volume is below this fraction of that of its bounding ball is flat.
_FLAT = 1e-9


def closed_mesh(mesh: TriangleMesh | ReferenceMesh) -> ReferenceMesh:
    """Make triangles fit for signed distances, or refuse them.

    Parameters
    ----------
    mesh : TriangleMesh or ReferenceMesh
        RAS mm. Points may be there twice (as in an STL file), triangles may be turned the wrong way.

    Returns
    -------
    ReferenceMesh
        Each point once, no triangle without corners of its own, counter-clockwise seen from outside.

    Raises
    ------
    ValueError
        If there are no triangles, coordinates are not finite, the mesh is open or encloses no volume.

    Notes
    -----
    Neighbours are turned alike where they are not; then all of them outward, by the sign of the enclosed volume. A
    hollow stays one if the file has its triangles turned the other way.
    """
    points, triangles = np.asarray(mesh.points, dtype=float), np.asarray(mesh.triangles)
    if not len(triangles):
        msg = "The mesh has no triangles; give one that encloses an organ."
        raise ValueError(msg)
    if not np.isfinite(points).all():
        msg = "The mesh has points that are not finite (NaN or infinite); repair it where it was made."
        raise ValueError(msg)
    points, number = np.unique(points, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[triangles].astype(np.int64)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    open_edges, turned_edges = _doubtful_edges(triangles, len(points))
    if open_edges:
        msg = (
            f"The mesh is open: {open_edges} edges have a triangle without a neighbour; inside and outside need a "
            "closed one, so fill its holes first."
        )
        raise ValueError(msg)
    if turned_edges:
        points, triangles = triangles_in(turned_alike(points, triangles))
    volume = enclosed_volume(points, triangles)
    if not abs(volume) > _FLAT * np.linalg.norm(np.ptp(points, axis=0)) ** 3:
        msg = "The mesh encloses no volume; give one of a solid organ."
        raise ValueError(msg)
    return ReferenceMesh(points, triangles if volume > 0.0 else triangles[:, ::-1])


def pieces(mesh: ReferenceMesh) -> tuple[ReferenceMesh, ...]:
    """Take a mesh apart into those pieces that have no point in common.

    Parameters
    ----------
    mesh : ReferenceMesh
        From `closed_mesh`.

    Returns
    -------
    tuple of ReferenceMesh
        The one that encloses most first; hollows, which are turned inside out, are last.
    """
    count = len(mesh.points)
    start, end = mesh.triangles[:, [0, 1]].ravel(), mesh.triangles[:, [1, 2]].ravel()
    links = sparse.coo_matrix((np.ones(len(start), dtype=np.int8), (start, end)), shape=(count, count))
    _, piece = csgraph.connected_components(links, directed=False)
    of_triangle = piece[mesh.triangles[:, 0]]
    found = [ReferenceMesh(mesh.points, mesh.triangles[of_triangle == number]) for number in np.unique(of_triangle)]
    return tuple(sorted(found, key=lambda part: enclosed_volume(part.points, part.triangles), reverse=True))


def signed_distances(mesh: ReferenceMesh, points: np.ndarray) -> np.ndarray:
    """Signed distances of points from triangles.

    Parameters
    ----------
    mesh : ReferenceMesh
        From `closed_mesh`.
    points : (n, 3) array_like
        RAS mm.

    Returns
    -------
    (n,) ndarray
        mm to the nearest triangle, positive outside.

    Notes
    -----
    VTK's implicit distance: the side is told by the triangle's normal and, where an edge or a corner is nearest, by
    their normals weighted with the angle, which is right for every closed mesh (Baerentzen and Aanaes, 2005).
    """
    points = np.ascontiguousarray(points, dtype=float)
    if not len(points):
        return np.zeros(0)
    distance, found = vtkImplicitPolyDataDistance(), vtkDoubleArray()
    distance.SetInput(polydata(mesh.points, mesh.triangles))
    distance.EvaluateFunction(numpy_to_vtk(points), found)
    return vtk_to_numpy(found).copy()


def _doubtful_edges(triangles: np.ndarray, n_points: int) -> tuple[int, int]:
    """Count the edges with an odd number of triangles, and those that their triangles do not run both ways."""
    start, end = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    keys = np.minimum(start, end) * n_points + np.maximum(start, end)
    _, edge, uses = np.unique(keys, return_inverse=True, return_counts=True)
    balance = np.bincount(edge.reshape(-1), np.where(start < end, 1.0, -1.0))
    return int(np.count_nonzero(uses % 2)), int(np.count_nonzero(balance))


def turned_alike(points: np.ndarray, triangles: np.ndarray) -> vtkPolyData:
    """Turn triangles so that neighbours agree, outward, with the normals of their points as VTK shades them.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int

    Returns
    -------
    vtkPolyData
    """
    normals = vtkPolyDataNormals()
    normals.SetInputData(polydata(points, triangles))
    normals.SplittingOff()
    normals.ConsistencyOn()
    normals.AutoOrientNormalsOn()
    normals.Update()
    return normals.GetOutput()
