"""Jacobians, volumes and the quality report of tetrahedra."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_tetrahedra import SIDE, cube

from VICRegistrationLib.meshing.elements import NODES, faces_of, poor_element, scaled_jacobians, volumes
from VICRegistrationLib.meshing.quality import quality
from VICRegistrationLib.meshing.regions import MeshOptions

REGULAR = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
ONE = np.array([[0, 1, 2, 3]])
TEN = np.arange(10)[None]


def with_middles(corners):
    barycentric = np.column_stack([1.0 - NODES.sum(axis=1), NODES])
    return barycentric @ corners


def test_a_regular_tetrahedron_has_scaled_jacobian_one():
    assert scaled_jacobians(REGULAR, ONE) == pytest.approx([1.0])
    assert scaled_jacobians(with_middles(REGULAR), TEN) == pytest.approx([1.0])


def test_a_flat_one_has_zero_and_an_inverted_one_less():
    flat = REGULAR * [1.0, 1.0, 0.0]
    assert scaled_jacobians(flat, ONE) == pytest.approx([0.0], abs=1e-15)
    assert scaled_jacobians(REGULAR, ONE[:, [1, 0, 2, 3]])[0] < 0.0
    assert volumes(REGULAR, ONE[:, [1, 0, 2, 3]])[0] < 0.0


def test_the_worst_element_is_returned_if_it_is_poor():
    flat = REGULAR * [1.0, 1.0, 0.1] + [10.0, 20.0, 30.0]
    points, elements = np.concatenate([REGULAR, flat]), np.concatenate([ONE, ONE + 4])
    worst = float(scaled_jacobians(points, elements)[1])
    found = poor_element(points, elements, 0.5)
    assert found == pytest.approx({"r": 10.0, "a": 20.0, "s": 30.0, "jacobian": worst, "good": 0.5})
    assert poor_element(points, elements, worst) == poor_element(REGULAR, ONE, 0.5) == {}


def test_a_middle_pulled_through_the_opposite_side_inverts_the_element():
    points = with_middles(REGULAR)
    points[4] += 2.0 * (points[3] - points[4])
    assert scaled_jacobians(points, TEN)[0] < 0.0


def test_the_volume_of_a_curved_element_is_exact():
    # x' = x + y^2 / 8 keeps volumes; it is quadratic, so that ten nodes hold it exactly.
    straight = with_middles(REGULAR)
    curved = straight + np.column_stack([straight[:, 1] ** 2 / 8.0, np.zeros((10, 2))])
    assert volumes(curved, TEN)[0] == pytest.approx(volumes(REGULAR, ONE)[0], rel=1e-13)
    # x' = x + x^2 / 8: the integral of 1 + x / 4, and x is 0 on average.
    stretched = straight + np.column_stack([straight[:, 0] ** 2 / 8.0, np.zeros((10, 2))])
    assert volumes(stretched, TEN)[0] == pytest.approx(volumes(REGULAR, ONE)[0], rel=1e-13)


def test_every_inner_face_has_two_owners():
    mesh = cube()
    faces, first, second = faces_of(mesh.tetrahedra)
    # A cube of 4 x 4 x 4 cells: 6 sides of 16 squares, two triangles each.
    assert np.count_nonzero(second < 0) == 192
    assert len(faces) * 2 - 192 == 4 * len(mesh.tetrahedra)
    corners = mesh.points[faces[second < 0]]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("nk,nk->n", outward, corners[:, 0] - mesh.points.mean(axis=0)) > 0.0).all()
    assert len(np.unique(first)) <= len(mesh.tetrahedra)


@pytest.mark.parametrize("order", [1, 2])
def test_the_report_counts_and_measures(order):
    report = quality(cube(order=order))
    assert (report.tetrahedra, report.order, report.inverted) == (384, order, 0)
    assert report.nodes == (125 if order == 1 else 9**3)
    # Of each sixth of a cube: sqrt(2) / (1 sqrt(2) sqrt(3)).
    assert report.scaled_jacobian_min == pytest.approx(1.0 / np.sqrt(3.0))
    assert report.scaled_jacobian_mean == pytest.approx(1.0 / np.sqrt(3.0))
    assert report.volume == pytest.approx(SIDE**3)
    assert report.volume_ratio == pytest.approx(1.0)
    assert report.groups["left"]["volume_ratio"] == pytest.approx(1.0)
    assert report.surfaces["left_surface"]["area"] == pytest.approx(3.0 * SIDE**2)
    assert report.surfaces["left_right_interface"]["area"] == pytest.approx(SIDE**2)
    assert any("0 inverted" in line for line in report.lines())
    assert json.loads(json.dumps(report.as_json(), allow_nan=False))["tetrahedra"] == 384


def test_areas_of_curved_faces_follow_the_curve():
    mesh = cube(order=2)
    straight = quality(mesh).surfaces["left_surface"]["area"]
    face = mesh.triangles[mesh.triangle_groups["left_surface"][0]]
    corners = mesh.points[face[:3]]
    mesh.points[face[3]] += 0.1 * np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert quality(mesh).surfaces["left_surface"]["area"] > straight


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"size": 0.0}, "size of the elements of 0 mm"),
        ({"size": float("nan")}, "size of the elements of nan mm"),
        ({"order": 3}, "order 3"),
        ({"patches": (0, 2)}, "whole numbers from 1 to 32"),
        ({"wall": -1.0}, "thickness of the wall of -1 mm"),
        ({"time_limit": 0.0}, "time limit of 0 s"),
        ({"volume_error": 0.0}, "volume error of 0"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, told):
    with pytest.raises(ValueError, match=told):
        MeshOptions(**options)


def test_the_volume_error_goes_with_the_square_of_the_size():
    assert MeshOptions(size=3.0).volume_error == pytest.approx(0.005)
    assert MeshOptions(size=1.5).volume_error == pytest.approx(0.00125)
    assert MeshOptions(size=30.0).volume_error == 0.02
