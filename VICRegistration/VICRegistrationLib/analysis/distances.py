"""Distances between a fitted surface and a reference: points spread over surfaces, and signed distances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

from ..geometry.polydata import polydata
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..geometry.triangles import area_vectors
from ..geometry.triangulation import TriangleMesh
from .reference_meshes import ReferenceMesh

# Cells in u and in v within which the area element is taken as constant: it changes by about 1 % across one.
_CELLS = (256, 256)


@dataclass(frozen=True)
class Deviation:
    """Distances between a reference and a fitted surface, all in mm.

    Parameters
    ----------
    mean, std, rms, median, p95, maximum : float
        Mean, standard deviation, root mean square, median, 95th percentile and maximum of the absolute distance.
    mean_signed : float
        Mean of the signed distance: positive where the fitted surface lies outside of the reference.
    n : int
        Number of points.
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
        """Return mean, 95th percentile and maximum in words."""
        return (
            f"mean {self.mean:.2f} mm, signed {self.mean_signed:+.2f} mm, 95 % below {self.p95:.2f} mm, "
            f"largest {self.maximum:.2f} mm"
        )


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
    """Choose random points, uniformly over the area of a reference.

    Parameters
    ----------
    reference : BSplineSurface, TriangleMesh or ReferenceMesh
        RAS mm.
    n_points : int

    Returns
    -------
    (n_points, 3) ndarray
        RAS mm; always the same for the same reference.

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
    # The upper triangle of the unit square is reflected onto the lower one.
    a, b = np.where(a + b > 1.0, 1.0 - a, a), np.where(a + b > 1.0, 1.0 - b, b)
    return corner + a * (first - corner) + b * (second - corner)


def signed_distances(mesh: ReferenceMesh, points: np.ndarray) -> np.ndarray:
    """Compute signed distances of points from closed triangles.

    Parameters
    ----------
    mesh : ReferenceMesh
        From `closed_mesh`.
    points : (n, 3) array_like
        RAS mm.

    Returns
    -------
    (n,) ndarray
        Distance to the nearest triangle, mm, positive outside.

    Notes
    -----
    VTK's implicit distance: the sign follows from the triangle's normal. Where an edge or a corner is nearest, it
    follows from the normals of its triangles weighted by their angles, which is right for every closed mesh (Baerentzen
    and Aanaes, 2005).
    """
    points = np.ascontiguousarray(points, dtype=float)
    if not len(points):
        return np.zeros(0)
    distance, found = vtkImplicitPolyDataDistance(), vtkDoubleArray()
    distance.SetInput(polydata(mesh.points, mesh.triangles))
    distance.EvaluateFunction(numpy_to_vtk(points), found)
    return vtk_to_numpy(found).copy()


def _points_on_surface(surface: BSplineSurface, n_points: int, random: np.random.Generator) -> np.ndarray:
    """Choose points of a surface: cells of its domain by their area, then a place in each cell."""
    edges = [np.linspace(low, high, count + 1) for (low, high), count in zip(surface.domain, _CELLS)]
    middles = [(edge[1:] + edge[:-1]) / 2.0 for edge in edges]
    areas = np.linalg.norm(surface.grid_area_vectors(*middles), axis=2)
    cells = np.unravel_index(_chosen(areas.ravel(), n_points, random), areas.shape)
    u, v = (edge[cell] + random.random(n_points) * (edge[1] - edge[0]) for edge, cell in zip(edges, cells))
    return surface.points(u, v)


def _chosen(weights: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Choose indices with probabilities proportional to weights."""
    total = np.cumsum(weights)
    if not len(total) or not total[-1] > 0.0:
        msg = "The reference has no area; give a surface or a mesh with triangles."
        raise ValueError(msg)
    return np.searchsorted(total, random.random(count) * total[-1], side="right").clip(0, len(total) - 1)
