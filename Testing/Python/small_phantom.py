"""A small image of one bright organ, cheap enough to be fitted in a test."""

from __future__ import annotations

import numpy as np

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.phantoms.painting import paint

CENTER = np.array([-12.0, 8.0, -20.0])
SEED = "-12,8,-20"


def ellipsoid():
    """Semi-axes 14, 18 and 22 mm, a right-handed triple along R, A and S."""
    return closed_organ(axes=np.diag([14.0, 18.0, 22.0]), center=CENTER)


def ellipsoid_image(*, level: float = 800.0, wall: float = 100.0) -> Image:
    """Sagittal slices of 3 mm, pixels of 1.2 mm: a wall of 6 mm in a grey surrounding, on a left-handed grid."""
    shape = (22, 56, 52)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ np.diag([1.2, 1.2, 3.0])
    matrix[:3, 3] = CENTER - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    mesh = triangulate(ellipsoid(), chord_error=0.1)
    outer = volume_fractions(mesh.points + 6.0 * mesh.normals, mesh.triangles, shape, matrix)
    inner = volume_fractions(mesh.points, mesh.triangles, shape, matrix)
    grey = paint(np.full(shape, 400.0), [(outer, wall), (inner, level)])
    noise = np.random.default_rng(1).normal(0.0, 10.0, shape)
    return Image(np.rint(grey + noise).astype(np.int16), matrix)
