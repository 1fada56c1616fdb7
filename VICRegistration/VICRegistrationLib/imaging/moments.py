"""Where an organ is, how it lies and how large it is: centre, principal axes and extents."""

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
    """Work out the centre, the principal axes and the extents of a region.

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
    The directions of the axes come from the region, not from the eigenvalue solver, so they turn with it: the
    third moment along each axis is positive; of the three, the axis whose normalised skewness is least is
    turned round if that is needed for a right-handed frame. For a region symmetric about an axis' middle
    plane the direction is arbitrary, and for a region with two equal extents so are the axes.
    """
    sums, rows, middle = _row_sums(region.mask)
    count = sums[:, 0].sum()
    # Second moments of the voxels' centres along (i, j, k); a voxel is a small box, not a point: it adds a twelfth.
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


def _row_sums(mask):
    """Add up 1, i, i^2 and i^3 over the voxels of each row, its (j, k), and the centre (i, j, k) they count from."""
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
    """Add up over the voxels the cube of their coordinate along directions (n, 3) of (i, j, k), shape (n,)."""
    along, across = directions[:, 0, None], directions[:, 1:] @ rows.T
    n, first, second, third = sums.T
    return (along**3 * third + 3 * along**2 * across * second + 3 * along * across**2 * first + across**3 * n).sum(
        axis=1
    )
