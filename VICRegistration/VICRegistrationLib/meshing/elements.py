"""Meshes of tetrahedra with 4 or 10 nodes: faces, volumes, and quality of the elements.

Nodes are numbered as in VTK and Abaqus: four corners, then the middles of the edges 01, 12, 20, 03, 13 and 23. The
first three corners are counter-clockwise seen from the fourth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..messages import Diagnostic

EDGES = np.array([(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])
TRIANGLE_EDGES = EDGES[:3]
# Corners, then middles of the edges, counter-clockwise seen from outside; the order is that of Abaqus (S1 to S4).
FACES = np.array([(0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (2, 0, 3, 6, 7, 9)])
_CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
NODES = np.concatenate([_CORNERS, _CORNERS[EDGES].mean(axis=1)])
# Five points that integrate cubic polynomials exactly (Keast 1986).
_INNER = np.where(np.eye(4)[:, 1:] > 0, 0.5, 1.0 / 6.0)
_KEAST_POINTS = np.concatenate([np.full((1, 3), 0.25), _INNER])
_KEAST_WEIGHTS = np.array([-0.8, 0.45, 0.45, 0.45, 0.45]) / 6.0
# Corners and middles of a face of second order as four flat triangles.
_QUARTERS = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])
# Elements whose Jacobians are held in memory at a time.
_BLOCK = 50_000


@dataclass(frozen=True, eq=False)
class TetrahedralMesh:
    """Tetrahedra of one or several organs, and the triangles of their surfaces.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4 or 10) ndarray of int
        Corners, with second order also the middles of the edges 01, 12, 20, 03, 13 and 23 (as VTK and Abaqus count).
    tetrahedron_groups : dict of str to ndarray of int
        Rows of `tetrahedra`: NAME of a solid organ, or NAME_wall. Every tetrahedron is in one group.
    triangles : (t, 3 or 6) ndarray of int
        Counter-clockwise seen from outside; with second order also the middles of the edges 01, 12 and 20.
    triangle_groups : dict of str to ndarray of int
        Rows of `triangles`: NAME_surface, or NAME_inside and NAME_outside of a wall, or NAME_surface_I_J of their
        patches; and A_B_interface where two groups of tetrahedra meet. Every triangle is in one group.
    exact_volumes : dict of str to float
        Volumes of the exact solids by group of tetrahedra, mm^3.
    notes : tuple of Diagnostic
        Notes for the user: overlaps that were resolved, poor elements.
    shells : dict of str to float
        Thickness, mm, of those groups of triangles that are shell elements.
    node_groups : dict of str to ndarray of int
        Rows of `points`, such as fixed nodes.
    """

    points: np.ndarray
    tetrahedra: np.ndarray
    tetrahedron_groups: dict[str, np.ndarray]
    triangles: np.ndarray
    triangle_groups: dict[str, np.ndarray]
    exact_volumes: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[Diagnostic, ...] = ()
    shells: Mapping[str, float] = field(default_factory=dict)
    node_groups: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def order(self) -> int:
        """1 for four nodes, 2 for ten."""
        return 1 if self.tetrahedra.shape[1] == 4 else 2


def faces_of(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the distinct faces of tetrahedra.

    Parameters
    ----------
    tetrahedra : (m, 4 or 10) ndarray of int

    Returns
    -------
    faces : (f, 3 or 6) ndarray of int
        Nodes, counter-clockwise seen from outside of the first owner.
    first, second : (f,) ndarray of int
        The tetrahedra on both sides; `second` is -1 on the boundary.
    """
    local = FACES[:, :3] if tetrahedra.shape[1] == 4 else FACES
    faces = tetrahedra[:, local].transpose(1, 0, 2).reshape(-1, local.shape[1])
    owner = np.tile(np.arange(len(tetrahedra)), 4)
    key = np.sort(faces[:, :3], axis=1)
    order = np.lexsort(key.T[::-1])
    key = key[order]
    new = np.ones(len(key), dtype=bool)
    new[1:] = (key[1:] != key[:-1]).any(axis=1)
    starts = np.flatnonzero(new)
    first = owner[order[starts]]
    second = np.full(len(starts), -1)
    paired = np.flatnonzero(np.diff(np.append(starts, len(key))) > 1)
    second[paired] = owner[order[starts[paired] + 1]]
    return faces[order[starts]], first, second


def flat_triangles(faces: np.ndarray) -> np.ndarray:
    """Split faces of second order into flat triangles.

    Parameters
    ----------
    faces : (f, 3 or 6) ndarray of int
        Corners, and the middles of the edges 01, 12 and 20.

    Returns
    -------
    (f, 3) or (4 f, 3) ndarray of int
        The four of a face are in consecutive rows.
    """
    return faces if faces.shape[1] == 3 else faces[:, _QUARTERS].reshape(-1, 3)


def volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Volumes of tetrahedra, (m,) mm^3; exact for curved ones too, negative for inverted ones."""
    second = tetrahedra.shape[1] == 10
    places, weights = (_KEAST_POINTS, _KEAST_WEIGHTS) if second else (_KEAST_POINTS[:1], np.array([1.0 / 6.0]))
    return _over_elements(points, tetrahedra, places, lambda matrices: np.linalg.det(matrices) @ weights)


def scaled_jacobians(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Scaled Jacobian of each tetrahedron: 1 for a regular one, 0 for a flat one, negative for an inverted one.

    Parameters
    ----------
    points : (n, 3) ndarray
    tetrahedra : (m, 4 or 10) ndarray of int

    Returns
    -------
    (m,) ndarray

    Notes
    -----
    sqrt(2) det J divided by the largest product of the three edges at a corner (Verdict library, Stimpson et al. 2007).
    With ten nodes, the least value at the nodes, each of the straight tetrahedron that J spans there.
    """
    places = NODES[:1] if tetrahedra.shape[1] == 4 else NODES
    return _over_elements(points, tetrahedra, places, lambda matrices: _scaled(matrices).min(axis=1))


def poor_element(points: np.ndarray, tetrahedra: np.ndarray, least_quality: float) -> dict[str, float]:
    """Find the worst element of a mesh if its scaled Jacobian is too small.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4 or 10) ndarray of int
    least_quality : float
        Scaled Jacobian from which on no element is poor.

    Returns
    -------
    dict of str to float
        Values of a diagnostic: its centre ``r``, ``a``, ``s`` (mm), ``jacobian``, and ``good``, the least quality.
        Empty if no element is poor.
    """
    jacobian = scaled_jacobians(points, tetrahedra)
    worst = int(np.argmin(jacobian))
    if jacobian[worst] >= least_quality:
        return {}
    center = points[tetrahedra[worst, :4]].mean(axis=0).tolist()
    return {**dict(zip("ras", center)), "jacobian": float(jacobian[worst]), "good": least_quality}


def _over_elements(points: np.ndarray, tetrahedra: np.ndarray, places: np.ndarray, measure) -> np.ndarray:
    """Apply a function to the Jacobians of elements, (m, k, 3, 3), block by block to save memory."""
    blocks = [
        measure(_jacobians(points, tetrahedra[start : start + _BLOCK], places))
        for start in range(0, len(tetrahedra), _BLOCK)
    ]
    return np.concatenate(blocks) if blocks else np.zeros(0)


def _jacobians(points: np.ndarray, tetrahedra: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Jacobian matrices of elements at places (k, 3) of the unit tetrahedron: (m, k, 3, 3)."""
    derivatives = _shape_derivatives(tetrahedra.shape[1], places)
    return np.einsum("mni,knj->mkij", points[tetrahedra], derivatives, optimize=True)


def _shape_derivatives(nodes: int, places: np.ndarray) -> np.ndarray:
    """Differentiate the shape functions at places (k, 3) of the unit tetrahedron: (k, 4 or 10, 3)."""
    gradients = np.concatenate([np.full((1, 3), -1.0), np.eye(3)])
    if nodes == 4:
        return np.broadcast_to(gradients, (len(places), 4, 3))
    barycentric = np.column_stack([1.0 - places.sum(axis=1), places])
    corners = (4.0 * barycentric[:, :, None] - 1.0) * gradients
    first, second = EDGES.T
    middles = 4.0 * (barycentric[:, first, None] * gradients[second] + barycentric[:, second, None] * gradients[first])
    return np.concatenate([corners, middles], axis=1)


def _scaled(matrices: np.ndarray) -> np.ndarray:
    """Scaled Jacobians from Jacobian matrices, (..., 3, 3)."""
    columns = np.moveaxis(matrices, -1, 0)
    ends = np.concatenate([np.zeros_like(columns[:1]), columns])
    lengths = [np.linalg.norm(ends[b] - ends[a], axis=-1) for a, b in EDGES]
    # Edges that meet at each corner.
    at_corner = [lengths[i] * lengths[j] * lengths[k] for i, j, k in ((0, 2, 3), (0, 1, 4), (1, 2, 5), (3, 4, 5))]
    largest = np.max(at_corner, axis=0)
    volume = np.linalg.det(matrices)
    return np.divide(np.sqrt(2.0) * volume, largest, out=np.zeros_like(volume), where=largest > 0.0)
