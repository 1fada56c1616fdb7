"""Watertight triangulation of a B-spline surface: seam and pole vertices are shared."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .surface import BSplineSurface
from .triangles import area_vectors, enclosed_volume


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles with their normals and surface parameters.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen from outside.
    normals : (n, 3) ndarray
        Unit normals of the exact surface.
    parameters : (n, 2) ndarray
        (u, v) of every point.
    """

    points: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    parameters: np.ndarray


def resolution_for_chord_error(surface: BSplineSurface, chord_error: float) -> tuple[int, int]:
    """Choose the numbers of intervals in u and v for a chord error.

    Parameters
    ----------
    surface : BSplineSurface
    chord_error : float
        Largest distance between chord and surface, mm; half of it is allowed in each direction.

    Returns
    -------
    (n_u, n_v)

    Raises
    ------
    ValueError
        If the chord error is not positive.

    Notes
    -----
    A chord over a parameter step h deviates by at most h^2 / 8 max |S''|.
    """
    if not chord_error > 0.0:
        msg = f"A chord error of {chord_error:g} mm was asked for; give a positive length such as 0.05."
        raise ValueError(msg)
    numbers = []
    samples = [np.linspace(low, high, 41) for low, high in surface.domain]
    for axis, (low, high) in enumerate(surface.domain):
        order = {"du": 2} if axis == 0 else {"dv": 2}
        second = np.linalg.norm(surface.grid(*samples, **order), axis=2).max()
        numbers.append(int(np.ceil((high - low) * np.sqrt(second / (8.0 * chord_error / 2.0)))))
    return max(numbers[0], 8), max(numbers[1], 6)


def triangulate(
    surface: BSplineSurface, *, resolution: tuple[int, int] | None = None, chord_error: float = 0.05
) -> TriangleMesh:
    """Triangulate a surface on a regular grid of its parameters.

    Parameters
    ----------
    surface : BSplineSurface
        Open or closed; vertices of seams and poles are shared, so that a closed surface gives a watertight mesh.
    resolution : (n_u, n_v), optional
        Number of intervals in u and v, at least 3 and 2; taken from `chord_error` if not given.
    chord_error : float
        Largest distance between triangles and surface, mm.

    Returns
    -------
    TriangleMesh

    Raises
    ------
    ValueError
        If the chord error is not positive.
    """
    n_u, n_v = resolution or resolution_for_chord_error(surface, chord_error)
    (u_low, u_high), (v_low, v_high) = surface.domain
    axes = np.linspace(u_low, u_high, n_u + 1), np.linspace(v_low, v_high, n_v + 1)
    points, normals = surface.grid(*axes).reshape(-1, 3), surface.grid_normals(*axes).reshape(-1, 3)
    u, v = (part.ravel() for part in np.meshgrid(*axes, indexing="ij"))
    vertex = _shared_vertices(surface, n_u, n_v)
    _, first, vertex = np.unique(vertex.ravel(), return_index=True, return_inverse=True)
    vertex = vertex.reshape(n_u + 1, n_v + 1)
    a, b, c, d = vertex[:-1, :-1], vertex[1:, :-1], vertex[1:, 1:], vertex[:-1, 1:]
    # Diagonals alternate, so that a symmetric surface gets a symmetric mesh.
    even = np.add.outer(np.arange(n_u), np.arange(n_v)) % 2 == 0
    one = np.where(even[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    two = np.where(even[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    triangles = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)])
    i, j, k = triangles.T
    triangles = triangles[(i != j) & (j != k) & (k != i)]
    return TriangleMesh(points[first], triangles, normals[first], np.column_stack([u, v])[first])


def triangulate_volume(surface: BSplineSurface, *, chord_error: float) -> TriangleMesh:
    """Triangulate a closed surface so that the triangles enclose as much as it does.

    Triangles with their corners on a convex surface lie inside of it, by up to two thirds of the chord error. Here all
    corners are moved outward by the same distance, the missing volume divided by the area.

    Parameters
    ----------
    surface : BSplineSurface
        Closed, normals outward.
    chord_error : float
        Largest distance between triangles and surface before the corners are moved, mm; about that afterwards.

    Returns
    -------
    TriangleMesh
        Its points lie slightly off the surface; its parameters and normals are those of the surface.

    Raises
    ------
    ValueError
        If the chord error is not positive.
    """
    mesh = triangulate(surface, chord_error=chord_error)
    area = np.linalg.norm(area_vectors(mesh.points, mesh.triangles), axis=1).sum()
    lack = surface.volume() - enclosed_volume(mesh.points, mesh.triangles)
    return replace(mesh, points=mesh.points + lack / area * mesh.normals)


def _shared_vertices(surface: BSplineSurface, n_u: int, n_v: int) -> np.ndarray:
    """Vertex number of every grid point, (n_u + 1, n_v + 1), equal where points coincide."""
    vertex = np.arange((n_u + 1) * (n_v + 1)).reshape(n_u + 1, n_v + 1)
    if surface.closed_u:
        vertex[-1] = vertex[0]
    if surface.closed_v:
        vertex[:, -1] = vertex[:, 0]
    start, end = surface.poles
    if start:
        vertex[:, 0] = vertex[0, 0]
    if end:
        vertex[:, -1] = vertex[0, -1]
    return vertex
