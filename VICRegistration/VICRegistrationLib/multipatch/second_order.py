"""Second-order elements of a model, with nodes at the middles of edges on the exact patches."""

from __future__ import annotations

import numpy as np

from ..meshing.elements import EDGES, TRIANGLE_EDGES
from ..meshing.groups import bent_elements, shifts_to
from .model import MultiPatchModel


def with_middles(
    model: MultiPatchModel,
    points: np.ndarray,
    tetrahedra: np.ndarray,
    triangles: np.ndarray,
    patch_of: np.ndarray,
    *,
    least_quality: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Add nodes at the middles of edges, on the patches as far as the quality of the elements allows it.

    Parameters
    ----------
    model : MultiPatchModel
    points : (n, 3) ndarray
        RAS mm.
    tetrahedra : (m, 4) ndarray of int
    triangles : (t, 3) ndarray of int
    patch_of : (t,) ndarray of int
        Number of each triangle's patch in the model.
    least_quality : float
        Least scaled Jacobian of curved elements.

    Returns
    -------
    points : (n + e, 3) ndarray
    tetrahedra : (m, 10) ndarray of int
    triangles : (t, 6) ndarray of int
    flattened : int
        Number of edges whose middle is not on its patch, because elements would get worse than that.
    """
    of_cells = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    of_triangles = np.sort(triangles[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)
    edges, number = np.unique(np.concatenate([of_cells, of_triangles]), axis=0, return_inverse=True)
    number = number.ravel()
    cell_edges, triangle_edges = number[: len(of_cells)].reshape(-1, 6), number[len(of_cells) :].reshape(-1, 3)
    surfaces, rows = _surfaces(model)
    touched = np.zeros((len(surfaces), len(edges)), dtype=bool)
    touched[np.repeat(rows[patch_of], 3), triangle_edges.ravel()] = True
    shift = shifts_to(surfaces, touched, points[edges].mean(axis=1))
    nodes, cells, flattened = bent_elements(points, tetrahedra, edges, cell_edges, shift, least_quality=least_quality)
    return nodes, cells, np.column_stack([triangles, len(points) + triangle_edges]), flattened


def _surfaces(model: MultiPatchModel) -> tuple[list, np.ndarray]:
    """Surfaces that triangles lie on, and the index of each patch's surface: the whole organ, or the patch."""
    surfaces, rows = list(model.parents.values()), []
    for patch in model.patches:
        if patch.part in model.parents:
            rows.append(model.organs.index(patch.part))
        else:
            rows.append(len(surfaces))
            surfaces.append(patch.surface(model.points))
    return surfaces, np.array(rows)
