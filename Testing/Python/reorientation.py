"""The same organ elsewhere: turned and shifted in the world, or with other axes in memory."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from VICRegistrationLib.imaging.image import Image

_FLIPS = list(itertools.product((False, True), repeat=3))
# Orders and flips of three axes: each order with two of the eight ways to flip, all of which are seen, and both hands.
ORIENTATIONS = [
    (order, flips)
    for number, order in enumerate(itertools.permutations(range(3)))
    for flips in (_FLIPS[number], _FLIPS[7 - number])
]


def motion(degrees, axis, shift=(0.0, 0.0, 0.0)):
    """Matrix of a rotation about an axis through the origin and a shift in mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    matrix[:3, 3] = shift
    return matrix


def reordered(image, order, flips):
    """The same voxels in the same places of the world, with axes (i, j, k) permuted and flipped in memory."""
    array = image.array.transpose([2 - axis for axis in order[::-1]])
    matrix = image.ijk_to_ras.copy()
    matrix[:3, :3] = image.ijk_to_ras[:3, list(order)]
    for axis, flip in enumerate(flips):
        if flip:
            array = np.flip(array, 2 - axis)
            matrix[:3, 3] += matrix[:3, axis] * (array.shape[2 - axis] - 1)
            matrix[:3, axis] *= -1.0
    return Image(np.ascontiguousarray(array), matrix)
