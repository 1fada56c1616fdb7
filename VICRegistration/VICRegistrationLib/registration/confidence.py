"""Confidence: the standard deviation of a fitted surface along its normal, point by point.

It has two parts. Noise: the covariance of the control points is the inverse of the fit's Gauss-Newton matrix, scaled by
the residuals around each place and by the number of voxels along the surface. Misfit: the distance of each normal
line's own edge from the surface, because the net is too coarse, or something lies beside the edge. The variances are
added. Where no line shows an edge, the standard deviation is the one assumed without an image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image, patient_side
from .banded_matrix import BandedMatrix
from .cost import Correlation
from .joint_stacks import with_stacks
from .nets import sampled
from .options import FitOptions
from .sample_grid import SampledSurface, mean_over_neighbours
from .schedule import Schedule
from .stacks import StackUse
from .stages import Stage

# Standard deviation of a surface without an image, mm: about as far as a fit moves a surface.
_PRIOR_MM = 3.0
# Share of the lines' misfit that is the surface's error; calibrated on phantoms.
_MISFIT_SHARE = 0.75
# Standard deviation of the neighbourhood over which residuals are averaged, as a share of the parameter range. Half and
# twice of it change the standard deviation of the demo's organs by 6 % at most, that of a bladder that shows no edge on
# 15 % of its area by 40 %.
_NEIGHBOURS = 0.04
# Error, in pixels, that the whole surface has in common, independent of the number of voxels; calibrated on phantoms.
_COMMON_PIXELS = 0.08
# Mean squared residual, in units of the squared contrast, from which on there is no edge. Half and twice of it change
# the share of the area without an edge by 0.03 at most in two clear images of bladders. Without a limit that share is
# 0.43 in place of 0.71 for a hippocampus, which shows no edge.
_NO_EDGE = 0.5
# A place with less support than this follows no edge.
_LEAST_SUPPORT = 0.3
# Largest share of the area without an edge for a calibrated volume. Beyond, most of the volume's variance is the
# assumed 3 mm there, which were not calibrated on phantoms (half of it at 3.2, 3.4 and 3.9 % of the demo's bladder,
# vagina and rectum).
_MOST_WITHOUT_EDGE = 0.04


@dataclass(frozen=True, eq=False)
class Confidence:
    """Standard deviation of a surface along its normal.

    Parameters
    ----------
    surface : BSplineSurface
        RAS mm.
    deviations : (n_u, n_v) ndarray
        Standard deviations at the midpoints of equal intervals of the parameters, mm.
    supports : (n_u, n_v) ndarray
        Share of the organ's typical edge that the image shows there, 0 to 1.
    areas : (n_u, n_v) ndarray
        Area that belongs to each of these places, mm^2.
    points : (n_u, n_v, 3) ndarray
        The places, RAS mm.
    volume_sd_ml : float
        Standard deviation of the volume, ml.
    """

    surface: BSplineSurface
    deviations: np.ndarray = field(repr=False)
    supports: np.ndarray = field(repr=False)
    areas: np.ndarray = field(repr=False)
    points: np.ndarray = field(repr=False)
    volume_sd_ml: float

    def standard_deviation(self, parameters: np.ndarray) -> np.ndarray:
        """Interpolate the standard deviation of the surface along its normal at (u, v), (n, 2): (n,) mm."""
        return self._interpolated(self.deviations, parameters)

    def follows_edge(self, parameters: np.ndarray) -> np.ndarray:
        """Whether the surface follows an edge at (u, v), (n, 2): (n,) of bool."""
        return self._interpolated(self.supports, parameters) >= _LEAST_SUPPORT

    def _interpolated(self, values: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        places = [
            (np.asarray(parameters)[:, axis] - low) / (high - low) * count - 0.5
            for axis, ((low, high), count) in enumerate(zip(self.surface.domain, values.shape))
        ]
        # Periodic in u; constant between the last samples and the poles.
        padded = np.concatenate([values[-1:], values, values[:1]])
        return ndimage.map_coordinates(padded, [places[0] + 1.0, places[1]], order=1, mode="nearest")

    @property
    def unsupported(self) -> np.ndarray:
        """Where the surface follows no edge, (n_u, n_v) of bool."""
        return self.supports < _LEAST_SUPPORT

    @property
    def unsupported_share(self) -> float:
        """Share of the area that follows no edge, 0 to 1."""
        return float(self.areas[self.unsupported].sum() / self.areas.sum())

    @property
    def volume_calibrated(self) -> bool:
        """Whether the volume's standard deviation is calibrated: at most 4 % of the area follow no edge."""
        return self.unsupported_share <= _MOST_WITHOUT_EDGE

    @property
    def unsupported_side(self) -> str:
        """Side of the organ where most of that area lies, such as "superior"; empty if it is spread over the organ."""
        if not self.unsupported.any():
            return ""
        points, areas = self.points.reshape(-1, 3), self.areas.ravel()
        part = np.where(self.unsupported.ravel(), areas, 0.0)
        center = areas @ points / areas.sum()
        spread = np.sqrt(areas @ (points - center) ** 2 / areas.sum())
        offset = (part @ points / part.sum() - center) / spread
        return patient_side(offset) if np.abs(offset).max() >= 0.5 else ""


def confidence_of(
    image: Image, surface: BSplineSurface, options: FitOptions, *, stacks: Sequence[StackUse] = ()
) -> Confidence:
    """Estimate the standard deviation of a fitted surface and of its volume.

    Parameters
    ----------
    image : Image
        The image that was fitted.
    surface : BSplineSurface
        A closed organ, RAS mm.
    options : FitOptions
        Of the fit, with automatic choices filled in.
    stacks : sequence of StackUse
        Further stacks to which it was fitted.

    Returns
    -------
    Confidence

    Raises
    ------
    ValueError
        If the surface lies outside of the volume.

    Notes
    -----
    The covariance is the inverse of the sum of the Gauss-Newton matrix, the fit's stiffness against bending and
    sliding, and a prior of 3 mm for each patch of the net. It was calibrated on noisy phantoms, and holds for real
    images as far as these are similar.
    """
    schedule = Schedule.around(image, surface, options)
    if schedule.inside == schedule.outside:
        # The levels estimated along the surface will show that there is no edge; they only need a sign of the contrast.
        schedule = replace(schedule, outside=schedule.inside - 1e-6 * (abs(schedule.inside) or 1.0))
    stage = with_stacks(schedule, surface, stacks).fine
    first, *_ = correlations = stage.correlations(sampled(surface, options.closure))
    shape = first.surface.grid.shape
    supports = [_lowered_without_edge(_support(each), shape) for each in correlations]
    support = _joint(supports)
    areas = support.area * surface.area()
    pixel = float(np.min(image.spacing))
    information, scale = np.zeros(len(areas)), 0.0
    for each, one in zip(correlations, supports):
        variance = _smoothed(one.variance, one, shape)
        # A voxel is one independent observation, however many samples lie in it.
        lines = areas / (abs(np.linalg.det(each.virtual.voxel)) / np.linalg.norm(each.virtual.voxel, axis=0).min())
        information += lines * one.weight * one.slope / variance
        scale += float(np.sum(lines) * np.mean(1.0 / variance))
    precision = _precision(first, support, information, stage, scale)
    moves = first.surface.normal_motion(support.normals)
    noise = precision.variances(moves)
    misfit = _MISFIT_SHARE**2 * _smoothed(np.minimum(support.offset**2, _PRIOR_MM**2), support, shape)
    # Where no line around shows an edge, the variance is that without an image.
    blind = _PRIOR_MM**2 * np.clip(1.0 - _around(support.weight, support.area, shape) / _LEAST_SUPPORT, 0.0, 1.0)
    pushed = moves.T @ areas
    volume = pushed @ precision.solve(pushed) + (_COMMON_PIXELS * pixel * areas.sum()) ** 2
    volume += areas.sum() * (areas @ (misfit + blind)) / _patches(first.surface)
    return Confidence(
        surface,
        np.sqrt(noise + misfit + blind).reshape(shape),
        support.weight.reshape(shape),
        areas.reshape(shape),
        support.points.reshape(*shape, 3),
        float(np.sqrt(volume)) / 1000.0,
    )


@dataclass(frozen=True, eq=False)
class _Support:
    """The edge that an image shows on each of n normal lines; arrays are (n,) if not stated otherwise.

    Parameters
    ----------
    points, normals : (n, 3) ndarray
        Points of the surface, and normals.
    area : ndarray
        Share of the surface's area, sum 1.
    weight : ndarray
        Share of the organ's typical edge that the line shows, 0 to 1; 0 outside of the volume.
    variance : ndarray
        Mean squared residual, in units of the squared contrast.
    slope, offset : ndarray
        Steepness of the edge and its distance from the surface, see :meth:`.cost.Samples.edges`.
    share : ndarray
        Part of the line's weight in the cost that belongs to this image.
    """

    points: np.ndarray
    normals: np.ndarray
    area: np.ndarray
    weight: np.ndarray
    variance: np.ndarray
    slope: np.ndarray
    offset: np.ndarray
    share: np.ndarray


def _support(correlation: Correlation) -> _Support:
    """Measure the edge on each normal line, at q = 0."""
    samples = correlation.sample(np.zeros(correlation.surface.n_dof))
    frame = samples.frame
    slope, offset = samples.edges()
    share = np.ones(len(frame.area)) if correlation.share is None else correlation.share
    return _Support(
        frame.points,
        frame.normals,
        frame.area,
        np.minimum(correlation.steps(), 1.0) * samples.weights.sum(axis=1) / np.maximum(frame.area * share, 1e-300),
        np.mean(samples.residuals**2, axis=1),
        slope,
        offset,
        share,
    )


def _joint(supports: Sequence[_Support]) -> _Support:
    """Combine several images: the largest support, and weighted means of the rest."""
    if len(supports) == 1:
        return supports[0]
    weights = np.array([each.weight for each in supports])
    shares = np.array([each.share for each in supports]) * weights
    shares /= np.maximum(shares.sum(axis=0), 1e-300)
    return replace(
        supports[0],
        weight=weights.max(axis=0),
        variance=np.einsum("kn,kn->n", shares, [each.variance for each in supports]),
        slope=np.einsum("kn,kn->n", shares, [each.slope for each in supports]),
        offset=np.einsum("kn,kn->n", shares, [each.offset for each in supports]),
    )


def _lowered_without_edge(support: _Support, shape: tuple[int, int]) -> _Support:
    """Lower the support where residuals are so large that the image shows no edge."""
    variance = _smoothed(support.variance, support, shape)
    return replace(support, weight=support.weight * np.clip(1.0 - variance / _NO_EDGE, 0.0, 1.0))


def _precision(
    correlation: Correlation, support: _Support, information: np.ndarray, stage: Stage, scale: float
) -> BandedMatrix:
    """Precision matrix, the inverse of the covariance, of the degrees of freedom, (n_dof, n_dof) 1/mm^2."""
    across = support.normals[:, :, None] * support.normals[:, None, :]
    prior = support.area * _patches(correlation.surface) / _PRIOR_MM**2
    data = correlation.surface.quadratic_form((information + prior)[:, None, None] * across)
    return BandedMatrix(data + scale * correlation.energies(bending=stage.bending, sliding=stage.sliding, anchor=0.0))


def _patches(surface: SampledSurface) -> float:
    """Approximate number of patches of the surface that move independently."""
    return surface.n_dof / 3.0


def _around(values: np.ndarray, area: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Area-weighted mean over the neighbourhood of each line."""
    return mean_over_neighbours(values, area, shape, [_NEIGHBOURS * count for count in shape])


def _smoothed(values: np.ndarray, support: _Support, shape: tuple[int, int]) -> np.ndarray:
    """Mean over the neighbourhood of each line, weighted by support; the mean over the organ if there is no support."""
    weight = support.area * support.weight
    total = max(float(weight.sum()), 1e-300)
    few = 1e-3 * total / len(weight)
    return np.maximum(
        _around((weight * values + few * (weight @ values) / total) / (weight + few), weight + few, shape), 1e-12
    )
