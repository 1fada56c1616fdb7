"""Limits of an organ's grey levels: constant, or varying over the organ as the signal does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..imaging.image import Image
from ..imaging.moments import ball_radius
from .ray_edges import Edges
from .threshold import FEWEST_ON_SIDE, threshold_between

# The limits at a place are a mean over edges around it, weighted by a Gaussian. This is its standard deviation and the
# spacing of the lattice, in radii of a ball of the organ's volume; in half widths if rays start along an axis.
_REACH = 0.5
# The limit leaves this share of the edges beyond it, towards the outside level. So edges between bright and dim parts
# of the organ count less than the wall behind them.
_OUTER_SHARE = 0.2
# Levels of this share of the edges at each end may be those of rays that have left the organ, and are clipped.
_OUTLIERS = 0.05
# The lattice has so many steps beside the edges.
_MARGIN = 3
# Rounding error of a limit, as a share of the distance between both limits.
_ROUNDING = 1e-6
# Weight of the typical limit, where an edge at the place itself has the weight 1.
_PRIOR = 0.5


@dataclass(frozen=True, eq=False)
class Limits:
    """Lowest and highest grey level of an organ.

    Parameters
    ----------
    low, high : float
        Typical limits.
    first, step : (3,) ndarray
        First node (i, j, k) and spacing, in voxels, of a lattice around the organ.
    offsets : (2, ni, nj, nk) ndarray
        Differences from the typical lowest and highest level at the nodes; linear in between, 0 outside of the lattice.
        Empty if the limits are the same everywhere.
    """

    low: float
    high: float
    first: np.ndarray
    step: np.ndarray
    offsets: np.ndarray

    @classmethod
    def constant(cls, low: float, high: float) -> Limits:
        """Limits that are the same everywhere."""
        return cls(low, high, np.zeros(3), np.ones(3), np.zeros((2, 0, 0, 0)))

    @classmethod
    def along(cls, edges: Edges, image: Image) -> Limits:
        """Limits half way between the levels before and behind edges, varying over the organ.

        In MRI, the signal of an organ is weaker far from the coil and where its content flows, and its wall is darker
        in some places than in others.

        Parameters
        ----------
        edges : Edges
        image : Image
            The one in which the edges were found.

        Returns
        -------
        Limits

        Raises
        ------
        ValueError
            If there are too few edges.
        """
        low, high = threshold_between(edges)
        places, offsets = edges.points[edges.found], _offsets(edges, low, high)
        # The edges around a seed in a wall may span no more than a voxel.
        reach = max(_REACH * ball_radius(edges.volume), float(image.spacing.max()))
        step = reach / image.spacing
        low_end, high_end = np.quantile(image.to_ijk(places), [_OUTLIERS, 1.0 - _OUTLIERS], axis=0)
        # The lattice is symmetric about the middle of the organ, so that a flipped copy of the volume has the same
        # nodes.
        around = np.ceil((high_end - low_end) / 2.0 / step).astype(int) + _MARGIN
        counts, first = 2 * around + 1, (low_end + high_end) / 2.0 - around * step
        # A Gaussian is the product of Gaussians along the axes of the grid.
        i, j, k = (
            np.exp(np.square((begin + width * np.arange(count)[:, None] - place) / width) / -2.0)
            for begin, count, width, place in zip(first, counts, step, image.to_ijk(places).T)
        )
        in_plane = (i[:, None] * j).reshape(-1, len(places))
        sums = [in_plane @ (k * values).T for values in (*offsets.T, np.ones(len(places)))]
        shares = np.array(sums[:2]) / (sums[2] + _PRIOR)
        return cls(low, high, first, step, shares.reshape(2, *counts))

    def holds(self, start: np.ndarray, grey: np.ndarray) -> np.ndarray:
        """Voxels within the limits.

        Parameters
        ----------
        start : (3,) array_like of int
            First voxel (k, j, i) of a box of the image.
        grey : (nk, nj, ni) ndarray
            Grey levels of the box.

        Returns
        -------
        (nk, nj, ni) ndarray of bool
        """
        within = _within(grey, self.low, self.high)
        if not self.offsets.size:
            return within
        # Outside of the lattice the limits are the typical ones.
        last = self.first + self.step * (np.array(self.offsets.shape[1:]) - 1)
        size = np.array(grey.shape[::-1])
        begin, end = (
            np.clip(np.ceil(limit - np.asarray(start)[::-1]), 0, size).astype(int) for limit in (self.first, last)
        )
        box = tuple(slice(int(low), int(high)) for low, high in zip(begin[::-1], end[::-1]))
        low, high = self._interpolated(begin + np.asarray(start)[::-1], end - begin)
        # A level that differs from a limit by rounding alone is within it, so that a constant that is added to all
        # levels does not change the result.
        least = _ROUNDING * (self.high - self.low) if np.isfinite(self.high - self.low) else 0.0
        within[box] = _within(grey[box], self.low - least + low, self.high + least + high)
        return within

    def _interpolated(self, start: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both offsets at the voxels of a box, each (nk, nj, ni); the box's first voxel and size are (i, j, k)."""
        low, high = self.offsets
        for begin, length, first, step, count in zip(start, size, self.first, self.step, low.shape):
            away = (begin + np.arange(length) - first)[:, None] / step - np.arange(count)
            hats = np.maximum(1.0 - np.abs(away), 0.0)
            # Each round contracts the first axis and appends that of its voxels; the result has the order i, j, k.
            low, high = (np.tensordot(level, hats, axes=(0, 1)) for level in (low, high))
        return low.transpose(2, 1, 0), high.transpose(2, 1, 0)


def _offsets(edges: Edges, low: float, high: float) -> np.ndarray:
    """Difference between the limits at each edge that was found and the typical ones, (n, 2)."""
    half = ((edges.inner + edges.outer) / 2.0)[edges.found]
    falling = (edges.outer < edges.inner)[edges.found]
    offsets = np.zeros((len(half), 2))
    for number, (side, limit, share) in enumerate(((falling, low, _OUTER_SHARE), (~falling, high, 1.0 - _OUTER_SHARE))):
        if side.sum() < FEWEST_ON_SIDE * len(half):
            continue
        own = half[side]
        # Edges that rise do not show the lower limit, nor those that fall the upper one: they have the typical one.
        offsets[:, number] = np.quantile(own, share) - limit
        offsets[side, number] += np.clip(own, *np.quantile(own, [_OUTLIERS, 1.0 - _OUTLIERS])) - np.median(own)
    return offsets


def _within(grey: np.ndarray, low, high) -> np.ndarray:
    """Voxels within limits, which may be beyond the range of the array's type."""
    if grey.dtype.kind == "f":
        limits = np.finfo(grey.dtype)
        low, high = (np.clip(level, limits.min, limits.max).astype(grey.dtype) for level in (low, high))
    return (grey >= low) & (grey <= high)
