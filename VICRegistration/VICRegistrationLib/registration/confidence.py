"""How sure a fitted surface is, point by point: its standard deviation along the normal.

Two things make a surface uncertain. Noise moves it: the Gauss-Newton matrix of the fit, scaled by the residuals around
each place and by the number of voxels that the surface passes, is the inverse of the covariance of its control points.
And what the net cannot follow, or what lies beside the edge, leaves it off: each normal line shows how far its own edge
is from the surface. Both are added. Where no line shows an edge, neither is known, and the surface is as
uncertain as it was before the image was looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image, patient_side
from .banded_matrix import BandedMatrix
from .cost import Correlation
from .joint_stacks import with_stacks
from .nets import sampled
from .options import FitOptions
from .sample_grid import SampledSurface
from .schedule import Schedule
from .stacks import StackUse
from .stages import Stage

# Standard deviation of a surface before the image was looked at, mm: about as far as a fit goes.
_PRIOR_MM = 3.0
# Calibrated on phantoms: what part of the misfit of the lines is that of the surface.
_MISFIT_SHARE = 0.75
# Neighbours whose residuals count, as a share of the parameter range. Half and twice of it change the standard
# deviation of the demo's organs by 6 % at most, that of a bladder that shows no edge on 15 % of its area by 40 %.
_NEIGHBOURS = 0.04
# The surface as a whole lies off by this part of a pixel, however many voxels it passes: seen on phantoms.
_COMMON_PIXELS = 0.08
# Mean squared residual, in units of the squared contrast, at which the image looks like no edge. Half and twice of it
# change the share of the area without one by 0.03 at most in two clear images of bladders. Without a limit it is 0.43
# in place of 0.71 for a hippocampus, which shows none.
_NO_EDGE = 0.5
# A place with less support than this follows no edge.
_LEAST_SUPPORT = 0.3
# Of the area: with more than this without an edge, most of the volume's variance is the 3 mm that are assumed there and
# not what was calibrated on phantoms (half of it at 3.2, 3.4 and 3.9 % of the demo's bladder, vagina and rectum).
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
        How much of the organ's edge is seen there, 0 to 1.
    areas : (n_u, n_v) ndarray
        Area that belongs to each, mm^2.
    points : (n_u, n_v, 3) ndarray
        Of the surface there, RAS mm.
    volume_sd_ml : float
        Standard deviation of the volume, ml.
    """

    surface: BSplineSurface
    deviations: np.ndarray
    supports: np.ndarray
    areas: np.ndarray
    points: np.ndarray
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
        # Closed in u; beyond the last samples lie the poles.
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
        """Whether the volume's standard deviation is mostly what was calibrated: at most 4 % follow no edge."""
        return self.unsupported_share <= _MOST_WITHOUT_EDGE

    @property
    def unsupported_side(self) -> str:
        """Side of the organ where most of that lies, such as "superior"; empty if it is spread over the surface."""
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
    """Work out how sure a surface is.

    Parameters
    ----------
    image : Image
        In which it was fitted.
    surface : BSplineSurface
        A closed organ, RAS mm.
    options : FitOptions
        By which it was fitted, with automatic choices filled in.
    stacks : sequence of StackUse
        Further stacks that it was fitted to.

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
    sliding, and a prior of 3 mm for each patch of the net. Calibrated on noisy phantoms, see the README; it holds for
    real images as far as they are like those.
    """
    schedule = Schedule.around(image, surface, options)
    if schedule.inside == schedule.outside:
        # The estimates along the surface will show that there is no edge: they only need to know a brighter side.
        schedule = replace(schedule, outside=schedule.inside - 1e-6 * (abs(schedule.inside) or 1.0))
    stage = with_stacks(schedule, surface, stacks).fine
    seen, *others = stage.correlations(sampled(surface, options.closure))
    shape = seen.surface.grid.shape
    supports = [_without_edges_elsewhere(_support(each), shape) for each in (seen, *others)]
    support = _joint(supports)
    areas = support.area * surface.area()
    pixel = float(np.min(image.spacing))
    information, scale = np.zeros(len(areas)), 0.0
    for each, one in zip((seen, *others), supports):
        variance = _smoothed(one.variance, one, shape)
        # A voxel is one independent number, whatever the number of samples in it.
        lines = areas / (abs(np.linalg.det(each.virtual.voxel)) / np.linalg.norm(each.virtual.voxel, axis=0).min())
        information += lines * one.weight * one.slope / variance
        scale += float(np.sum(lines) * np.mean(1.0 / variance))
    precision = _precision(seen, support, information, stage, scale)
    moves = seen.surface.normal_motion(support.normals)
    noise = precision.variances(moves)
    misfit = _MISFIT_SHARE**2 * _smoothed(np.minimum(support.offset**2, _PRIOR_MM**2), support, shape)
    # Where no line around shows an edge, the surface is where it was put.
    blind = _PRIOR_MM**2 * np.clip(1.0 - _around(support.weight, support.area, shape) / _LEAST_SUPPORT, 0.0, 1.0)
    pushed = moves.T @ areas
    volume = pushed @ precision.solve(pushed) + (_COMMON_PIXELS * pixel * areas.sum()) ** 2
    volume += areas.sum() * (areas @ (misfit + blind)) / _patches(seen.surface)
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
    """What each normal line of a surface shows of the edge, (n,) but where stated.

    Parameters
    ----------
    points, normals : (n, 3) ndarray
        Where the lines cross the surface.
    area : ndarray
        Share of the surface's area, sum 1.
    weight : ndarray
        How much of an edge the line shows, 0 to 1; 0 outside of the volume.
    variance : ndarray
        Mean squared residual, in units of the squared contrast.
    slope, offset : ndarray
        How steep the edge is and how far from the surface, see :meth:`.cost.Samples.edges`.
    share : ndarray
        What part of the line's weight in the cost is this image's.
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
    """Measure what each normal line shows of the edge, before the surface moves."""
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
    """Combine what several images show: of an edge as much as the best one does, and where it is on average."""
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


def _without_edges_elsewhere(support: _Support, shape: tuple[int, int]) -> _Support:
    """Lower the support where the image looks like no edge at all: what is seen there is something else."""
    variance = _smoothed(support.variance, support, shape)
    return replace(support, weight=support.weight * np.clip(1.0 - variance / _NO_EDGE, 0.0, 1.0))


def _precision(
    correlation: Correlation, support: _Support, information: np.ndarray, stage: Stage, scale: float
) -> BandedMatrix:
    """Inverse of the covariance of the degrees of freedom, (n_dof, n_dof) 1/mm^2."""
    across = support.normals[:, :, None] * support.normals[:, None, :]
    prior = support.area * _patches(correlation.surface) / _PRIOR_MM**2
    data = correlation.surface.quadratic_form((information + prior)[:, None, None] * across)
    return BandedMatrix(data + scale * correlation.energies(bending=stage.bending, sliding=stage.sliding, anchor=0.0))


def _patches(surface: SampledSurface) -> float:
    """About how many patches of the surface move by themselves."""
    return surface.n_dof / 3.0


def _around(values: np.ndarray, area: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Mean over the area around each line."""
    sigma = [_NEIGHBOURS * count for count in shape]
    above, below = (
        ndimage.gaussian_filter(part.reshape(shape), sigma, mode=("wrap", "nearest")) for part in (values * area, area)
    )
    return (above / below).ravel()


def _smoothed(values: np.ndarray, support: _Support, shape: tuple[int, int]) -> np.ndarray:
    """Mean of the lines around each, where they show an edge; the organ's mean where none does."""
    weight = support.area * support.weight
    total = max(float(weight.sum()), 1e-300)
    few = 1e-3 * total / len(weight)
    return np.maximum(
        _around((weight * values + few * (weight @ values) / total) / (weight + few), weight + few, shape), 1e-12
    )
