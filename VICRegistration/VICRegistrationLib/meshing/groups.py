"""Surfaces of a tetrahedral mesh: groups of triangles by their exact surface, and nodes of second order on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from .elements import EDGES, TRIANGLE_EDGES, faces_of, scaled_jacobians

# If a curved edge makes an element too poor, it is curved half as much, at most so often; then it is straight.
_HALVINGS = 4
# Rounds of alternating projections on two surfaces, to find points on their intersection.
_ROUNDS = 4


def surface_groups(
    points: np.ndarray,
    tetrahedra: np.ndarray,
    regions: Mapping[str, np.ndarray],
    surfaces: Mapping[str, BSplineSurface],
    *,
    names: Sequence[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the triangles of the boundary and of interfaces, each in one group.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4 or 10) ndarray of int
    regions : mapping of name to (k,) ndarray of int
        Tetrahedra of every region.
    surfaces : mapping of name to BSplineSurface
        Exact surfaces; a triangle of the boundary belongs to the nearest one.
    names : sequence of str
        Names of the regions in the names of interfaces.

    Returns
    -------
    triangles : (t, 3 or 6) ndarray of int
        Counter-clockwise seen from outside; at an interface, seen from the later region.
    groups : dict of str to ndarray of int
        Those of the surfaces, then "FIRST_SECOND_interface".
    """
    region = np.zeros(len(tetrahedra), dtype=int)
    for number, cells in enumerate(regions.values()):
        region[cells] = number
    faces, first, second = faces_of(tetrahedra)
    outer = second < 0
    between = ~outer & (region[first] != region[second])
    low, high = np.minimum(region[first], region[second]), np.maximum(region[first], region[second])
    turned = between & (region[first] == high)
    faces[turned] = _reversed(faces[turned])
    parts, groups, start = [], {}, 0
    on_surface = _nearest_surface(points, faces[outer], list(surfaces.values()))
    chosen = [(name, np.flatnonzero(outer)[on_surface == number]) for number, name in enumerate(surfaces)]
    for a, b in np.unique(np.column_stack([low, high])[between], axis=0):
        here = np.flatnonzero(between & (low == a) & (high == b))
        chosen.append((f"{names[a]}_{names[b]}_interface", here))
    for name, cells in chosen:
        if len(cells):
            parts.append(faces[cells])
            groups[name] = np.arange(start, start + len(cells))
            start += len(cells)
    return np.concatenate(parts), groups


def patch_groups(
    points: np.ndarray,
    triangles: np.ndarray,
    groups: Mapping[str, np.ndarray],
    surfaces: Mapping[str, BSplineSurface],
    patches: tuple[int, int],
) -> dict[str, np.ndarray]:
    """Divide groups of triangles into patches by the parameters (u, v) of the triangles' middles.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (t, 3 or 6) ndarray of int
    groups : mapping of name to ndarray of int
        Rows of `triangles`, as :func:`surface_groups` makes them.
    surfaces : mapping of name to BSplineSurface
        Surfaces of the groups to be divided; other groups stay as they are.
    patches : (around, along)
        Number of equal steps of u and of v.

    Returns
    -------
    dict of str to ndarray of int
        NAME_I_J in place of NAME, I counted in u and J in v from 1; patches without a triangle are left out.
    """
    if tuple(patches) == (1, 1):
        return dict(groups)
    found: dict[str, np.ndarray] = {}
    for name, rows in groups.items():
        if name not in surfaces:
            found[name] = rows
            continue
        middles = points[triangles[rows][:, :3]].mean(axis=1)
        parameters = closest_points(surfaces[name], middles).parameters
        low, high = np.array(surfaces[name].domain).T
        counts = np.asarray(patches)
        step = np.clip(np.floor((parameters - low) / (high - low) * counts), 0, counts - 1).astype(int)
        for around, along in np.ndindex(*counts):
            here = rows[(step == (around, along)).all(axis=1)]
            if len(here):
                found[f"{name}_{around + 1}_{along + 1}"] = here
    return found


def second_order(
    points: np.ndarray,
    tetrahedra: np.ndarray,
    region: np.ndarray,
    surfaces: Sequence[BSplineSurface],
    *,
    least_quality: float,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Add nodes at the middles of the edges of tetrahedra, on the exact surfaces.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4) ndarray of int
    region : (m,) ndarray of int
    surfaces : sequence of BSplineSurface
        Exact surfaces of the boundary and of the interfaces between regions.
    least_quality : float
        Least scaled Jacobian of curved elements; straight elements that are worse stay straight.

    Returns
    -------
    points : (n + e, 3) ndarray
        RAS mm; the middle nodes come after the corners.
    tetrahedra : (m, 10) ndarray of int
    flattened : int
        Number of edges whose middle is not on the surface, because elements would get worse than that.
    """
    edges, number = np.unique(np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    shift = _shifts(points, tetrahedra, region, surfaces, edges)
    return bent_elements(points, tetrahedra, edges, number.reshape(-1, len(EDGES)), shift, least_quality=least_quality)


def bent_elements(
    points: np.ndarray,
    tetrahedra: np.ndarray,
    edges: np.ndarray,
    number: np.ndarray,
    shift: np.ndarray,
    *,
    least_quality: float,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Curve edges as far as the quality of the elements allows it.

    Parameters
    ----------
    points, tetrahedra, least_quality
        As in :func:`second_order`.
    edges : (e, 2) ndarray of int
        The nodes at their ends.
    number : (m, 6) ndarray of int
        Edges of each element.
    shift : (e, 3) ndarray
        Wanted displacement of their middles, mm.

    Returns
    -------
    points, tetrahedra, flattened
        As of :func:`second_order`.
    """
    straight = points[edges].mean(axis=1)
    curved = (shift != 0.0).any(axis=1)
    share = np.ones(len(edges))
    cells = np.column_stack([tetrahedra, len(points) + number])
    doubtful = np.flatnonzero(curved[number].any(axis=1))
    for halving in range(_HALVINGS + 1):
        nodes = np.concatenate([points, straight + share[:, None] * shift])
        bad = doubtful[scaled_jacobians(nodes, cells[doubtful]) < least_quality]
        if not len(bad):
            break
        share[np.unique(number[bad])] *= 0.5 if halving < _HALVINGS - 1 else 0.0
    nodes = np.concatenate([points, straight + share[:, None] * shift])
    return nodes, cells, int(np.count_nonzero(curved & (share < 1.0)))


def _shifts(points, tetrahedra, region, surfaces, edges) -> np.ndarray:
    """Displacements from the middle of every edge to the surfaces that it belongs to, (e, 3) mm."""
    faces, first, second = faces_of(tetrahedra)
    faces = faces[(second < 0) | (region[first] != region[second])]
    on_surface = _nearest_surface(points, faces, surfaces)
    of_faces = np.sort(faces[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)
    key = edges[:, 0] * len(points) + edges[:, 1]
    row = np.searchsorted(key, of_faces[:, 0] * len(points) + of_faces[:, 1])
    touched = np.zeros((len(surfaces), len(edges)), dtype=bool)
    touched[np.repeat(on_surface, 3), row] = True
    return shifts_to(surfaces, touched, points[edges].mean(axis=1))


def shifts_to(surfaces: Sequence[BSplineSurface], touched: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """Compute displacements from points to the surfaces that they belong to.

    Parameters
    ----------
    surfaces : sequence of BSplineSurface
    touched : (n_surfaces, e) ndarray of bool
        Which surfaces each point belongs to: several at a curve in which they meet.
    straight : (e, 3) ndarray
        The points, RAS mm.

    Returns
    -------
    (e, 3) ndarray
        mm, 0 for points that belong to no surface.
    """
    target = straight.copy()
    for surface, mine in zip(surfaces, touched):
        if mine.any():
            target[mine] = closest_points(surface, target[mine]).points
    crease = touched.sum(axis=0) > 1
    for _ in range(_ROUNDS if crease.any() else 0):
        for surface, mine in zip(surfaces, touched & crease):
            if mine.any():
                target[mine] = closest_points(surface, target[mine]).points
    return target - straight


def _reversed(faces: np.ndarray) -> np.ndarray:
    """Faces with the opposite orientation."""
    return faces[:, [0, 2, 1]] if faces.shape[1] == 3 else faces[:, [0, 2, 1, 5, 4, 3]]


def _nearest_surface(points: np.ndarray, faces: np.ndarray, surfaces: list[BSplineSurface]) -> np.ndarray:
    """Find the index of the surface that is nearest to the corners of each face."""
    if len(surfaces) == 1:
        return np.zeros(len(faces), dtype=int)
    nodes, inverse = np.unique(faces[:, :3], return_inverse=True)
    inverse = inverse.reshape(len(faces), 3)
    far = [np.abs(closest_points(surface, points[nodes]).distances)[inverse].max(axis=1) for surface in surfaces]
    return np.argmin(far, axis=0)
