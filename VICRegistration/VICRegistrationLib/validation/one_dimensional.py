"""The one-dimensional example of figures 5 and 6: a profile shifted along a row of pixels.

The paper shows the grey levels of its row only in a figure. Here they are the profile itself (equation 3) at the true
shift, sampled at whole pixels and interpolated by a cubic spline.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.optimize import minimize_scalar

from ..registration.virtual_image import IntensityProfile

PROFILE = IntensityProfile(inside=130.0, outside=25.0, width=3.0, centered=False)
TRUE_SHIFT = 2.6
N_PIXELS = 10
N_SAMPLES = 31


def row_of_pixels(shift: float = TRUE_SHIFT) -> np.ndarray:
    """Grey levels at pixels 0, 1, ..., 9 of an edge at `shift` pixels, (10,)."""
    return PROFILE.value(np.arange(N_PIXELS) - shift)


def interpolated(pixels: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Grey levels between the pixels, at positions (n,) in pixels."""
    return ndimage.map_coordinates(pixels, [positions], order=3, mode="mirror")


def cost(shifts: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the cost of the virtual image for each shift, in pixels, (n,).

    Notes
    -----
    Equation 4 of Jiang et al. (Strain 2019): uniform samples of [0, tau].
    """
    samples = np.linspace(0.0, PROFILE.width, N_SAMPLES)
    positions = np.add.outer(np.atleast_1d(shifts), samples)
    grey = interpolated(pixels, positions.ravel()).reshape(positions.shape)
    return ((grey - PROFILE.value(samples)) ** 2).sum(axis=1)


def best_shift(pixels: np.ndarray) -> float:
    """Shift at which the cost is least, pixels."""
    shifts = np.linspace(0.0, N_PIXELS - 1.0 - PROFILE.width, 61)
    start = shifts[np.argmin(cost(shifts, pixels))]
    found = minimize_scalar(
        lambda shift: cost(shift, pixels)[0],
        bounds=(start - 0.2, start + 0.2),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return float(found.x)
