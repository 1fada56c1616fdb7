"""Triangulation of a model, with common vertices on common borders."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import resolution_for_chord_error
from .model import MultiPatchModel, Patch, borders_of
from .topology import sides, sides_by_edge

# Least and most intervals of a patch in each direction.
_LEAST, _MOST = 3, 64


@dataclass(frozen=True, eq=False)
class ModelTriangles:
    """Triangles of all patches.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen against the patches' normals.
    patch_of : (m,) ndarray of int
        Index of each triangle's patch in the model.
    names : tuple of str
        Names of the patches.
    """

    points: np.ndarray
    triangles: np.ndarray
    patch_of: np.ndarray
    names: tuple[str, ...]

    def of(self, patches: Iterable[Patch]) -> np.ndarray:
        """Return a mask of the triangles that belong to the given patches, (m,) of bool."""
        wanted = {patch.name for patch in patches}
        return np.isin(self.patch_of, [number for number, name in enumerate(self.names) if name in wanted])


def model_triangles(model: MultiPatchModel, *, chord_error: float = 0.1) -> ModelTriangles:
    """Triangulate all patches.

    Parameters
    ----------
    model : MultiPatchModel
    chord_error : float
        Largest distance between triangles and surface, mm. It may be exceeded where a patch needs more than 64
        intervals.

    Returns
    -------
    ModelTriangles

    Raises
    ------
    ValueError
        If the chord error is not positive.
    """
    surfaces = [patch.surface(model.points) for patch in model.patches]
    counts = _counts(model, surfaces, chord_error)
    vertices = _Vertices()
    triangles, owners = [], []
    for number, (patch, surface) in enumerate(zip(model.patches, surfaces)):
        own = _triangles(vertices.of_patch(patch, surface, counts[number]))
        triangles.append(own)
        owners.append(np.full(len(own), number))
    points = np.array(vertices.points)
    return ModelTriangles(
        points, np.concatenate(triangles), np.concatenate(owners), tuple(patch.name for patch in model.patches)
    )


def _counts(model: MultiPatchModel, surfaces: list[BSplineSurface], chord_error: float) -> np.ndarray:
    """Intervals in u and v of every patch, (n, 2): the same on both sides of every border."""
    needed = np.array([resolution_for_chord_error(surface, chord_error) for surface in surfaces])
    needed = np.clip(needed, _LEAST, _MOST).ravel()
    number = {patch.name: place for place, patch in enumerate(model.patches)}
    linked = sparse.lil_matrix((len(needed), len(needed)), dtype=bool)
    for first, *others in sides_by_edge(model.patches).values():
        for other in others:
            linked[tuple(2 * number[side.patch.name] + side.axis for side in (first, other))] = True
    _, chain = csgraph.connected_components(linked, directed=False)
    most = np.zeros_like(needed)
    np.maximum.at(most, chain, needed)
    return most[chain].reshape(-1, 2)


class _Vertices:
    """Vertices of the patches, of which those on corners and borders are made once."""

    def __init__(self) -> None:
        self.points: list[np.ndarray] = []
        self._corners: dict[int, int] = {}
        self._edges: dict[tuple[int, ...], np.ndarray] = {}

    def of_patch(self, patch: Patch, surface: BSplineSurface, counts: np.ndarray) -> np.ndarray:
        """Return the indices of the vertices of a patch, (n_u + 1, n_v + 1)."""
        axes = [np.linspace(low, high, count + 1) for (low, high), count in zip(surface.domain, counts)]
        points = surface.grid(*axes)
        vertex = np.full(points.shape[:2], -1)
        corners = ((0, 0), (-1, 0), (0, -1), (-1, -1))
        for place in corners:
            vertex[place] = self._corner(int(patch.indices[place]), points[place])
        places = borders_of(points)
        real = {side.name: side for side in sides(patch)}
        for name, view in borders_of(vertex).items():
            if name not in real:
                view[:] = view[0]
                continue
            side, step = real[name], slice(None) if real[name].same else slice(None, None, -1)
            if side.edge not in self._edges:
                inner = self._add(places[name][step][1:-1])
                self._edges[side.edge] = inner
            view[1:-1] = self._edges[side.edge][step]
        new = vertex < 0
        vertex[new] = self._add(points[new])
        return vertex

    def _corner(self, index: int, point: np.ndarray) -> int:
        if index not in self._corners:
            self._corners[index] = int(self._add(point[None])[0])
        return self._corners[index]

    def _add(self, points: np.ndarray) -> np.ndarray:
        first = len(self.points)
        self.points.extend(points)
        return np.arange(first, len(self.points))


def _triangles(vertex: np.ndarray) -> np.ndarray:
    """Two triangles for each cell of a grid of vertices, with alternating diagonals; only one beside a pole."""
    a, b, c, d = vertex[:-1, :-1], vertex[1:, :-1], vertex[1:, 1:], vertex[:-1, 1:]
    even = (np.add.outer(np.arange(a.shape[0]), np.arange(a.shape[1])) % 2 == 0)[..., None]
    one = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    two = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    triangles = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)])
    i, j, k = triangles.T
    return triangles[(i != j) & (j != k) & (k != i)]
