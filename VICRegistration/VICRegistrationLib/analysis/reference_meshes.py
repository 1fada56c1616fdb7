"""Reference meshes: of a mask, or of other programs after repair for signed distances; their connected pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D, vtkPolyDataNormals

from ..export.surface_data import triangles_in
from ..geometry.polydata import polydata
from ..geometry.triangles import enclosed_volume
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image

# A mesh is flat if its volume is below this share of the cube of its box's diagonal.
_FLAT = 1e-9
# Corners within this distance are joined, as a share of the largest coordinate: about ten times the spacing of single
# precision numbers, which most mesh files have.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class ReferenceMesh:
    """Triangles of a reference.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen from outside.
    """

    points: np.ndarray
    triangles: np.ndarray


def mesh_of_mask(mask: Image) -> ReferenceMesh:
    """Make the surface of a label image.

    Parameters
    ----------
    mask : Image
        1 in the organ and 0 outside, or shares of the organ; the surface is the isosurface at 0.5. The grid may be
        oblique and left-handed.

    Returns
    -------
    ReferenceMesh
        Closed, RAS mm. Where the organ touches the border of the volume, the surface is half a voxel outside of the
        outermost voxel centres.

    Raises
    ------
    ValueError
        If no voxel is above 0.5.

    Notes
    -----
    Flying edges (Schroeder, Maynard, Geveci, 2015) in voxel indices, then mapped to RAS.
    """
    array = np.pad(np.asarray(mask.array, dtype=np.float32), 1)
    if not array.max() > 0.5:
        msg = "No voxel of the mask is above 0.5; a reference needs an organ, choose another label."
        raise ValueError(msg)
    volume = vtkImageData()
    volume.SetDimensions(*array.shape[::-1])
    volume.GetPointData().SetScalars(numpy_to_vtk(array.ravel(), deep=True))
    contour = vtkFlyingEdges3D()
    contour.SetInputData(volume)
    contour.SetValue(0, 0.5)
    contour.ComputeNormalsOff()
    contour.ComputeGradientsOff()
    contour.ComputeScalarsOff()
    contour.Update()
    ijk, triangles = triangles_in(contour.GetOutput())
    points = mask.to_ras(ijk - 1.0)
    # A left-handed grid reverses the orientation of the triangles.
    return ReferenceMesh(points, triangles if enclosed_volume(points, triangles) > 0.0 else triangles[:, ::-1])


def closed_mesh(mesh: TriangleMesh | ReferenceMesh) -> ReferenceMesh:
    """Repair triangles for signed distances, or refuse them.

    Parameters
    ----------
    mesh : TriangleMesh or ReferenceMesh
        RAS mm. Points may be repeated (as in an STL file), also with rounding errors, and so may triangles, which may
        have the wrong orientation.

    Returns
    -------
    ReferenceMesh
        Distinct points, triangles with three distinct corners, counter-clockwise seen from outside; RAS mm.

    Raises
    ------
    ValueError
        If there are no triangles, coordinates are not finite, the mesh is open or encloses no volume.

    Notes
    -----
    Triangles are oriented consistently if they are not; then all of them outward, by the sign of the enclosed volume.
    An inner surface stays one if its triangles have the opposite orientation in the file.
    """
    points, triangles = np.asarray(mesh.points, dtype=float), np.asarray(mesh.triangles)
    if not len(triangles):
        msg = "The mesh has no triangles; give one that encloses an organ."
        raise ValueError(msg)
    if not np.isfinite(points).all():
        msg = "The mesh has points that are not finite (NaN or infinite); repair it where it was made."
        raise ValueError(msg)
    given = points, triangles
    for rounded, copies in ((False, False), (False, True), (True, False)):
        points, triangles = _joined(*given, rounded=rounded)
        triangles = triangles if copies else _without_copies(triangles)
        open_edges, turned_edges = _unmatched_edges(triangles, len(points))
        if not open_edges:
            break
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
    """Split a mesh into its connected pieces.

    Parameters
    ----------
    mesh : ReferenceMesh
        From `closed_mesh`.

    Returns
    -------
    tuple of ReferenceMesh
        By enclosed volume, the largest first; inner surfaces, whose volume is negative, come last.
    """
    count = len(mesh.points)
    start, end = mesh.triangles[:, [0, 1]].ravel(), mesh.triangles[:, [1, 2]].ravel()
    links = sparse.coo_matrix((np.ones(len(start), dtype=np.int8), (start, end)), shape=(count, count))
    _, piece = csgraph.connected_components(links, directed=False)
    of_triangle = piece[mesh.triangles[:, 0]]
    found = [ReferenceMesh(mesh.points, mesh.triangles[of_triangle == number]) for number in np.unique(of_triangle)]
    return tuple(sorted(found, key=lambda part: enclosed_volume(part.points, part.triangles), reverse=True))


def turned_alike(points: np.ndarray, triangles: np.ndarray) -> vtkPolyData:
    """Orient triangles consistently and outward, and add point normals.

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


def _joined(points: np.ndarray, triangles: np.ndarray, *, rounded: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Join corners at the same place, and drop triangles without three distinct corners.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int
    rounded : bool
        Whether to join corners that differ by rounding, too.

    Returns
    -------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int
    """
    points, number = np.unique(points, axis=0, return_inverse=True)
    number = number.reshape(-1)
    if rounded:
        near = cKDTree(points).query_pairs(_ROUNDING * np.abs(points).max(), output_type="ndarray")
        links = sparse.coo_matrix((np.ones(len(near), dtype=np.int8), near.T), shape=(len(points), len(points)))
        _, group = csgraph.connected_components(links, directed=False)
        _, first = np.unique(group, return_index=True)
        points, number = points[first], group[number]
    triangles = number[triangles].astype(np.int64)
    a, b, c = triangles.T
    return points, triangles[(a != b) & (b != c) & (c != a)]


def _without_copies(triangles: np.ndarray) -> np.ndarray:
    """Drop repeated triangles.

    Parameters
    ----------
    triangles : (m, 3) ndarray of int

    Returns
    -------
    (k, 3) ndarray of int
        If all triangles are repeated, one of each, whatever the orientation of its copies (a two-sided surface). Else
        one of each orientation: where two bodies touch, each has its own triangles.
    """
    corners = np.sort(triangles, axis=1)
    first = np.argmin(triangles, axis=1)
    following = triangles[np.arange(len(triangles)), (first + 1) % 3]
    turned = following == corners[:, 2]
    _, place, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
    if len(count) and count.min() > 1:
        return triangles[np.sort(place)]
    _, place = np.unique(np.column_stack([corners, turned]), axis=0, return_index=True)
    return triangles[np.sort(place)]


def _unmatched_edges(triangles: np.ndarray, n_points: int) -> tuple[int, int]:
    """Count the edges with an odd number of triangles, and those whose triangles are oriented inconsistently."""
    start, end = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    keys = np.minimum(start, end) * n_points + np.maximum(start, end)
    _, edge, uses = np.unique(keys, return_inverse=True, return_counts=True)
    balance = np.bincount(edge.reshape(-1), np.where(start < end, 1.0, -1.0))
    return int(np.count_nonzero(uses % 2)), int(np.count_nonzero(balance))
