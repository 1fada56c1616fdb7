"""The virtual image: grey levels that a surface would have in an image, by the signed distance from it.

Across the surface it goes from the level inside to the level outside: by the intensity profile of equation 3, a ramp,
or by the partial volumes of the surface in the real image's voxels. Behind a wall that is thinner than a voxel is long,
it has a third level. Along the surface the levels are given, or estimated from the real image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import ndimage

from ..geometry.surface import BSplineSurface

# Where the levels are read off a normal line, in units of the ramp's width. Inside, only beyond the whole ramp:
# nearer to the surface the blurred edge darkens the plateau, and the surface would settle too far out. Outside, close
# together and from within the ramp on: a wall may be no thicker than the edge is wide.
PROBE_DEPTHS = np.concatenate([np.linspace(-2.0, -1.0, 5), np.linspace(0.25, 1.25, 9)])
INSIDE_PROBES = PROBE_DEPTHS < 0.0
OUTSIDE_PROBES = ~INSIDE_PROBES
# Where they are read off behind a wall, from its outer face, mm. From 0 to 1 mm change no mean distance of the demo's
# organs in slices of 4 and 5 mm by more than 0.002 mm.
_BEHIND_MM = np.linspace(0.25, 1.5, 6)

# Standard deviation of the smoothing of levels over neighbours, as a fraction of the surface's parameter range. Half of
# it and twice as much change the mean distances of the demo's organs by 0.005 mm and of seven real bladders by 0.025 mm
# at most.
_SMOOTHING = 0.1
# Weight of the organ's mean among the neighbours' levels, where a sharp line weighs 1. Half and twice of it change the
# same distances by 0.008 mm at most.
_PRIOR = 0.05
# Regularisation (Tikhonov) of the least squares for three levels, towards the expected ones: small beside any line that
# shows something of a level, so that it counts only where none does.
_REGULARISATION = 1e-9
# A grey level of which less than this share is of one side does not count for that side. With 0.01 to 0.3 the demo's
# organs and seven real bladders have the same mean distances to 0.0001 mm. One of three hippocampi, fitted from its
# label, is 0.4 or 0.7 mm off, by chance of the share; without any, its standard deviation is too small.
_LEAST_SHARE = 0.2
# Of the contrast that is expected, at least so much is the unit of the residuals: there may be none. Without a limit
# no distance of the demo's organs, of seven real bladders and of three hippocampi changes.
_LEAST_CONTRAST = 0.05


def cosine_ramp(distance: np.ndarray, *, centered: bool = True) -> np.ndarray:
    """Ramp of equation 3 between 1 (inside) and 0 (outside).

    Parameters
    ----------
    distance : ndarray
        Signed distance outward from the surface in units of the ramp's width tau.
    centered : bool
        Whether the surface lies in the middle of the ramp or, as published, at its inner foot.

    Returns
    -------
    ndarray
        Same shape.
    """
    position = np.clip(distance + 0.5 if centered else distance, 0.0, 1.0)
    return 0.5 * (1.0 + np.cos(np.pi * position))


def linear_ramp(distance: np.ndarray, *, centered: bool = True) -> np.ndarray:
    """Straight ramp between 1 and 0 in place of the cosine: the profile of a clipped distance image."""
    return 1.0 - np.clip(distance + 0.5 if centered else distance, 0.0, 1.0)


RAMPS = {"cosine": cosine_ramp, "linear": linear_ramp}


@dataclass(frozen=True, eq=False)
class IntensityProfile:
    """Grey level as a function of the signed distance from the surface (level set function).

    Parameters
    ----------
    inside, outside : float or (n, 1) ndarray
        Grey levels on both sides (A_max and A_min of the paper), of all places or of each of n normal lines; the inside
        may be the darker one.
    width : float
        Width tau of the ramp between them, mm.
    centered : bool
        True: the surface lies at half height, ramp from -tau/2 to tau/2. False: as published, ramp from 0 to tau, which
        puts the surface at the inner foot of the ramp.
    ramp : {"cosine", "linear"}
        Shape of the ramp: equation 3, or straight for a distance image.

    Raises
    ------
    ValueError
        If the width is not positive or a number is not finite.

    Notes
    -----
    Equation 3 of Jiang et al. (Strain 2019).

    Examples
    --------
    >>> IntensityProfile(inside=130.0, outside=25.0, width=3.0).value([-1.5, 0.0, 1.5])
    array([130. ,  77.5,  25. ])
    """

    inside: float | np.ndarray
    outside: float | np.ndarray
    width: float
    centered: bool = True
    ramp: str = "cosine"

    def __post_init__(self) -> None:
        """Check the numbers."""
        finite = np.isfinite(self.inside).all() and np.isfinite(self.outside).all() and np.isfinite(self.width)
        if not (finite and self.width > 0.0):
            levels = (float(np.mean(level)) for level in (self.inside, self.outside))
            msg = (
                "A profile from {:g} to {:g} over {:g} mm was given; finite grey levels and a positive width are "
                "needed.".format(*levels, self.width)
            )
            raise ValueError(msg)

    def value(self, distance: np.ndarray) -> np.ndarray:
        """Grey level L(d) at signed distances (outward positive, mm)."""
        return self.outside + (self.inside - self.outside) * self.share(distance)

    def share(self, distance: np.ndarray) -> np.ndarray:
        """Share of the level inside at signed distances (outward positive, mm), from 0 to 1."""
        return RAMPS[self.ramp](np.asarray(distance) / self.width, centered=self.centered)

    def depths(self, reach: float, count: int) -> np.ndarray:
        """Distances from the surface at which it is compared, (count,) mm: as far on both sides of the ramp's middle.

        Parameters
        ----------
        reach : float
            The farthest from the middle, in units of the width.
        count : int
        """
        return self.width * (np.linspace(-reach, reach, count) + self.middle)

    @property
    def middle(self) -> float:
        """Where the middle of the ramp lies outward of the surface, in units of the width."""
        return 0.0 if self.centered else 0.5


@lru_cache(maxsize=16)
def _smoothing_matrix(n: int, sigma: float, mode: str) -> np.ndarray:
    """Gaussian smoothing of n numbers as a matrix: on so few, a product is faster than a filter."""
    return ndimage.gaussian_filter1d(np.eye(n), sigma, axis=0, mode=mode, truncate=3.0)


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of the grey levels inside and behind a wall in the samples of normal lines, from 0 to 1.

    Parameters
    ----------
    inside : (n, m) ndarray
        The rest is the share of the level outside.
    behind : (n, m) ndarray, optional
        Of what lies behind a wall that is thinner than a voxel is long; then the rest of both is the wall's.
    wall : float, optional
        Thickness of that wall, mm.
    """

    inside: np.ndarray
    behind: np.ndarray | None = None
    wall: float | None = None

    @property
    def all(self) -> np.ndarray:
        """Shares of the levels inside, outside (the wall's) and behind, (n, m, 3); `behind` is needed."""
        return np.stack([self.inside, 1.0 - self.inside - self.behind, self.behind], axis=2)


@dataclass(frozen=True, eq=False)
class VirtualImage:
    """An intensity profile along a surface, and where its levels come from.

    Parameters
    ----------
    profile : IntensityProfile
        With one level on each side. With mode "given" they are those of the whole surface; otherwise they only say
        which side is the brighter one and what contrast to expect.
    mode : {"local", "organ", "given"}
        "organ": one pair of levels, the means over the surface. "local": a pair for each normal line, smoothed over
        its neighbours, for surroundings that change along the surface.
    voxel : (3, 3) ndarray, optional
        Columns are the edges of a voxel of the real image, mm. When given, levels come from places where the voxel is
        short along the normal rather than across thick slices.
    partial_volumes : callable, optional
        Compared in place of a centred profile's ramp: takes a surface, axes and depths, and computes shares as
        :meth:`.partial_volumes.PartialVolumes.along` does.

    Raises
    ------
    ValueError
        If both levels are the same.
    """

    profile: IntensityProfile
    mode: str = "local"
    voxel: np.ndarray | None = None
    partial_volumes: Callable[..., Shares] | None = None

    def __post_init__(self) -> None:
        """Check the levels."""
        if self.profile.inside == self.profile.outside:
            msg = (
                f"The grey level {self.profile.inside:g} was given for both sides of the surface; two different levels "
                "are needed. Check the thresholds: the organ must differ from its surroundings."
            )
            raise ValueError(msg)

    @property
    def adaptive(self) -> bool:
        """Whether the levels are estimated from the image."""
        return self.mode != "given"

    def probes(self, wall: float | None = None) -> np.ndarray:
        """Distances from the surface at which levels are read off the image, (m,) mm; also behind a wall, if any."""
        probes = self.profile.width * (PROBE_DEPTHS + self.profile.middle)
        return probes if wall is None else np.append(probes, wall + _BEHIND_MM)

    def shares(self, surface: BSplineSurface, axes: tuple[np.ndarray, np.ndarray], depths: np.ndarray) -> Shares:
        """Shares of the levels along the normals of a surface.

        Parameters
        ----------
        surface : BSplineSurface
        axes : (n_u,) and (n_v,) ndarray
            Parameters of the normal lines: all pairs of them.
        depths : (m,) ndarray
            Distances from the surface, mm.

        Returns
        -------
        Shares
            (n_u * n_v, m) each.
        """
        if self.partial_volumes is not None and self.profile.centered:
            return self.partial_volumes(surface, axes, depths)
        return Shares(np.tile(self.profile.share(depths), (len(axes[0]) * len(axes[1]), 1)))

    def blur(self, normals: np.ndarray) -> np.ndarray:
        """Length of a voxel along unit normals (n, 3), in units of its shortest edge, (n,)."""
        if self.voxel is None:
            return np.ones(len(normals))
        return np.linalg.norm(normals @ self.voxel, axis=1) / np.linalg.norm(self.voxel, axis=0).min()

    def contrast(self, inside: np.ndarray, outside: np.ndarray, area: np.ndarray) -> float:
        """One contrast for the organ, the unit of the residuals."""
        difference = np.average(np.abs(inside - outside), weights=area)
        return float(max(difference, _LEAST_CONTRAST * abs(self.profile.inside - self.profile.outside)))

    def levels(self, values, valid, shares, normals, area, shape):
        """Levels on every normal line, with or without a thin wall.

        Parameters
        ----------
        values, valid : (n, m) ndarray
            Grey levels at :meth:`probes`, and whether they lie in the volume.
        shares : Shares
            Of each of them.
        normals, area, shape
            As in :meth:`estimate`.

        Returns
        -------
        inside, outside, behind : (n,) ndarray
            Without a thin wall the last two are the same.
        """
        if shares.wall is not None:
            return self.estimate_with_wall(values, valid, shares, normals, area, shape)
        inside, outside = self.estimate(values, valid, shares.inside, normals, area, shape)
        return inside, outside, outside

    def estimate(self, values, valid, shares, normals, area, shape):
        """Levels on every normal line from the grey levels along all of them.

        Parameters
        ----------
        values, valid : (n, m) ndarray
            Grey levels at `PROBE_DEPTHS` and whether they lie in the volume.
        shares : (n, m) ndarray
            Share of the level inside that each of them has by the blur.
        normals : (n, 3) ndarray
            Unit normals: lines across thick slices are blurred and count less.
        area : (n,) ndarray
            Area belonging to each line.
        shape : (n_u, n_v)
            The lines as a grid, closed in u.

        Returns
        -------
        inside, outside : (n,) ndarray

        Notes
        -----
        Inside is the mean of the plateau. Outside is the level farthest from the inside's within reach: an organ may
        have a wall thinner than the reach, with anything behind it. With the mean of all, an organ with a wall of 2 mm
        in voxels of 1 mm is 0.55 mm too small, in place of 0.16 mm. It is the mean of two probes, as one alone would be
        noise where there is no contrast. What the blur carries to either side from the other one is taken off first, by
        least squares: a grey level is I = s inside + (1 - s) outside, where s is its share.
        """
        weight = valid * (area / area.mean() / self.blur(normals) ** 2)[:, None]
        own = np.maximum(np.where(INSIDE_PROBES, shares, 1.0 - shares), _LEAST_SHARE)
        weight = weight * own**2
        outside = np.full(len(values), float(self.profile.outside))
        # Each side needs the level of the other one.
        for _ in range(2):
            levels = np.where(valid, (values - (1.0 - own) * outside[:, None]) / own, 0.0)
            inside = self._neighbourhood_mean(levels, weight, shape, INSIDE_PROBES, self.profile.inside).mean(axis=1)
            levels = np.where(valid, (values - (1.0 - own) * inside[:, None]) / own, 0.0)
            profile = self._neighbourhood_mean(levels, weight, shape, OUTSIDE_PROBES, self.profile.outside)
            ordered = np.sort(profile, axis=1)
            farthest = ordered[:, :2] if self.profile.inside > self.profile.outside else ordered[:, -2:]
            outside = farthest.mean(axis=1)
        return inside, outside

    def estimate_with_wall(self, values, valid, shares, normals, area, shape):
        """Levels on every normal line where there is a wall that is thinner than a voxel is long.

        Parameters
        ----------
        values, valid : (n, m) ndarray
            Grey levels at :meth:`probes` with the wall, and whether they lie in the volume.
        shares : Shares
            That each of them has by the blur, behind the wall too.
        normals, area, shape
            As in :meth:`estimate`.

        Returns
        -------
        inside, outside, behind : (n,) ndarray

        Notes
        -----
        All three by least squares over each line's neighbourhood: across thick slices a voxel shows the organ, its wall
        and what lies behind the wall at once.
        """
        levels = shares.all
        # Levels of blurred lines depend most on how well the blur is known. The square and the fourth power change no
        # mean distance of the demo's organs in slices of 4 and 5 mm by more than 0.005 mm.
        weight = valid * (area / area.mean() / self.blur(normals) ** 3)[:, None]
        weighted = weight[..., None] * levels
        forms = np.einsum("nma,nmb->nab", weighted, levels).reshape(len(values), -1)
        sums = np.concatenate([forms, np.einsum("nma,nm->na", weighted, values)], axis=1)
        # As in `estimate`, the organ's mean counts a little in each neighbourhood.
        mean = sums.mean(axis=0)
        sums = self._neighbourhood_sums(sums + _PRIOR * mean, shape) if self.mode == "local" else mean[None]
        expected = np.array([self.profile.inside, self.profile.outside, self.profile.outside], dtype=float)
        forms = sums[:, :9].reshape(-1, 3, 3) + _REGULARISATION * np.eye(3)
        found = np.linalg.solve(forms, (sums[:, 9:] + _REGULARISATION * expected)[..., None])[..., 0]
        return tuple(np.broadcast_to(found, (len(values), 3)).T)

    def credibility(self, values, valid, inside, outside) -> np.ndarray:
        """How much of the step between the levels each normal line shows itself, (n,) from 0 to 1.

        Parameters
        ----------
        values, valid : (n, m) ndarray
            Grey levels at `PROBE_DEPTHS` and whether they lie in the volume.
        inside, outside : (n,) ndarray
            Levels from :meth:`estimate`.

        Returns
        -------
        (n,) ndarray

        Notes
        -----
        A line without an edge has large residuals and only noise for a gradient: it would throw the surface about.
        """
        sides = []
        values, valid = values[:, : len(PROBE_DEPTHS)], valid[:, : len(PROBE_DEPTHS)]
        for plateau in (INSIDE_PROBES, OUTSIDE_PROBES):
            count = valid[:, plateau].sum(axis=1)
            mean = np.where(valid[:, plateau], values[:, plateau], 0.0).sum(axis=1) / np.maximum(count, 1)
            sides.append((mean, count > 0))
        (inner, inner_seen), (outer, outer_seen) = sides
        step = inside - outside
        share = (inner - outer) * np.sign(step) / np.maximum(np.abs(step), 1e-12)
        return np.where(inner_seen & outer_seen, np.clip(share, 0.0, 1.0), 0.0)

    def _neighbourhood_mean(
        self, values: np.ndarray, weight: np.ndarray, shape, probes: np.ndarray, fallback: float
    ) -> np.ndarray:
        """Weighted mean at each probe of one side, over the organ or over each line's neighbourhood, (n, m_side)."""
        values, weight = values[:, probes], weight[:, probes]
        total = weight.sum(axis=0)
        mean = np.where(total > 0.0, (weight * values).sum(axis=0) / np.maximum(total, 1e-300), fallback)
        if self.mode == "organ":
            return np.broadcast_to(mean, values.shape)
        # Where all neighbours are blurred or outside of the volume, the organ's mean is taken.
        parts = np.concatenate([weight * values + _PRIOR * mean, weight + _PRIOR], axis=1)
        sums, weights = np.split(self._neighbourhood_sums(parts, shape), 2, axis=1)
        return sums / weights

    def _neighbourhood_sums(self, parts: np.ndarray, shape) -> np.ndarray:
        """Add up numbers (n, k) over each line's neighbourhood."""
        along_u = _smoothing_matrix(shape[0], _SMOOTHING * shape[0], "wrap")
        along_v = _smoothing_matrix(shape[1], _SMOOTHING * shape[1], "nearest")
        return (along_v @ (along_u @ parts.reshape(shape[0], -1)).reshape(*shape, -1)).reshape(len(parts), -1)
