"""How far a fitted surface is from the true one: points spread over surfaces, and signed distances from closed ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D, vtkImplicitPolyDataDistance, vtkPolyDataNormals

from ..export.surface_data import triangles_in
from ..geometry.polydata import polydata
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..geometry.triangles import area_vectors, enclosed_volume
from ..geometry.triangulation import TriangleMesh
from ..imaging.image import Image
from .mesh_repair import joined, without_copies

# Cells in u and in v within which the area of a surface is taken as evenly spread: it changes by some 1 % across one.
_CELLS = (256, 256)
# A mesh whose volume is below this fraction of that of its bounding cube is flat.
_FLAT = 1e-9


@dataclass(frozen=True)
class Deviation:
    """Distances between a reference and a fitted surface, all in mm.

    Parameters
    ----------
    mean, std, rms, median, p95, maximum : float
        Of the distance, which is never negative: mean, standard deviation, root of the mean square, median, 95th
        percentile and largest.
    mean_signed : float
        Mean of the signed distance: positive where the fitted surface lies outside of the reference.
    n : int
        Number of points that were measured at.
    """

    mean: float
    std: float
    rms: float
    median: float
    p95: float
    maximum: float
    mean_signed: float
    n: int

    @classmethod
    def of(cls, signed: np.ndarray) -> Deviation:
        """Summarize signed distances.

        Parameters
        ----------
        signed : (n,) ndarray
            mm, positive where the fitted surface lies outside of the reference; one or more.

        Returns
        -------
        Deviation
        """
        distances = np.abs(signed)
        return cls(
            mean=float(distances.mean()),
            std=float(distances.std()),
            rms=float(np.sqrt(np.mean(distances**2))),
            median=float(np.median(distances)),
            p95=float(np.percentile(distances, 95)),
            maximum=float(distances.max()),
            mean_signed=float(signed.mean()),
            n=len(distances),
        )

    def sentence(self) -> str:
        """Say it in words."""
        return (
            f"mean {self.mean:.2f} mm, signed {self.mean_signed:+.2f} mm, 95 % below {self.p95:.2f} mm, "
            f"largest {self.maximum:.2f} mm"
        )


@dataclass(frozen=True, eq=False)
class ReferenceMesh:
    """Triangles to measure against.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen from outside.
    """

    points: np.ndarray
    triangles: np.ndarray


Reference = Union[BSplineSurface, TriangleMesh, ReferenceMesh]


def deviation(fitted: BSplineSurface, reference: Reference, *, n_points: int = 10_000) -> Deviation:
    """Measure a fitted surface against a reference.

    Parameters
    ----------
    fitted : BSplineSurface
        RAS mm, outward normals.
    reference : BSplineSurface, TriangleMesh or ReferenceMesh
        RAS mm.
    n_points : int
        Number of points of the reference, spread evenly over its area.

    Returns
    -------
    Deviation

    Raises
    ------
    ValueError
        If there are no points to measure at.

    Notes
    -----
    From each point of the reference to the closest point of the exact fitted surface, not of its triangles.
    """
    return Deviation.of(signed_to_surface(fitted, reference, n_points))


def signed_to_surface(fitted: BSplineSurface, reference: Reference, n_points: int) -> np.ndarray:
    """Signed distances from points of a reference to the exact fitted surface.

    Parameters
    ----------
    fitted, reference, n_points
        As for :func:`deviation`.

    Returns
    -------
    (n_points,) ndarray
        mm, positive where the fitted surface lies outside of the reference.

    Raises
    ------
    ValueError
        If there are no points to measure at.
    """
    if n_points < 1:
        msg = f"{n_points} points were asked for; give at least one to measure at."
        raise ValueError(msg)
    # A reference point on the outer side of the fitted surface means that the fitted surface lies inside.
    return -closest_points(fitted, points_on(reference, n_points)).distances


def points_on(reference: Reference, n_points: int) -> np.ndarray:
    """Points spread evenly over the area of a reference.

    Parameters
    ----------
    reference : BSplineSurface, TriangleMesh or ReferenceMesh
        RAS mm.
    n_points : int

    Returns
    -------
    (n_points, 3) ndarray
        RAS mm; the same for the same reference.

    Raises
    ------
    ValueError
        If the reference has no area.
    """
    random = np.random.default_rng(0)
    if isinstance(reference, BSplineSurface):
        return _points_on_surface(reference, n_points, random)
    points, triangles = np.asarray(reference.points, dtype=float), np.asarray(reference.triangles)
    chosen = triangles[_chosen(np.linalg.norm(area_vectors(points, triangles), axis=1), n_points, random)]
    corner, first, second = (points[chosen[:, number]] for number in range(3))
    a, b = random.random((2, n_points, 1))
    # The unit square folded onto its lower triangle.
    a, b = np.where(a + b > 1.0, 1.0 - a, a), np.where(a + b > 1.0, 1.0 - b, b)
    return corner + a * (first - corner) + b * (second - corner)


def mesh_of_mask(mask: Image) -> ReferenceMesh:
    """Surface of a label image, for measuring against a segmentation.

    Parameters
    ----------
    mask : Image
        Voxels of the organ are 1, others 0; the surface lies where fractions are a half. The grid may be
        oblique and left-handed.

    Returns
    -------
    ReferenceMesh
        Closed; where the organ touches the border of the volume, the surface passes half a voxel outside of the outer
        voxel centres.

    Raises
    ------
    ValueError
        If no voxel is more than a half.

    Notes
    -----
    Flying edges (Schroeder, Maynard, Geveci, 2015) on the grid's indices, whose points are then taken to the world.
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
    # On a left-handed grid the order of the corners turns over with the space.
    return ReferenceMesh(points, triangles if enclosed_volume(points, triangles) > 0.0 else triangles[:, ::-1])


def closed_mesh(mesh: TriangleMesh | ReferenceMesh) -> ReferenceMesh:
    """Make triangles fit for signed distances, or refuse them.

    Parameters
    ----------
    mesh : TriangleMesh or ReferenceMesh
        RAS mm. Points may be there twice (as in an STL file), also with other roundings, and so may triangles; they may
        be turned the wrong way.

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
    given = points, triangles
    for rounded, copies in ((False, False), (False, True), (True, False)):
        points, triangles = joined(*given, rounded=rounded)
        triangles = triangles if copies else without_copies(triangles)
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
    VTK's implicit distance: the side follows from the triangle's normal and, where an edge or a corner is nearest, by
    their normals weighted with the angle, which is right for every closed mesh (Baerentzen and Aanaes, 2005).
    """
    points = np.ascontiguousarray(points, dtype=float)
    if not len(points):
        return np.zeros(0)
    distance, found = vtkImplicitPolyDataDistance(), vtkDoubleArray()
    distance.SetInput(polydata(mesh.points, mesh.triangles))
    distance.EvaluateFunction(numpy_to_vtk(points), found)
    return vtk_to_numpy(found).copy()


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


def _unmatched_edges(triangles: np.ndarray, n_points: int) -> tuple[int, int]:
    """Count the edges with an odd number of triangles, and those that their triangles do not run both ways."""
    start, end = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    keys = np.minimum(start, end) * n_points + np.maximum(start, end)
    _, edge, uses = np.unique(keys, return_inverse=True, return_counts=True)
    balance = np.bincount(edge.reshape(-1), np.where(start < end, 1.0, -1.0))
    return int(np.count_nonzero(uses % 2)), int(np.count_nonzero(balance))


def _points_on_surface(surface: BSplineSurface, n_points: int, random: np.random.Generator) -> np.ndarray:
    """Exact points of a surface: cells of its domain chosen by their area, then a place in the cell."""
    edges = [np.linspace(low, high, count + 1) for (low, high), count in zip(surface.domain, _CELLS)]
    middles = [(edge[1:] + edge[:-1]) / 2.0 for edge in edges]
    areas = np.linalg.norm(surface.grid_area_vectors(*middles), axis=2)
    cells = np.unravel_index(_chosen(areas.ravel(), n_points, random), areas.shape)
    u, v = (edge[cell] + random.random(n_points) * (edge[1] - edge[0]) for edge, cell in zip(edges, cells))
    return surface.points(u, v)


def _chosen(weights: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Numbers of entries chosen with a probability in proportion to their weights."""
    total = np.cumsum(weights)
    if not len(total) or not total[-1] > 0.0:
        msg = "The reference has no area; give a surface or a mesh with triangles."
        raise ValueError(msg)
    return np.searchsorted(total, random.random(count) * total[-1], side="right").clip(0, len(total) - 1)
