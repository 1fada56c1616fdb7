"""Centreline of a long region, with frames across it and the cross-sections of the region.

The axis of a bent organ is a curve. It is found through the centres of slices of voxels that have equal geodesic
distances, inside of the organ, from one of its ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.interpolate import make_smoothing_spline
from scipy.sparse import csgraph

# Number of slices along the axis.
_SLICES = 20
# Sections are measured up to this height, where the ends are at -1 and 1. Beyond, they shrink as those of an ellipsoid.
_HIGHEST = 0.75
_SMOOTHING = 0.1


@dataclass(frozen=True, eq=False)
class Centreline:
    """Axis of a long organ, sampled at equal steps from one end to the other.

    Parameters
    ----------
    places : (n,) ndarray
        From -1 at one end to 1 at the other.
    points : (n, 3) ndarray
        mm.
    frames : (n, 3, 2) ndarray
        Two unit vectors across the axis, without rotation about it.
    sections : (n, 2, 2) ndarray
        Symmetric matrices that map the unit disc to the cross-section there, mm.
    """

    places: np.ndarray
    points: np.ndarray
    frames: np.ndarray
    sections: np.ndarray

    @property
    def bend(self) -> float:
        """Largest distance of the axis from the straight line between its ends, in units of the mean half width."""
        chord = self.points[-1] - self.points[0]
        along = np.linalg.norm(chord)
        offset = self.points - self.points[0]
        if along > 0.0:
            offset = offset - np.outer(offset @ chord, chord) / along**2
        width = np.sqrt(np.mean(np.abs(np.linalg.det(self.sections))))
        return float(np.linalg.norm(offset, axis=1).max() / width)

    def bent(self, sphere: np.ndarray) -> np.ndarray:
        """Map points of the unit ball (n, 3) into the organ, (n, 3) mm: z runs along the axis, x and y across it."""
        points, frames, sections = (
            interpolated(self.places, values, np.clip(sphere[:, 2], -1.0, 1.0))
            for values in (self.points, self.frames, self.sections)
        )
        across = np.einsum("nab,nb->na", sections, sphere[:, :2])
        return points + np.einsum("nkb,nb->nk", frames, across)


def centreline(inside: np.ndarray, lattice: np.ndarray) -> Centreline | None:
    """Find the centreline of a region.

    Parameters
    ----------
    inside : (nk, nj, ni) ndarray of bool
        The region; only its largest piece is used.
    lattice : (4, 4) ndarray
        From indices (i, j, k) to mm, with equal steps along all axes.

    Returns
    -------
    Centreline or None
        None if the region is too small to have one.
    """
    k, j, i = np.nonzero(_largest(inside))
    points = np.column_stack([i, j, k]) @ lattice[:3, :3].T + lattice[:3, 3]
    if len(points) < 4 * _SLICES:
        return None
    step = float(np.linalg.norm(lattice[:3, :3], axis=0).min())
    away = _distances_from_an_end(np.stack([k, j, i], axis=1), inside.shape, step)
    place = 2.0 * away / away.max() - 1.0
    middles = (np.arange(_SLICES) + 0.5) / _SLICES * 2.0 - 1.0
    number = np.clip(((place + 1.0) / 2.0 * _SLICES).astype(int), 0, _SLICES - 1)
    count = np.bincount(number, minlength=_SLICES)
    if count.min() < 1:
        return None
    centers = np.stack([np.bincount(number, points[:, a], _SLICES) / count for a in range(3)], axis=1)
    places = np.linspace(-1.0, 1.0, 2 * _SLICES + 1)
    # One coordinate at a time, because older versions of scipy do not take several.
    lines = [make_smoothing_spline(middles, along, lam=_SMOOTHING / _SLICES**2) for along in centers.T]
    curve = np.stack([line(places) for line in lines], axis=1)
    frames = _frames(curve, np.stack([line.derivative()(places) for line in lines], axis=1))
    own = np.abs(place[:, None] - places).argmin(axis=1)
    across = np.einsum("nk,nkb->nb", points - curve[own], frames[own])
    moments = np.stack(
        [np.einsum("na,nb->ab", across[number == s], across[number == s]) / count[s] for s in range(_SLICES)]
    )
    # A semi-axis of an ellipse is twice the standard deviation of its area along it.
    sections = _roots(4.0 * moments) / np.sqrt(1.0 - np.minimum(np.abs(middles), _HIGHEST) ** 2)[:, None, None]
    inner = np.clip(places, -_HIGHEST, _HIGHEST)
    smooth = ndimage.gaussian_filter1d(sections, 1.0, axis=0, mode="nearest")
    return Centreline(places, curve, frames, interpolated(middles, smooth, inner))


def _largest(inside: np.ndarray) -> np.ndarray:
    """Largest piece of a mask."""
    labels, count = ndimage.label(inside, structure=np.ones((3, 3, 3)))
    return inside if count < 2 else labels == np.bincount(labels.ravel())[1:].argmax() + 1


def _distances_from_an_end(voxels: np.ndarray, shape: tuple[int, ...], step: float) -> np.ndarray:
    """Geodesic distances inside a region from one of its ends to all its voxels (n, 3), (n,) mm."""
    numbers = np.full(np.array(shape) + 2, -1)
    numbers[tuple((voxels + 1).T)] = np.arange(len(voxels))
    rows, columns, lengths = [], [], []
    for shift in np.argwhere(np.ones((3, 3, 3)))[14:] - 1:
        other = numbers[tuple((voxels + 1 + shift).T)]
        there = np.flatnonzero(other >= 0)
        rows.append(there)
        columns.append(other[there])
        lengths.append(np.full(len(there), step * np.linalg.norm(shift)))
    ways = sparse.csr_matrix(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(len(voxels),) * 2
    )
    away = csgraph.dijkstra(ways, directed=False, indices=0)
    return csgraph.dijkstra(ways, directed=False, indices=int(np.argmax(away)))


def _frames(points: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Rotation-minimising frames across a curve, (n, 3, 2).

    Double reflection method of Wang, Juettler, Zheng and Liu (ACM Trans. Graph. 27(1), 2008): the frame is reflected in
    the bisecting plane of two points, and then so that its tangent becomes that of the second point.
    """
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    first = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    across = [first / np.linalg.norm(first)]
    for step, before, now in zip(np.diff(points, axis=0), tangents[:-1], tangents[1:]):
        turned = _mirrored(_mirrored(across[-1], step), now - _mirrored(before, step))
        turned = turned - (turned @ now) * now
        across.append(turned / np.linalg.norm(turned))
    first = np.array(across)
    return np.stack([first, np.cross(tangents, first)], axis=2)


def _mirrored(vector: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Reflect a vector in the plane with a normal of any length; a zero normal leaves it unchanged."""
    return vector - 2.0 * (normal @ vector) / max(float(normal @ normal), 1e-300) * normal


def _roots(matrices: np.ndarray) -> np.ndarray:
    """Square roots of symmetric positive semidefinite matrices, (n, 2, 2)."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("nab,nb,ncb->nac", vectors, np.sqrt(np.maximum(values, 0.0)), vectors)


def interpolated(places: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Interpolate values along a line.

    Parameters
    ----------
    places : (n,) ndarray
        Ascending.
    values : (n, ...) ndarray
        At the places.
    wanted : (m,) ndarray
        Other places.

    Returns
    -------
    (m, ...) ndarray
        Linear in between, and constant beyond both ends.
    """
    flat = values.reshape(len(places), -1)
    columns = [np.interp(wanted, places, column) for column in flat.T]
    return np.stack(columns, axis=-1).reshape(*np.shape(wanted), *values.shape[1:])
