"""Deviation of a fitted surface from the true one."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.analysis.reference_meshes import ReferenceMesh, mesh_of_mask
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.imaging.image import Image


def ball(radius, center=(1.0, 2.0, 3.0), net=(9, 7)):
    return closed_organ(net, axes=radius * np.eye(3), center=center)


def test_a_surface_does_not_deviate_from_itself():
    surface = closed_organ(axes=np.diag([20.0, 25.0, 40.0]))
    found = deviation(surface, surface, n_points=500)
    # Newton's iteration for the closest point ends within rounding.
    assert found.maximum < 1e-8
    assert found.n == 500


@pytest.mark.parametrize(("radius", "sign"), [(31.0, 1.0), (29.0, -1.0)])
def test_the_sign_is_positive_where_the_fitted_surface_lies_outside(radius, sign):
    found = deviation(ball(radius), ball(30.0), n_points=500)
    # The closest 9 x 7 net misses the ball by some 0.001 of its radius.
    assert found.mean_signed == pytest.approx(sign, abs=0.04)
    assert found.mean == pytest.approx(1.0, abs=0.04)
    assert found.mean <= found.rms <= found.p95 <= found.maximum


def test_a_shift_gives_the_deviations_of_a_shift():
    net = (17, 13)
    found = deviation(ball(30.0, (0.3, 0.0, 0.0), net), ball(30.0, (0.0, 0.0, 0.0), net))
    # Along the normal, a shift d of a ball is d cos(theta): mean of the size d/2, root of the mean square d/sqrt(3).
    # The standard error of 10,000 points is 1 %.
    assert found.mean == pytest.approx(0.15, rel=0.03)
    assert found.rms == pytest.approx(0.3 / np.sqrt(3.0), rel=0.03)
    assert abs(found.mean_signed) < 0.006


def test_points_are_spread_evenly_over_the_area():
    surface = closed_organ(axes=np.diag([10.0, 20.0, 60.0]))
    mesh = triangulate(surface, chord_error=0.02)
    for reference in (surface, mesh):
        heights = np.sort(points_on(reference, 20_000)[:, 2])
        corners = mesh.points[mesh.triangles]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        middles = corners[:, :, 2].mean(axis=1)
        for level in (-40.0, 0.0, 40.0):
            share = areas[middles < level].sum() / areas.sum()
            # Standard error of a share of 20,000 points: 0.0035; a triangle's width adds 0.002.
            assert np.mean(heights < level) == pytest.approx(share, abs=0.012)


def test_points_are_the_same_each_time():
    surface = ball(20.0)
    np.testing.assert_array_equal(points_on(surface, 50), points_on(surface, 50))


@pytest.mark.parametrize("handedness", [1.0, -1.0])
def test_the_mesh_of_a_mask_lies_on_the_organ_and_points_outward(handedness):
    angle = np.deg2rad(20.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ np.diag([handedness, 1.2, 2.0])
    shape = (30, 50, 60)
    matrix[:3, 3] = [1.0, 2.0, 3.0] - matrix[:3, :3] @ ((np.array(shape[::-1]) - 1) / 2.0)
    grid = Image(np.zeros(shape), matrix)
    k, j, i = np.indices(shape).reshape(3, -1)
    depth = 20.0 - np.linalg.norm(grid.to_ras(np.column_stack([i, j, k])) - [1.0, 2.0, 3.0], axis=1)
    mesh = mesh_of_mask(Image((np.clip(depth, -1.0, 1.0) / 2.0 + 0.5).reshape(shape), matrix))
    found = deviation(ball(20.0), mesh, n_points=2000)
    # Linear interpolation in voxels of 2 mm on a radius of 20 mm; the net's own error is 0.02 mm.
    assert abs(found.mean_signed) < 0.1
    assert found.maximum < 0.5
    corners = mesh.points[mesh.triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.einsum("nk,nk->", outward, corners.mean(axis=1) - [1.0, 2.0, 3.0]) > 0


def test_an_organ_at_the_border_gets_a_closed_mesh():
    mesh = mesh_of_mask(Image(np.ones((4, 5, 6), dtype=bool), np.eye(4)))
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 2).all()
    np.testing.assert_allclose(mesh.points.min(axis=0), -0.5)
    np.testing.assert_allclose(mesh.points.max(axis=0), [5.5, 4.5, 3.5])


def test_what_cannot_be_measured_is_refused():
    with pytest.raises(ValueError, match="0 points were asked for; give at least one"):
        deviation(ball(20.0), ball(20.0), n_points=0)
    with pytest.raises(ValueError, match=r"No voxel of the mask is above 0\.5"):
        mesh_of_mask(Image(np.zeros((3, 3, 3)), np.eye(4)))
    with pytest.raises(ValueError, match="The reference has no area"):
        points_on(ReferenceMesh(np.zeros((3, 3)), np.array([[0, 1, 2]])), 5)
