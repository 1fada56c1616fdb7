"""Triangles of nearly equal size and shape on an organ's surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..export.frames import RAS_TO_LPS
from ..export.step import Solid, step_text, validate_solids
from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh
from .options import MeshOptions
from .process import MeshingError, run_worker
from .relaxing import corner_angles, relaxed
from .tetrahedra import require_mesher


@dataclass(frozen=True)
class TriangleQuality:
    """Shape of triangles.

    Parameters
    ----------
    triangles, nodes : int
    angle_min, angle_max : float
        Smallest and largest angle of all, degrees; 60 is the best for both.
    edge_min, edge_mean, edge_max : float
        mm.
    """

    triangles: int
    nodes: int
    angle_min: float
    angle_max: float
    edge_min: float
    edge_mean: float
    edge_max: float

    def lines(self) -> list[str]:
        """Report for people, one fact a line."""
        return [
            f"{self.triangles} triangles, {self.nodes} nodes",
            f"angles: {self.angle_min:.1f} to {self.angle_max:.1f} degrees",
            f"edges: {self.edge_min:.2f} to {self.edge_max:.2f} mm, mean {self.edge_mean:.2f} mm",
        ]


def surface_mesh(
    surface: BSplineSurface,
    size: float,
    *,
    name: str = "organ",
    time_limit: float = 600.0,
    on_progress: Callable[[str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> TriangleMesh:
    """Cover a closed surface with nearly equal triangles, by gmsh.

    Parameters
    ----------
    surface : BSplineSurface
        Closed and valid; RAS mm.
    size : float
        Edge of the triangles, mm.
    name : str
        Name of the organ, for messages.
    time_limit, on_progress, cancelled
        As in :func:`.tetrahedra.mesh_organs`.

    Returns
    -------
    TriangleMesh
        With nodes, normals and parameters of the exact surface.

    Raises
    ------
    ValueError
        If the surface is no valid solid, or the size makes no sense.
    MeshingError
        With one sentence, if gmsh is not installed, crashes, takes too long or returns no closed surface.
    """
    size = MeshOptions(size=size, time_limit=time_limit).size
    module = require_mesher("gmsh")
    validate_solids([Solid(name, surface)])
    job = {"surface": "surface.step", "size": float(size)}
    files = {"surface.step": step_text([Solid(name, surface)])}
    result = run_worker(
        module, job, files, name="gmsh", time_limit=time_limit, on_progress=on_progress, cancelled=cancelled
    )
    try:
        points, triangles = result.arrays["points"] * RAS_TO_LPS, result.arrays["triangles"]
    except KeyError as error:
        msg = "gmsh returned no triangles; choose another element size."
        raise MeshingError(msg) from error
    _check_closed(triangles)
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = _outward(points[used], triangles.reshape(-1, 3))
    points, triangles = relaxed(surface, closest_points(surface, points[used]).points, triangles)
    parameters = closest_points(surface, points).parameters
    return TriangleMesh(surface.points(*parameters.T), triangles, surface.normals(*parameters.T), parameters)


def triangle_quality(points: np.ndarray, triangles: np.ndarray) -> TriangleQuality:
    """Measure triangles.

    Parameters
    ----------
    points : (n, 3) ndarray
    triangles : (m, 3) ndarray of int

    Returns
    -------
    TriangleQuality
    """
    corners = points[triangles]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    angles = np.degrees(corner_angles(points, triangles))
    return TriangleQuality(
        triangles=len(triangles),
        nodes=len(np.unique(triangles)),
        angle_min=float(angles.min()),
        angle_max=float(angles.max()),
        edge_min=float(lengths.min()),
        edge_mean=float(lengths.mean()),
        edge_max=float(lengths.max()),
    )


def _check_closed(triangles: np.ndarray) -> None:
    """Refuse triangles of which an edge has not just two."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if not len(triangles) or (count != 2).any():
        msg = "gmsh returned triangles that do not close the surface; choose another element size."
        raise MeshingError(msg)


def _outward(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles counter-clockwise seen from outside."""
    a, b, c = (points[triangles[:, k]] - points.mean(axis=0) for k in range(3))
    inward = np.einsum("nk,nk->", np.cross(b, c), a) < 0.0
    return triangles[:, [0, 2, 1]] if inward else triangles
