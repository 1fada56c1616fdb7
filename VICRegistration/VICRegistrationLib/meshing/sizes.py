"""Sizes of elements at each place: small at strongly curved surfaces.

The mean gap between a surface of mean absolute curvature k and linear triangles with edges h is about k h^2 / 8. It
shall be the same everywhere, so h is proportional to the square root of the radius of curvature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.surface import BSplineSurface

# Growth of the size with the distance from smaller elements, mm per mm.
GRADING = 0.35
# Largest edge as a share of the radius of curvature, for the quality of the elements, by their order.
_LONGEST_ARC = {1: 0.9, 2: 1.1}
# Smallest size as a share of the wanted one.
_SMALLEST = 0.1
# Share of the allowed difference in volume that is used, because h is an average.
_SAFETY = 0.8
_SAMPLES = (96, 64)
_MOST_NODES = 200_000
_LEVELS = 10


@dataclass(frozen=True, eq=False)
class SizeField:
    """Sizes on a regular grid.

    Parameters
    ----------
    origin : (3,) ndarray
        RAS mm.
    spacing : float
        mm.
    sizes : (n_r, n_a, n_s) ndarray
        mm.
    """

    origin: np.ndarray
    spacing: float
    sizes: np.ndarray


def size_field(surfaces: Sequence[BSplineSurface], size: float, *, order: int, volume_error: float) -> SizeField:
    """Choose sizes for a mesh inside surfaces.

    Parameters
    ----------
    surfaces : sequence of BSplineSurface
        Closed; RAS mm.
    size : float
        Largest size, mm.
    order : {1, 2}
        Second-order elements keep the volume at any size.
    volume_error : float
        Allowed relative difference between the volumes of mesh and solid.

    Returns
    -------
    SizeField
    """
    wanted = [_on_surface(surface, size, order, volume_error) for surface in surfaces]
    points, sizes = (np.concatenate(parts) for parts in zip(*wanted))
    low, high = points.min(axis=0) - size, points.max(axis=0) + size
    spacing = max(float(np.prod(high - low) / _MOST_NODES) ** (1.0 / 3.0), sizes.min() / 2.0)
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    grid = np.stack(np.meshgrid(*(start + spacing * np.arange(n) for start, n in zip(low, counts)), indexing="ij"), -1)
    field = _graded(points, sizes, grid.reshape(-1, 3), size, slack=spacing)
    return SizeField(low, spacing, field.reshape(counts))


def curvatures(surface: BSplineSurface, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Principal curvatures on a grid of parameters away from the poles, (m_u, m_v, 2) per mm.

    Positive where the surface bends away from its normal, as a sphere does.
    """
    du, dv = surface.grid(u, v, du=1), surface.grid(u, v, dv=1)
    normal = surface.grid_normals(u, v)
    first = [np.einsum("ijk,ijk->ij", a, b) for a, b in ((du, du), (du, dv), (dv, dv))]
    seconds = (surface.grid(u, v, du=2), surface.grid(u, v, du=1, dv=1), surface.grid(u, v, dv=2))
    e, f, g = (-np.einsum("ijk,ijk->ij", second, normal) for second in seconds)
    determinant = np.maximum(first[0] * first[2] - first[1] ** 2, np.finfo(float).tiny)
    mean = (e * first[2] - 2.0 * f * first[1] + g * first[0]) / (2.0 * determinant)
    gauss = (e * g - f * f) / determinant
    root = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
    return np.stack([mean - root, mean + root], axis=-1)


def _on_surface(surface: BSplineSurface, size: float, order: int, volume_error: float):
    """Points of a surface and the sizes there."""
    u, v = (surface.span_steps(axis, per_span=3, least=least, middles=True) for axis, least in enumerate(_SAMPLES))
    bent = np.abs(curvatures(surface, u, v))
    strongest, mean = np.maximum(bent.max(axis=2), 1e-12), np.maximum(bent.mean(axis=2), 1e-12)
    sizes = np.minimum(size, _LONGEST_ARC[order] / strongest)
    if order == 1:
        gap = _SAFETY * volume_error * abs(surface.volume()) / surface.area(tolerance=1e-3)
        sizes = np.minimum(sizes, np.sqrt(8.0 * gap / mean))
    points = surface.grid(u, v).reshape(-1, 3)
    return points, np.maximum(sizes, _SMALLEST * size).ravel()


def _graded(points: np.ndarray, sizes: np.ndarray, places: np.ndarray, size: float, *, slack: float) -> np.ndarray:
    """Smallest of the sizes at points, which grow with the distance beyond `slack`, at places: (n,) mm."""
    field = np.full(len(places), float(size))
    smallest = sizes.min()
    if smallest >= size:
        return field
    for upper in np.geomspace(smallest, size, _LEVELS + 1)[1:]:
        lower = upper * (smallest / size) ** (1.0 / _LEVELS)
        near = (sizes <= upper) & (sizes >= lower * (1.0 - 1e-12))
        if not near.any():
            continue
        reach = (size - lower) / GRADING + slack
        distance, index = cKDTree(points[near]).query(places, distance_upper_bound=reach)
        found = np.isfinite(distance)
        grown = sizes[near][index[found]] + GRADING * np.maximum(distance[found] - slack, 0.0)
        field[found] = np.minimum(field[found], grown)
    return field
