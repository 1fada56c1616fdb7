"""A threshold or an erosion that separates an organ where the given one fails, found by trying several."""

from __future__ import annotations

import numpy as np

from ..imaging.image import Image
from ..imaging.region import Region
from .growing import FRAGMENT, grown_region
from .ray_edges import find_edges

# Radii of the erosion that are tried, mm, and widths of the threshold, as shares of the refused one.
_RADII_MM = (2.0, 4.0, 6.0, 8.0)
_NARROWER = (0.75, 0.5, 0.3)


def remedy(image: Image, seeds: np.ndarray, refused: tuple[float, float], *, erosion, dilation, fill) -> str:
    """Find an erosion or a threshold that separates one organ: no fragment of it, and without a leak.

    Parameters
    ----------
    image : Image
    seeds : (n, 3) ndarray
        RAS mm.
    refused : (float, float)
        Threshold whose region is too large.
    erosion, dilation : float or None
        Radii that the user has given, mm.
    fill : bool
        Fill cavities.

    Returns
    -------
    str
        A sentence for the user with the value that works, or with general advice if none does.
    """
    edges = find_edges(image, seeds)
    low, high = np.clip(refused, image.array.min(), image.array.max()).astype(float)
    radii = () if erosion is None else [radius for radius in _RADII_MM if radius > erosion]
    attempts = [({"threshold": (low, high), "erosion": radius}, f"an erosion of {radius:g} mm") for radius in radii]
    for share in _NARROWER:
        narrow = tuple(
            float(f"{edges.median_level + share * (level - edges.median_level):.4g}") for level in (low, high)
        )
        words = "a threshold of {:.5g} to {:.5g}".format(*narrow)
        attempts.append(({"threshold": narrow, "erosion": erosion}, words))
    for options, words in attempts:
        region = _separated(image, seeds, dilation=dilation, fill=fill, **options)
        if region is not None and 1000.0 * region.volume_ml > FRAGMENT * edges.volume:
            return f"With {words} it is one piece of {region.volume_ml:.1f} ml."
    return "Check the place of the seeds: are they inside the organ? Narrow the threshold, or increase the erosion."


def _separated(image: Image, seeds: np.ndarray, **options) -> Region | None:
    """Return the region, or None if it is refused or reported as a leak."""
    try:
        region = grown_region(image, seeds, **options)
    except ValueError:
        return None
    return None if region.diagnostics else region
