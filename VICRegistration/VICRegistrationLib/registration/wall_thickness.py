"""Thickness of the wall of an organ in an image with thick slices."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler
from .edge_width import blur_covariance

# Number of normal lines in u and v.
_LINES = (32, 20)
# Standard deviation of the neighbourhood over which levels are taken as equal, as a fraction of the parameters' range.
# With 0.05 and 0.1 the walls of the demo's organs are the same to 0.1 mm.
_NEIGHBOURHOOD = 0.075
# Samples on a line begin this far inside and end this far beyond the thickest wall, mm; their number, and the number of
# thicknesses that are tried. Half and twice of each change painted walls of 2.5 to 4.5 mm by at most 0.07 mm.
_INSIDE_MM, _BEYOND_MM, _SAMPLES, _TRIED = 2.0, 3.0, 20, 14
# Least thickness, in widths of the edge. With 0.5 the demo's mean distances are the same to 0.001 mm.
_LEAST_EDGE = 0.75
# Smallest step from the wall to the organ, relative to the step from the wall to what lies behind it. Real walls have
# 1.5 and more; a surface inside of the organ has 0.05.
_LEAST_STEP = 0.2


def wall_thickness(sampler: Sampler, surface: BSplineSurface, voxel: np.ndarray, edge: float) -> float | None:
    """Measure the thickness of the wall around an organ, if it is smaller than a voxel's longest edge.

    Only then one voxel contains the organ and what lies behind its wall.

    Parameters
    ----------
    sampler : Sampler
        The grey levels, in the frame of the surface.
    surface : BSplineSurface
        Near the edge.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.
    edge : float
        Width of the edge, mm. A wall that is much thinner is not found.

    Returns
    -------
    float or None
        mm; None if no such wall is found, or if no voxel is longer than the edge is wide. A wall is darker, or
        brighter, than both the organ and what lies behind it; with monotonic grey levels no thickness is determined.

    Notes
    -----
    One thickness for the whole organ, with the smallest sum of squared residuals. The model of the grey levels along
    the normals has a level of the organ, one of the wall, and one with a slope behind the wall, all blurred by the
    voxels. The levels are found by least squares in each neighbourhood.
    """
    longest = float(np.linalg.norm(voxel, axis=0).max())
    if longest <= edge:
        return None
    tried = np.linspace(_LEAST_EDGE * edge, longest + 0.5, _TRIED)
    u, v = surface.midpoints(*_LINES)
    points, normals = surface.points(u, v), surface.normals(u, v)
    deviation = np.sqrt(np.einsum("na,ab,nb->n", normals, blur_covariance(voxel, edge), normals))[:, None]
    depths = np.linspace(-_INSIDE_MM, longest + _BEYOND_MM, _SAMPLES)
    values, valid = sampler.values(points[:, None] + depths[:, None] * normals[:, None])
    if not valid.any():
        return None
    # Lines across thick slices are blurred, and determine less.
    weight = valid / (deviation / deviation.min()) ** 4
    # The regularisation must not depend on a constant that is added to the image.
    values = values - values[valid].mean()
    fits = [_fitted(values, weight, depths, deviation, each) for each in tried]
    residuals = np.array([residual for residual, *_ in fits])
    best = int(residuals.argmin())
    _, to_inside, to_behind = fits[best]
    if best in (0, len(tried) - 1) or to_behind <= 0.0 or to_inside < _LEAST_STEP * to_behind:
        return None
    before, least, after = residuals[best - 1 : best + 2]
    thickness = tried[best] + 0.5 * (tried[1] - tried[0]) * (before - after) / (before - 2.0 * least + after)
    return float(thickness) if thickness < longest else None


def _fitted(
    values: np.ndarray, weight: np.ndarray, depths: np.ndarray, deviation: np.ndarray, thickness: float
) -> tuple[float, float, float]:
    """Fit a wall of a given thickness to grey levels (n, m), weighted by (n, m).

    Returns the sum of squared residuals, the absolute value of the median step from the wall to the organ, and the
    median step from the wall to what lies behind it, positive if both steps have the same sign.
    """
    inside, beyond = ndtr(-depths / deviation), (depths - thickness) / deviation
    behind = ndtr(beyond)
    slope = deviation * (beyond * behind + np.exp(-0.5 * beyond**2) / np.sqrt(2.0 * np.pi))
    levels = np.stack([inside, 1.0 - inside - behind, behind, slope], axis=2)
    weighted = weight[..., None] * levels
    forms = _over_neighbours(np.einsum("nma,nmb->nab", weighted, levels).reshape(len(values), -1)).reshape(-1, 4, 4)
    sums = _over_neighbours(np.einsum("nma,nm->na", weighted, values))
    found = np.linalg.solve(forms + 1e-9 * np.eye(4), sums[..., None])
    to_inside, to_behind = np.median(found[:, [0, 2], 0] - found[:, 1:2, 0], axis=0)
    residual = float(np.vdot(weight, np.square(values - (levels @ found)[..., 0])))
    return residual, float(abs(to_inside)), float(np.sign(to_inside) * to_behind)


def _over_neighbours(numbers: np.ndarray) -> np.ndarray:
    """Average numbers of all lines, (n, k), over their neighbours."""
    sigma = [*(_NEIGHBOURHOOD * count for count in _LINES), 0.0]
    grid = ndimage.gaussian_filter(numbers.reshape(*_LINES, -1), sigma, mode=("wrap", "nearest", "nearest"))
    return grid.reshape(numbers.shape)
