"""The intensity profile (level set function) across an organ's surface, and the virtual image it makes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class IntensityProfile:
    """Grey level as a function of the signed distance from the surface.

    Parameters
    ----------
    inside, outside : float
        Grey levels on both sides (A_max and A_min of the paper); the inside may be the darker one.
    width : float
        Width tau of the ramp between them, mm.
    centered : bool
        True: the surface lies at half height, ramp from -tau/2 to tau/2. False: as published, ramp from 0 to tau, which
        puts the surface at the inner foot of the ramp.

    Raises
    ------
    ValueError
        If the width is not positive or a number is not finite.

    Notes
    -----
    Equation 3 of Jiang et al. (Strain 2019).
    """

    inside: float
    outside: float
    width: float
    centered: bool = True

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not (np.isfinite([self.inside, self.outside, self.width]).all() and self.width > 0.0):
            msg = (
                f"A profile from {self.inside:g} to {self.outside:g} over {self.width:g} mm was given; "
                "finite grey levels and a positive width are needed."
            )
            raise ValueError(msg)

    def value(self, distance: np.ndarray) -> np.ndarray:
        """Grey level L(d) at signed distances (outward positive, mm)."""
        return self.outside + (self.inside - self.outside) * cosine_ramp(
            np.asarray(distance) / self.width, centered=self.centered
        )


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
