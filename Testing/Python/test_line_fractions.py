"""Partial volumes by lines through voxels: exact along them, watertight, beyond the image, either sense."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.line_fractions import line_fractions
from VICRegistrationLib.geometry.triangles import enclosed_volume
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.geometry.volume_fractions import volume_fractions

ORGAN = triangulate(models.closed_organ((17, 11), axes=np.diag([6.0, 9.0, 14.0]), center=(1.0, 2.0, 3.0)))
TURNED = np.linalg.qr(np.array([[2.0, 0.2, 0.3], [-0.1, 2.0, 0.4], [0.2, -0.3, 2.0]]))[0]
FACES = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4]]
    + [[1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
)


def box(low, high):
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
    return np.where(np.array(corners) == 1, high, low).astype(float), FACES


@pytest.mark.parametrize("spacing", [(0.7, 0.9, 4.0), (4.0, 0.8, 0.9), (0.9, 3.0, 0.8), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("turn", [np.eye(3), TURNED, TURNED @ np.diag([1.0, -1.0, 1.0])])
def test_shares_are_those_of_many_points_in_each_voxel(spacing, turn):
    matrix = np.eye(4)
    matrix[:3, :3] = turn * spacing
    shape = tuple(int(n) for n in np.ceil(44.0 / np.asarray(spacing))[::-1])
    matrix[:3, 3] = [1.0, 2.0, 3.0] - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1.0) / 2.0 + [0.2, 0.1, 0.3])
    shares = line_fractions(ORGAN.points, ORGAN.triangles, shape, matrix, lines=8)
    parts = tuple(np.rint(8.0 * np.asarray(spacing) / min(spacing)).astype(int)[::-1])
    expected = volume_fractions(ORGAN.points, ORGAN.triangles, shape, matrix, supersampling=parts)
    assert shares.dtype == np.float32
    # The points' steps are an eighth of a pixel and finer.
    np.testing.assert_allclose(shares, expected, atol=0.06)
    volume = shares.sum(dtype=float) * np.prod(spacing)
    np.testing.assert_allclose(volume, enclosed_volume(ORGAN.points, ORGAN.triangles), rtol=1e-3)


def test_corners_and_edges_on_lines_leave_no_gap():
    # With lines at whole numbers and halves, faces, edges and corners of this box lie on them.
    points, triangles = box((2.25, 1.75, 1.25), (5.75, 6.25, 7.75))
    shares = line_fractions(points, triangles, (10, 9, 8), np.eye(4))
    assert shares[3:7, 3:6, 3:5].min() == shares.max() == 1.0
    assert not shares[[0, 9]].any()
    assert not shares[:, [0, 8]].any()
    assert not shares[:, :, [0, 1, 7]].any()
    assert shares.sum() == pytest.approx(3.5 * 4.5 * 6.5)


def test_a_face_inside_voxels_gives_the_part_that_is_covered_along_the_lines():
    points, triangles = box((1.5, 1.5, 1.6), (4.5, 5.5, 7.3))
    shares = line_fractions(points, triangles, (10, 8, 8), np.diag([1.0, 1.0, 2.0, 1.0]))
    np.testing.assert_allclose(shares[:5, 3, 3], [0.0, 0.7, 1.0, 1.0, 0.15], atol=1e-6)


@pytest.mark.parametrize("triangles", [FACES, FACES[:, ::-1]])
def test_what_lies_beyond_the_image_is_cut_off_in_either_sense(triangles):
    points, _ = box((-9.0, -9.0, -9.0), (3.5, 4.5, 40.0))
    for along in range(3):
        # The lines run along each of the axes.
        stretch = np.where(np.arange(3) == along, 1.01, 1.0)
        shares = line_fractions(points * stretch, triangles, (6, 8, 9), np.diag([*stretch, 1.0]))
        expected = np.zeros((6, 8, 9))
        expected[:, :5, :4] = 1.0
        np.testing.assert_allclose(shares, expected, atol=1e-6)


def test_a_surface_beside_the_image_leaves_it_empty():
    points, triangles = box((90.0, 1.0, 1.0), (95.0, 4.0, 4.0))
    assert not line_fractions(points, triangles, (5, 5, 5), np.eye(4)).any()
