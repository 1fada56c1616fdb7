"""A generic model for long, bent organs: a tube along the organ's own axis in place of an ellipsoid.

The axis of a bent organ is none of its principal axes, which leave a banana at its middle. It runs through the centres
of the places that are as far from one end of the organ, measured inside of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.interpolate import make_smoothing_spline
from scipy.sparse import csgraph

from ..geometry.parametrization import Parametrization
from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .plan import machinery

# Slices across the axis.
_SLICES = 20
# The axis is bent where it leaves the straight line between its ends by more than this share of the organ's half width.
# Seen: 1.3 to 3.8 for tubes bent by 60 to 250 degrees; up to 1.2 an ellipsoid serves eggs as well or better.
_BENT = 1.2
# An ellipsoid's sections shrink towards its poles; beyond this height they are not told by the measured ones.
_HIGHEST = 0.75
_SMOOTHING = 0.1
# The tube is taken if it is nearer to the region than this share of what the ellipsoid is. Seen: 0.1 to 0.3 for bent
# tubes, 1.2 to 2.4 for eggs and pears.
_NEARER = 0.7
# Where that is measured.
_SAMPLES = (32, 20)


@dataclass(frozen=True, eq=False)
class BentAxis:
    """Axis of a long organ, at equal steps from one end to the other.

    Parameters
    ----------
    places : (n,) ndarray
        From -1 at one end to 1 at the other.
    points : (n, 3) ndarray
        mm.
    frames : (n, 3, 2) ndarray
        Two unit vectors across the axis, which turn no more than the axis does.
    sections : (n, 2, 2) ndarray
        Take the unit disc to the section there, mm: symmetric.
    """

    places: np.ndarray
    points: np.ndarray
    frames: np.ndarray
    sections: np.ndarray

    @property
    def bend(self) -> float:
        """Largest distance of the axis from the straight line between its ends, in mean half widths."""
        chord = self.points[-1] - self.points[0]
        along = np.linalg.norm(chord)
        offset = self.points - self.points[0]
        if along > 0.0:
            offset = offset - np.outer(offset @ chord, chord) / along**2
        width = np.sqrt(np.mean(np.abs(np.linalg.det(self.sections))))
        return float(np.linalg.norm(offset, axis=1).max() / width)


def bent_model(distance: Image, net: tuple[int, int], closure: str) -> BSplineSurface | None:
    """Make a tube along the axis of a bent region.

    Parameters
    ----------
    distance : Image
        Signed distance from the region's boundary, negative inside, mm.
    net : (rows, columns)
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface or None
        In the frame of the image, poles at both ends; None if the region is not bent.
    """
    axis = bent_axis(distance)
    if axis is None or axis.bend <= _BENT:
        return None
    closed, grid = machinery(net, closure)
    sphere = grid.bases[0] @ closed.surface.control_net.reshape(-1, 3)
    points, frames, sections = (
        _between(axis.places, values, np.clip(sphere[:, 2], -1.0, 1.0))
        for values in (axis.points, axis.frames, axis.sections)
    )
    across = np.einsum("nab,nb->na", sections, sphere[:, :2])
    return _through(closed, grid.bases[0], points + np.einsum("nkb,nb->nk", frames, across))


def start_model(distance: Image, ellipsoid: BSplineSurface, net: tuple[int, int], closure: str) -> BSplineSurface:
    """Choose the generic model to start with: the ellipsoid, or a tube if the region is bent and much more like that.

    Parameters
    ----------
    distance : Image
        As for :func:`bent_model`.
    ellipsoid : BSplineSurface
        In the frame of the image.
    net : (rows, columns)
    closure : {"smooth", "paper"}

    Returns
    -------
    BSplineSurface

    Notes
    -----
    The axis of an egg is crooked too, but a tube along it is farther from the egg than an ellipsoid is.
    """
    tube = bent_model(distance, net, closure)
    if tube is None or _misfit(distance, tube) > _NEARER * _misfit(distance, ellipsoid):
        return ellipsoid
    return tube


def _misfit(distance: Image, model: BSplineSurface) -> float:
    """Mean distance of a model from the region's boundary, mm; what lies outside of the image is as far as its rim."""
    values, seen = Sampler(distance).values(model.points(*model.midpoints(*_SAMPLES)))
    return float(np.where(seen, np.abs(values), distance.array.max()).mean())


def _through(closed: Parametrization, basis: sparse.csr_matrix, points: np.ndarray) -> BSplineSurface:
    """Deform a closed organ so that its samples come as near to points (n, 3) as they can."""
    q = np.zeros(closed.n_dof)
    start = basis @ closed.surface.control_net.reshape(-1, 3)
    for k, (matrix, index) in enumerate(zip(closed.matrices, closed.indices)):
        q[index] = np.linalg.lstsq((basis @ matrix).toarray(), points[:, k] - start[:, k], rcond=None)[0]
    return closed.deform(q)


def bent_axis(distance: Image) -> BentAxis | None:
    """Find the axis of a region.

    Parameters
    ----------
    distance : Image
        As for :func:`bent_model`.

    Returns
    -------
    BentAxis or None
        None where the region is too small to have one.
    """
    inside = distance.array < 0.0
    k, j, i = np.nonzero(_largest(inside))
    points = distance.to_ras(np.column_stack([i, j, k]))
    if len(points) < 4 * _SLICES:
        return None
    away = _distances_from_an_end(np.stack([k, j, i], axis=1), inside.shape, float(distance.spacing.min()))
    place = 2.0 * away / away.max() - 1.0
    middles = (np.arange(_SLICES) + 0.5) / _SLICES * 2.0 - 1.0
    number = np.clip(((place + 1.0) / 2.0 * _SLICES).astype(int), 0, _SLICES - 1)
    count = np.bincount(number, minlength=_SLICES)
    if count.min() < 1:
        return None
    centers = np.stack([np.bincount(number, points[:, a], _SLICES) / count for a in range(3)], axis=1)
    places = np.linspace(-1.0, 1.0, 2 * _SLICES + 1)
    # One coordinate at a time: older versions of scipy take no more.
    lines = [make_smoothing_spline(middles, along, lam=_SMOOTHING / _SLICES**2) for along in centers.T]
    curve = np.stack([line(places) for line in lines], axis=1)
    frames = _frames(np.stack([line.derivative()(places) for line in lines], axis=1))
    own = np.abs(place[:, None] - places).argmin(axis=1)
    across = np.einsum("nk,nkb->nb", points - curve[own], frames[own])
    moments = np.stack(
        [np.einsum("na,nb->ab", across[number == s], across[number == s]) / count[s] for s in range(_SLICES)]
    )
    # Of a full ellipse half an axis is twice the standard deviation along it.
    sections = _roots(4.0 * moments) / np.sqrt(1.0 - np.minimum(np.abs(middles), _HIGHEST) ** 2)[:, None, None]
    inner = np.clip(places, -_HIGHEST, _HIGHEST)
    smooth = ndimage.gaussian_filter1d(sections, 1.0, axis=0, mode="nearest")
    return BentAxis(places, curve, frames, _between(middles, smooth, inner))


def _largest(inside: np.ndarray) -> np.ndarray:
    """Largest piece of a mask."""
    labels, count = ndimage.label(inside, structure=np.ones((3, 3, 3)))
    return inside if count < 2 else labels == np.bincount(labels.ravel())[1:].argmax() + 1


def _distances_from_an_end(voxels: np.ndarray, shape: tuple[int, ...], step: float) -> np.ndarray:
    """Shortest ways inside a region from one of its ends to all its voxels (n, 3), (n,) mm."""
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


def _frames(tangents: np.ndarray) -> np.ndarray:
    """Frames across a curve that do not turn about it, (n, 3, 2): double reflection (Wang et al., 2008)."""
    tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    first = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    frames = [first / np.linalg.norm(first)]
    for before, now in zip(tangents[:-1], tangents[1:]):
        # Turned from one tangent to the next about what is across both.
        turned = frames[-1] - (frames[-1] @ now) / (1.0 + before @ now) * (before + now)
        frames.append(turned / np.linalg.norm(turned))
    first = np.array(frames)
    return np.stack([first, np.cross(tangents, first)], axis=2)


def _roots(matrices: np.ndarray) -> np.ndarray:
    """Square roots of symmetric matrices (n, 2, 2) that are not negative."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("nab,nb,ncb->nac", vectors, np.sqrt(np.maximum(values, 0.0)), vectors)


def _between(places: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Interpolate values (n, ...) at places linearly."""
    flat = values.reshape(len(places), -1)
    columns = [np.interp(wanted, places, column) for column in flat.T]
    return np.stack(columns, axis=-1).reshape(*np.shape(wanted), *values.shape[1:])
