"""Surfaces of a tetrahedral mesh: what is outside, what lies between two regions, and which exact surface it is on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from .elements import FACES

_QUARTERS = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])


def faces_of(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All different faces of tetrahedra.

    Parameters
    ----------
    tetrahedra : (m, 4 or 10) ndarray of int

    Returns
    -------
    faces : (f, 3 or 6) ndarray of int
        Nodes, counter-clockwise seen from outside of the first owner.
    first, second : (f,) ndarray of int
        The tetrahedra on both sides; `second` is -1 where there is none.
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
    """Cut faces of second order into flat triangles.

    Parameters
    ----------
    faces : (f, 3 or 6) ndarray of int
        Corners, and the middles of the edges 01, 12 and 20.

    Returns
    -------
    (f, 3) or (4 f, 3) ndarray of int
        The four of a face follow each other.
    """
    return faces if faces.shape[1] == 3 else faces[:, _QUARTERS].reshape(-1, 3)


def boundary_faces(
    points: np.ndarray, tetrahedra: np.ndarray, region: np.ndarray, surfaces: Sequence[BSplineSurface]
) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the boundary and between regions, and the exact surface that each lies on.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4 or 10) ndarray of int
    region : (m,) ndarray of int
    surfaces : sequence of BSplineSurface

    Returns
    -------
    faces : (f, 3 or 6) ndarray of int
    on_surface : (f,) ndarray of int
        Numbers of surfaces.
    """
    faces, first, second = faces_of(tetrahedra)
    faces = faces[(second < 0) | (region[first] != region[second])]
    return faces, _nearest_surface(points, faces, list(surfaces))


def surface_groups(
    points: np.ndarray,
    tetrahedra: np.ndarray,
    regions: Mapping[str, np.ndarray],
    surfaces: Mapping[str, BSplineSurface],
    *,
    names: Sequence[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Triangles of the boundary and of interfaces, each in one group.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4 or 10) ndarray of int
    regions : mapping of name to (k,) ndarray of int
        Tetrahedra of every region.
    surfaces : mapping of name to BSplineSurface
        Exact surfaces; a triangle of the boundary belongs to the one that it lies on.
    names : sequence of str
        What the regions are called in the names of interfaces.

    Returns
    -------
    triangles : (t, 3 or 6) ndarray of int
        Counter-clockwise seen from outside; at an interface, from the later region.
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
    """Cut the groups of surfaces into patches by the parameters of their triangles' middles.

    Parameters
    ----------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (t, 3 or 6) ndarray of int
    groups : mapping of name to ndarray of int
        Rows of `triangles`, as :func:`surface_groups` makes them.
    surfaces : mapping of name to BSplineSurface
        Those of the groups to be cut; the others stay whole.
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


def _reversed(faces: np.ndarray) -> np.ndarray:
    """Faces with the other side in front."""
    return faces[:, [0, 2, 1]] if faces.shape[1] == 3 else faces[:, [0, 2, 1, 5, 4, 3]]


def _nearest_surface(points: np.ndarray, faces: np.ndarray, surfaces: list[BSplineSurface]) -> np.ndarray:
    """Find the number of the surface from which the corners of each face are least far away."""
    if len(surfaces) == 1:
        return np.zeros(len(faces), dtype=int)
    nodes, inverse = np.unique(faces[:, :3], return_inverse=True)
    inverse = inverse.reshape(len(faces), 3)
    far = [np.abs(closest_points(surface, points[nodes]).distances)[inverse].max(axis=1) for surface in surfaces]
    return np.argmin(far, axis=0)
