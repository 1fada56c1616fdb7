"""How far a surface may go from the separated region: a leash for images that show no edge."""

from __future__ import annotations

import numpy as np

from ..geometry.projection import closest_points
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface

# Share of the radius of a ball of the region's volume.
_LEASH = 0.5
_SAMPLES = (32, 20)


def astray(surface: BSplineSurface, start: BSplineSurface) -> str:
    """Tell whether a surface has folded or has gone too far from where it started.

    Parameters
    ----------
    surface : BSplineSurface
    start : BSplineSurface
        The surface of the separated region, in the same frame.

    Returns
    -------
    str
        What is wrong with it, in words that go on a sentence; empty if nothing is.
    """
    problems = check_surface(surface)
    if problems:
        return f"its surface was no valid one ({problems[0].kind})"
    radius = (3.0 * abs(start.volume()) / (4.0 * np.pi)) ** (1.0 / 3.0)
    if surface.control_net.shape == start.control_net.shape:
        # No place of a surface moves farther than its control points.
        moved = np.linalg.norm(surface.control_net - start.control_net, axis=2).max()
        if moved <= _LEASH * radius:
            return ""
    (u_low, u_high), (v_low, v_high) = surface.domain
    u = u_low + (u_high - u_low) * (np.arange(_SAMPLES[0]) + 0.5) / _SAMPLES[0]
    v = v_low + (v_high - v_low) * (np.arange(_SAMPLES[1]) + 0.5) / _SAMPLES[1]
    away = float(np.abs(closest_points(start, surface.grid(u, v).reshape(-1, 3)).distances).max())
    if away > _LEASH * radius:
        return f"its surface went {away:.1f} mm away from the region, more than half the organ's radius"
    return ""
