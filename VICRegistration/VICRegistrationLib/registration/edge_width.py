"""Width of an organ's edge in the image."""

from __future__ import annotations

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.sampling import Sampler

# Where the edge's width is measured: these distances from the surface, in pixels.
PROFILE_PIXELS = np.arange(-6.0, 6.01, 0.25)


def edge_width(sampler: Sampler, surface: BSplineSurface, voxel: np.ndarray) -> float | None:
    """Measure the width of an organ's edge in the image.

    Parameters
    ----------
    sampler : Sampler
        The grey levels, in the frame of the surface.
    surface : BSplineSurface
        Near the edge.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.

    Returns
    -------
    float or None
        mm; None where there is no edge.

    Notes
    -----
    The mean profile across the surface, mostly from places where it is sharp, that is not across thick slices. The
    width is that of the cosine ramp of equation 3 with the same slope at half height.
    """
    pixel = float(np.linalg.norm(voxel, axis=0).min())
    u, v = surface.midpoints(32, 20)
    normals = surface.normals(u, v)
    depths = PROFILE_PIXELS * pixel
    values, valid = sampler.values(surface.points(u, v)[:, None] + depths[:, None] * normals[:, None])
    inner = values[:, PROFILE_PIXELS < -3.0].mean(axis=1)
    beyond = values[:, (PROFILE_PIXELS > 2.0) & (PROFILE_PIXELS < 4.0)]
    darker = float(np.median(inner - beyond.mean(axis=1))) > 0.0
    step = inner - (beyond.min(axis=1) if darker else beyond.max(axis=1))
    blur = np.linalg.norm(normals @ voxel, axis=1) / pixel
    weight = valid.all(axis=1) * np.maximum(step if darker else -step, 0.0) / blur**4
    if not weight.sum() > 0.0:
        return None
    profile = (weight / np.where(step == 0.0, 1.0, step) @ (values - (inner - step)[:, None])) / weight.sum()
    near = np.abs(PROFILE_PIXELS) <= 2.5
    slope = float(np.max(-np.gradient(profile, depths)[near]))
    height = float(
        profile[PROFILE_PIXELS < -3.0].mean() - profile[(PROFILE_PIXELS > 0.0) & (PROFILE_PIXELS < 4.0)].min()
    )
    return 0.5 * np.pi * height / slope if slope > 0.0 else None
