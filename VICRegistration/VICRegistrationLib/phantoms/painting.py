"""Painting of synthetic MR images from closed surfaces: partial volume, texture, coil bias and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def paint(base: np.ndarray, layers: Sequence[tuple[np.ndarray, float | np.ndarray]]) -> np.ndarray:
    """Paint layers of tissue over a background, each over those before, with partial volumes.

    Parameters
    ----------
    base : (nk, nj, ni) array
        Grey levels of the background.
    layers : sequence of (fraction, level)
        `fraction` is an (nk, nj, ni) array of values from 0 to 1, as from `volume_fractions`; `level` is a
        grey level, or an (nk, nj, ni) array of them.

    Returns
    -------
    (nk, nj, ni) float32 array
        After each layer, ``image * (1 - fraction) + level * fraction``.

    Notes
    -----
    For a wall, paint what the organ's outer surface encloses, and then its lumen.
    """
    image = np.array(base, dtype=np.float32)
    for fraction, level in layers:
        image += np.asarray(fraction, np.float32) * (np.asarray(level, np.float32) - image)
    return image


def add_coil_bias(
    image: np.ndarray,
    ijk_to_ras: np.ndarray,
    *,
    strength: float,
    center: Sequence[float],
    width: float,
) -> np.ndarray:
    """Multiply an image by the smooth sensitivity of a receive coil.

    The sensitivity at distance d from `center` is ``1 + strength * exp(-d**2 / (2 * width**2))``.

    Parameters
    ----------
    image : (nk, nj, ni) array
        Grey levels.
    ijk_to_ras : (4, 4) array
        Affine matrix that takes voxel centres (i, j, k, 1) to RAS mm.
    strength : float
        Relative gain at the centre, above -1: 0.3 is 30 % brighter than far away.
    center : (3,) sequence
        Place with the largest gain, RAS mm; it may lie outside of the image.
    width : float
        Standard deviation of the Gaussian in mm.

    Returns
    -------
    (nk, nj, ni) float32 array
    """
    image = np.asarray(image, dtype=np.float32)
    offset = ijk_to_ras[:3, 3] - np.asarray(center, dtype=float)
    k, j, i = np.ogrid[tuple(slice(n) for n in image.shape)]
    squared_distance = np.zeros(image.shape, dtype=np.float32)
    for (step_i, step_j, step_k), start in zip(ijk_to_ras[:3, :3], offset):
        along_slice = (step_j * j + step_i * i).astype(np.float32)
        squared_distance += (along_slice + (step_k * k + start).astype(np.float32)) ** 2
    return image * (1 + np.float32(strength) * np.exp(squared_distance / np.float32(-2 * width**2)))


def add_rician_noise(image: np.ndarray, *, sigma: float, seed: int) -> np.ndarray:
    """Add the noise of a magnitude MR image (Gudbjartsson and Patz, Magn. Reson. Med. 34:910-914, 1995).

    Parameters
    ----------
    image : array
        Noise-free grey levels.
    sigma : float
        Standard deviation of the real and of the imaginary channel, in grey levels. In bright tissue the
        noise has this deviation; where there is no signal its mean is ``sigma * sqrt(pi / 2)``.
    seed : int
        Seed of the random numbers: the same seed gives the same image.

    Returns
    -------
    float32 array of the same shape
    """
    random = np.random.default_rng(seed)
    image = np.asarray(image, dtype=np.float32)
    real = image + np.float32(sigma) * random.standard_normal(image.shape, dtype=np.float32)
    imaginary = np.float32(sigma) * random.standard_normal(image.shape, dtype=np.float32)
    return np.hypot(real, imaginary)


def smooth_random_field(
    shape: tuple[int, int, int],
    spacing: Sequence[float],
    *,
    correlation_mm: float,
    seed: int,
) -> np.ndarray:
    """Make a smooth random texture for tissue.

    It is white noise on a coarse grid, convolved with Gaussians one axis after the other.

    Parameters
    ----------
    shape : (nk, nj, ni)
        Shape of the image array.
    spacing : (3,) sequence
        Voxel size along i, j and k in mm.
    correlation_mm : float
        Distance at which the correlation of two places has fallen to exp(-1/2) = 0.61.
    seed : int
        Seed of the random numbers: the same seed gives the same field.

    Returns
    -------
    (nk, nj, ni) float32 array
        Mean 0 and standard deviation 1 over the array.
    """
    # White noise convolved with a Gaussian of deviation s has a Gaussian correlation of deviation s * sqrt(2).
    deviation = correlation_mm / np.sqrt(2)
    weights = [_gaussian_weights(n, step / deviation) for n, step in zip(shape, np.asarray(spacing)[::-1])]
    field = np.random.default_rng(seed).standard_normal([w.shape[1] for w in weights], dtype=np.float32)
    for weight in weights:
        # The first axis is contracted, and the fine one comes last: after three times the order is k, j, i again.
        field = np.tensordot(field, weight, axes=(0, 1))
    # In double precision: the error of a float32 mean of millions of voxels is too large.
    field -= field.mean(dtype=float)
    return field / np.float32(field.std(dtype=float))


def _gaussian_weights(count: int, step: float) -> np.ndarray:
    """Gaussians of unit deviation about unit-spaced nodes, at `count` places `step` apart: (count, nodes)."""
    places = np.arange(count) * step
    # Beyond 4 deviations a node's weight is below 4e-4.
    nodes = np.arange(-4, np.ceil(places[-1]) + 5)
    return np.exp(-0.5 * (places[:, None] - nodes) ** 2).astype(np.float32)
