"""Measures of triangles."""

from __future__ import annotations

import numpy as np


def area_vectors(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Compute the normals of triangles, with their areas as lengths.

    Parameters
    ----------
    points : (n, 3) ndarray
        mm.
    triangles : (m, 3) ndarray of int
        Counter-clockwise seen from outside.

    Returns
    -------
    (m, 3) ndarray
        mm^2, pointing outward.
    """
    first, second, third = (points[triangles[:, corner]] for corner in range(3))
    return np.cross(second - first, third - first) / 2.0


def enclosed_volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside of a closed mesh of triangles.

    Parameters
    ----------
    points : (n, 3) ndarray
        mm.
    triangles : (m, 3) ndarray of int

    Returns
    -------
    float
        mm^3; negative if the mesh is inside out.
    """
    # Relative to the centre, so that a mesh far from the origin loses no digits.
    first, second, third = (points[triangles[:, corner]] - points.mean(axis=0) for corner in range(3))
    return float(np.einsum("nk,nk->", first, np.cross(second, third)) / 6.0)
