"""One organ in stacks of several directions, each cheap enough to be fitted in a test, with the patient moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.phantoms.painting import paint

# Columns are the directions of i, j and k.
DIRECTIONS = {
    "sagittal": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
    "axial": [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
    "coronal": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}


def dented() -> BSplineSurface:
    """An ellipsoid with a dent and a bulge, so that it cannot be turned unseen."""
    surface = ellipsoid()
    net = surface.control_net.copy()
    for place, push, reach in (((12, 6, 8), (-5, 0, -2), 10.0), ((-6, -14, -10), (0, -4, 0), 9.0)):
        away = np.sum((net - CENTER - np.array(place)) ** 2, axis=-1, keepdims=True)
        net = net + np.exp(-away / (2.0 * reach**2)) * np.array(push)
    return surface.with_control_net(net)


def motion_about(center, shift, degrees) -> np.ndarray:
    """Rigid motion (4, 4): turns about R, A and S through a centre, degrees, and a shift, mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    matrix[:3, 3] = np.asarray(center) + shift - matrix[:3, :3] @ center
    return matrix


# Pixels fine enough for what several stacks bring, and how the patient moves between two of them.
GRID = {"spacing": (0.8, 0.8, 4.0), "size": (84, 84, 17)}
MOTION = motion_about(CENTER, (2.0, -1.5, 1.5), (1.0, -1.0, 1.5))


def stack_of(
    surface: BSplineSurface | Sequence[BSplineSurface],
    direction: str,
    *,
    motion: np.ndarray | None = None,
    levels: tuple[float, float, float] = (800.0, 100.0, 400.0),
    spacing: tuple[float, float, float] = (1.2, 1.2, 4.0),
    size: tuple[int, int, int] = (56, 56, 17),
    noise: float = 10.0,
    seed: int = 1,
    center=CENTER,
) -> Image:
    """Paint an organ, or several, with a wall of 6 mm, of which a motion (4, 4) takes every point elsewhere.

    The levels are those of the organ, its wall and its surroundings.
    """
    inner, wall, around = levels
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(DIRECTIONS[direction]) @ np.diag(spacing)
    matrix[:3, 3] = center - matrix[:3, :3] @ ((np.array(size) - 1) / 2.0)
    shape, layers = size[::-1], []
    for each in [surface] if isinstance(surface, BSplineSurface) else surface:
        mesh = triangulate(each if motion is None else each.transformed(motion), chord_error=0.02)
        outside = volume_fractions(mesh.points + 6.0 * mesh.normals, mesh.triangles, shape, matrix)
        inside = volume_fractions(mesh.points, mesh.triangles, shape, matrix)
        layers += [(outside, wall), (inside, inner)]
    grey = paint(np.full(shape, around), layers)
    return Image(np.rint(grey + np.random.default_rng(seed).normal(0.0, noise, shape)).astype(np.int16), matrix)
