"""Detection of mirrored references: left and right exchanged, or RAS coordinates taken for LPS."""

from __future__ import annotations

import numpy as np

from ..geometry.surface import BSplineSurface
from .comparison import triangles_of, volume_dice
from .distances import Reference
from .reference_meshes import ReferenceMesh

# There is a warning if the Dice coefficient with a mirror image is above `_ALIKE`, which it is not for other organs,
# and its difference to 1 is less than `_BETTER` times that of the reference as it is. That ratio is 2.8 to 29 for the
# real bladders and the demo's organs with their own references, and 0 to 0.6 for the demo's bladder, which is nearly
# symmetric, with a mirrored one. It would be 1 for a ball.
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
    """Find a mirror image of a reference that fits a surface better.

    Parameters
    ----------
    surface : BSplineSurface
        Closed, RAS mm.
    reference : BSplineSurface or ReferenceMesh
        Closed, RAS mm.
    dice : float
        Volume Dice of surface and reference.
    center : (3,) ndarray, optional
        Middle of the reference's grid, RAS mm: mirror images are made at this point and at the origin.

    Returns
    -------
    sides : str
        Which sides are exchanged; empty if no mirror image fits better.
    dice : float
        Volume Dice with that mirror image, or the given one.
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
