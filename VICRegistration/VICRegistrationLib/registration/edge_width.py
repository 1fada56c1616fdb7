"""Width of the edge of an organ in an image."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler
from .options import TAU_PIXELS

# Width of the cosine ramp with the same slope at half height as a step blurred by a Gaussian, in standard deviations of
# the Gaussian.
WIDTH_OF_BLUR = 0.5 * np.pi * np.sqrt(2.0 * np.pi)
# Distances from the edge at which the profile is sampled, in pixels; stretched where the blur along the line is wider.
_PROFILE_PIXELS = np.arange(-6.0, 6.01, 0.25)
_PLATEAU = _PROFILE_PIXELS < -3.0
_BEYOND = (_PROFILE_PIXELS > 2.0) & (_PROFILE_PIXELS < 4.0)
_WALL = (_PROFILE_PIXELS >= 1.0) & (_PROFILE_PIXELS < 4.0)
_NEAR = np.abs(_PROFILE_PIXELS) <= 2.5
# Number of measurements, see the notes of `edge_width`. With two the demo's organs and two real bladders are the same
# to 0.003 mm; with one an organ in noise is off by 0.05 mm in place of 0.03 mm.
_PASSES = 3
# Each line's edge is looked for within this distance, in pixels; half and twice of it change the demo's means by 0.001
# mm at most. If lines are not moved to their edges, the blur of an organ 12 mm thick in slices of 4 mm is measured as
# 0.35 mm in place of 0.40 mm; it was painted with 0.42 mm.
_EDGE_PIXELS = 2.0


def blur_covariance(voxel: np.ndarray, edge: float) -> np.ndarray:
    """Covariance of the blur of an image that is interpolated linearly, (3, 3) mm^2.

    Parameters
    ----------
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.
    edge : float
        Width of the edge in the image where it is sharpest, as of :func:`edge_width`, mm. The part that the voxels do
        not explain is the point spread of the scanner, taken as isotropic.

    Notes
    -----
    Averaging over a voxel and linear interpolation blur along each voxel edge e with the variances |e|^2 / 12 and
    |e|^2 / 6. The sum of both over the three edges is the covariance sum e e' / 4.
    """
    covariance = voxel @ voxel.T / 4.0
    sharpest = float(np.linalg.eigvalsh(covariance)[0])
    return covariance + max((edge / WIDTH_OF_BLUR) ** 2 - sharpest, 0.0) * np.eye(3)


def edge_width(sampler: Sampler, surface: BSplineSurface, voxel: np.ndarray) -> float | None:
    """Measure the width of an organ's edge in the image.

    Parameters
    ----------
    sampler : Sampler
        The grey levels, in the frame of the surface.
    surface : BSplineSurface
        Near the edge.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.

    Returns
    -------
    float or None
        mm; None if the image shows no edge.

    Notes
    -----
    The width is that of the cosine ramp of equation 3 with the same slope at half height as the weighted median profile
    across the surface. Sharp lines, not across thick slices, have the largest weights. The profile is measured three
    times. Each time the lines are moved to their own edges, because the scatter of the edges about the surface would
    widen the profile, and stretched by the blur along them that follows from the last width.
    """
    pixel = float(np.linalg.norm(voxel, axis=0).min())
    u, v = surface.midpoints(32, 20)
    points, normals = surface.points(u, v), surface.normals(u, v)
    offsets, width = np.zeros(len(points)), TAU_PIXELS * pixel
    for _ in range(_PASSES):
        covariance = blur_covariance(voxel, width)
        blur = np.sqrt(np.einsum("na,ab,nb->n", normals, covariance, normals) / np.linalg.eigvalsh(covariance)[0])
        depths = offsets[:, None] + pixel * blur[:, None] * _PROFILE_PIXELS
        values, valid = sampler.values(points[:, None] + depths[..., None] * normals[:, None])
        weight, shares = _steps(values)
        weight = valid.all(axis=1) * weight / blur**4
        if not weight.sum() > 0.0:
            return None
        width = _width_of_profile(_median(shares, weight), pixel, width)
        if width is None:
            return None
        # A step from 1 to 0 in the middle of the interval has the mean 0.5.
        middle = np.abs(_PROFILE_PIXELS) <= _EDGE_PIXELS
        lack = np.clip(shares[:, middle], 0.0, 1.0).mean(axis=1) - 0.5
        offsets = offsets + np.where(weight > 0.0, 2.0 * _EDGE_PIXELS * pixel * blur * lack, 0.0)
    return width


def _steps(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the step on each line, (n,), 0 if its sign is wrong; and the profiles scaled from 1 to 0, (n, m)."""
    inner = values[:, _PLATEAU].mean(axis=1)
    beyond = values[:, _BEYOND]
    darker = float(np.median(inner - beyond.mean(axis=1))) > 0.0
    outer = beyond.min(axis=1) if darker else beyond.max(axis=1)
    step = inner - outer
    shares = (values - outer[:, None]) / np.where(step == 0.0, 1.0, step)[:, None]
    return np.maximum(step if darker else -step, 0.0), shares


def _median(shares: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted median of lines (n, m) at each depth, (m,); insensitive to clots and folds at some places."""
    order = np.argsort(shares, axis=0)
    cumulated = np.cumsum(weight[order], axis=0)
    middle = (cumulated >= 0.5 * cumulated[-1]).argmax(axis=0)
    return np.take_along_axis(shares, np.take_along_axis(order, middle[None], axis=0), axis=0)[0]


def _width_of_profile(profile: np.ndarray, pixel: float, expected: float) -> float | None:
    """Width of the cosine ramp with the height and the slope of a profile from 1 to 0, mm; None if it does not fall.

    The level outside is corrected for the blur of an edge of the expected width, because walls may be thin.
    """
    slope = float(np.max(-np.gradient(profile, pixel * _PROFILE_PIXELS)[_NEAR]))
    inner = float(profile[_PLATEAU].mean())
    blurred = ndtr(-pixel * _PROFILE_PIXELS[_WALL] * WIDTH_OF_BLUR / expected)
    height = inner - float(np.min((profile[_WALL] - blurred * inner) / (1.0 - blurred)))
    return 0.5 * np.pi * height / slope if slope > 0.0 else None
