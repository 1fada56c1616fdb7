"""How far a surface may go from the separated region: a leash for images that show no edge."""

from __future__ import annotations

import numpy as np

from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..imaging.sampling import Sampler

# Share of the radius of a ball of the region's volume.
_LEASH = 0.5
_SAMPLES = (32, 20)


def astray(surface: BSplineSurface, distance: Sampler, volume: float) -> str:
    """Tell whether a surface has folded or has gone too far from the separated region.

    Parameters
    ----------
    surface : BSplineSurface
    distance : Sampler
        Signed distance from the region's boundary, mm, in the surface's frame.
    volume : float
        Of the region, mm^3.

    Returns
    -------
    str
        What is wrong with it, in words that go on a sentence; empty if nothing is.
    """
    problems = check_surface(surface)
    if problems:
        return f"its surface was no valid one ({problems[0].kind})"
    values, seen = distance.values(surface.points(*surface.midpoints(*_SAMPLES)))
    radius = (3.0 * volume / (4.0 * np.pi)) ** (1.0 / 3.0)
    if not seen.all():
        return "its surface left the surroundings of the region"
    away = float(np.abs(values).max())
    if away > _LEASH * radius:
        return f"its surface went {away:.1f} mm away from the region, more than half the organ's radius"
    return ""
