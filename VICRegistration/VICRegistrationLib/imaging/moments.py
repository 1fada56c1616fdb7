"""Centre, principal axes and extents of a region, and the radius of a ball of the same volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .region import Region


@dataclass(frozen=True, eq=False)
class Moments:
    """First and second moments of a region, in RAS mm.

    Attributes
    ----------
    center : ndarray, shape (3,)
        Centre of mass.
    axes : ndarray, shape (3, 3)
        Rows are unit vectors along the principal axes, longest first, a right-handed frame.
    extents : ndarray, shape (3,)
        Standard deviations along the axes; a solid ellipsoid's half axes are sqrt(5) times these.
    """

    center: np.ndarray
    axes: np.ndarray
    extents: np.ndarray


def moments(region: Region) -> Moments:
    """Compute the centre, the principal axes and the extents of a region.

    Parameters
    ----------
    region : Region

    Returns
    -------
    Moments

    Raises
    ------
    ValueError
        If the region has no voxels.

    Notes
    -----
    The signs of the axes are determined by the region, so that they rotate with it: the third moment along each axis is
    positive. If the frame is then left-handed, the axis with the smallest normalised skewness is reversed. For a region
    that is symmetric about the middle plane of an axis, the sign of that axis is arbitrary, and for a region with two
    equal extents so are the axes.
    """
    sums, rows, middle = _row_sums(region.mask)
    count = sums[:, 0].sum()
    # Second moments of the voxels' centres along (i, j, k). A voxel is a box of size 1, which adds 1/12.
    along_i = np.array([sums[:, 2].sum(), *(sums[:, 1] @ rows)])
    across = rows.T @ (sums[:, :1] * rows)
    second = np.block([[along_i[:1, None], along_i[None, 1:]], [along_i[1:, None], across]]) / count
    steps = region.ijk_to_ras[:3, :3]
    covariance = steps @ (second + np.eye(3) / 12) @ steps.T
    variances, vectors = np.linalg.eigh(covariance)
    order = np.argsort(variances)[::-1]
    extents = np.sqrt(variances[order])
    axes = vectors[:, order].T
    skewness = _third_moments(axes @ steps, sums, rows) / count / extents**3
    axes = axes * np.where(skewness < 0, -1.0, 1.0)[:, None]
    if np.linalg.det(axes) < 0:
        axes[np.argmin(np.abs(skewness))] *= -1
    center = steps @ middle + region.ijk_to_ras[:3, 3]
    return Moments(center=center, axes=axes, extents=extents)


def ball_radius(volume: float) -> float:
    """Radius of a ball with a volume, mm for mm^3; the sign, negative if a surface is inside out, is ignored."""
    return (3.0 * abs(float(volume)) / (4.0 * np.pi)) ** (1.0 / 3.0)


def _row_sums(mask):
    """Sum 1, i, i^2 and i^3 over the voxels of each row; returns also the rows' (j, k), and the centre as origin."""
    size = mask.shape[2]
    power = np.vander(np.arange(size) - size / 2, 4, increasing=True)
    sums = mask.reshape(-1, size).astype(float) @ power
    filled = np.flatnonzero(sums[:, 0])
    if not len(filled):
        msg = "The region is empty; it needs voxels to have a centre. Separate the organ again."
        raise ValueError(msg)
    sums = sums[filled]
    rows = np.column_stack([filled % mask.shape[1], filled // mask.shape[1]]).astype(float)
    count = sums[:, 0].sum()
    center = sums[:, 0] @ rows / count
    shift = sums[:, 1].sum() / count
    n, first, second, third = sums.T
    sums = np.column_stack(
        [
            n,
            first - shift * n,
            second - 2 * shift * first + shift**2 * n,
            third - 3 * shift * second + 3 * shift**2 * first - shift**3 * n,
        ]
    )
    return sums, rows - center, np.array([shift + size / 2, *center])


def _third_moments(directions, sums, rows):
    """Sum over the voxels the cube of their coordinate along directions (n, 3) in (i, j, k), shape (n,)."""
    along, across = directions[:, 0, None], directions[:, 1:] @ rows.T
    n, first, second, third = sums.T
    return (along**3 * third + 3 * along**2 * across * second + 3 * along * across**2 * first + across**3 * n).sum(
        axis=1
    )
