"""Which threshold or radius separates an organ where what was asked for is refused: values that were tried."""

from __future__ import annotations

import numpy as np

from ..imaging.image import Image
from ..imaging.region import Region
from .growing import FRAGMENT, grown_region
from .ray_edges import find_edges

# Radii of the erosion, mm, and widths of the threshold around the level at the seeds, as shares of the one refused.
_RADII_MM = (2.0, 4.0, 6.0, 8.0)
_NARROWER = (0.75, 0.5, 0.3)


def remedy(image: Image, seeds: np.ndarray, refused: tuple[float, float], *, erosion, dilation, fill) -> str:
    """Look for a value that separates one organ, larger than a fragment and not larger than what the seeds see.

    Parameters
    ----------
    image : Image
    seeds : (n, 3) ndarray
        RAS mm.
    refused : (float, float)
        Threshold that gives too large a region.
    erosion, dilation : float or None
        As given, mm.
    fill : bool

    Returns
    -------
    str
        A sentence.
    """
    edges = find_edges(image, seeds)
    low, high = np.clip(refused, image.array.min(), image.array.max()).astype(float)
    radii = () if erosion is None else [radius for radius in _RADII_MM if radius > erosion]
    attempts = [({"threshold": (low, high), "erosion": radius}, f"an erosion of {radius:g} mm") for radius in radii]
    for share in _NARROWER:
        narrow = tuple(float(f"{edges.middle + share * (level - edges.middle):.4g}") for level in (low, high))
        words = "a threshold of {:.4g} to {:.4g}".format(*narrow)
        attempts.append(({"threshold": narrow, "erosion": erosion}, words))
    for options, words in attempts:
        region = _separated(image, seeds, dilation=dilation, fill=fill, **options)
        if region is not None and 1000.0 * region.volume_ml > FRAGMENT * edges.volume:
            return f"With {words} it is one piece of {region.volume_ml:.1f} ml."
    return "Check the place of the seeds: are they inside the organ? Narrow the threshold, or increase the erosion."


def _separated(image: Image, seeds: np.ndarray, **options) -> Region | None:
    """Return the region, or None where it is refused or larger than what the seeds see."""
    try:
        region = grown_region(image, seeds, **options)
    except ValueError:
        return None
    return None if region.diagnostics else region
