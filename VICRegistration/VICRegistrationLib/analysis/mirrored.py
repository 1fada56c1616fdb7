"""Whether a reference is the mirror image of what it should be: left for right, or RAS coordinates taken for LPS."""

from __future__ import annotations

import numpy as np

from ..geometry.surface import BSplineSurface
from .comparison import triangles_of, volume_dice
from .distances import Reference
from .reference_meshes import ReferenceMesh

# A mirror image gets a warning if it shares more than `_ALIKE` of the volume, as real pairs of organs and other organs
# do not, and misses less than `_BETTER` times what the reference misses as it is. That is 2.8 to 29 times for the real
# bladders and the demo's organs with their own references, and 0 to 0.6 times for the demo's bladder, which is nearly
# symmetric, with a mirrored one. A ball would have 1.
_ALIKE, _BETTER = 0.8, 0.8
_MIRRORS = {
    "left and right, and front and back": (-1.0, -1.0, 1.0),
    "left and right": (-1.0, 1.0, 1.0),
    "front and back": (1.0, -1.0, 1.0),
    "top and bottom": (1.0, 1.0, -1.0),
}


def mirrored(
    surface: BSplineSurface, reference: Reference, dice: float, *, center: np.ndarray | None = None
) -> tuple[str, float]:
    """Find the mirror image of a reference that a surface fits.

    Parameters
    ----------
    surface : BSplineSurface
        Closed, RAS mm.
    reference : BSplineSurface or ReferenceMesh
        Closed, RAS mm.
    dice : float
        Volume Dice of the two as they are.
    center : (3,) ndarray, optional
        Middle of the reference's own grid, RAS mm: a second place to mirror at, besides the origin.

    Returns
    -------
    sides : str
        What is exchanged; empty if no mirror image fits.
    dice : float
        With the mirror image.
    """
    if isinstance(reference, BSplineSurface):
        return "", dice
    fitted, found = triangles_of(surface), []
    for sides, signs in _MIRRORS.items():
        for middle in (np.zeros(3), *([] if center is None else [center])):
            points = middle + (reference.points - middle) * signs
            turned = reference.triangles[:, :: int(np.prod(signs))]
            found.append((volume_dice(fitted, ReferenceMesh(points, turned)), sides))
    best, sides = max(found)
    return (sides, best) if best > _ALIKE and 1.0 - best < _BETTER * (1.0 - dice) else ("", dice)
