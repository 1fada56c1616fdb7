"""Closest points of a surface: exact, signed, and found from anywhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.geometry.projection import closest_points


def wobbly(net=(9, 7), *, degrees=(3, 3), closure="smooth", scale=1.2, center=(10.0, -20.0, 30.0)):
    """A lopsided organ of about 60 mm."""
    surface = models.closed_organ(net, degrees=degrees, closure=closure, axes=30.0 * np.eye(3), center=center)
    parametrization = closed_organ(surface, closure=closure)
    return parametrization.deform(np.random.default_rng(6).normal(scale=scale, size=parametrization.n_dof))


SURFACES = {
    "9x7": wobbly(),
    "paper": wobbly(closure="paper"),
    "17x13": wobbly((17, 13), scale=0.5),
    "quadratic": wobbly(degrees=(2, 2)),
    "quintic": wobbly((9, 9), degrees=(5, 5)),
    "ellipsoid": models.closed_organ(axes=np.diag([20.0, 25.0, 35.0])),
    "bell": models.bell(60.0, center=(3.0, 4.0, 5.0)),
    "far away": wobbly(center=(1000.0, 2000.0, -3000.0)),
}


@pytest.fixture(params=SURFACES, ids=lambda name: name.replace(" ", "-"))
def surface(request):
    return SURFACES[request.param]


def known_feet(surface, number=400, seed=0):
    """Random places of a surface, some on its seam and its poles or rim: parameters, points, normals."""
    generator = np.random.default_rng(seed)
    u, v = (generator.uniform(low, high, number) for low, high in surface.domain)
    u[:50], v[50:70], v[70:90] = surface.domain[0][0], *surface.domain[1]
    return np.column_stack([u, v]), surface.points(u, v), surface.normals(u, v)


@pytest.mark.parametrize("offset", [2.0, -2.0])
def test_points_on_a_normal_find_their_foot_and_signed_distance(surface, offset):
    _, feet, normals = known_feet(surface)
    result = closest_points(surface, feet + offset * normals)
    # 1e-9 mm is what a caller may rely on; coordinates of 1000 mm alone are rounded at 1e-13.
    np.testing.assert_allclose(result.distances, offset, atol=1e-9)
    # A foot is as sharp as its minimum: across the distance it is good to the tolerance of the iteration.
    np.testing.assert_allclose(result.points, feet, atol=1e-7)


def test_points_of_the_surface_have_no_distance(surface):
    _, feet, _ = known_feet(surface)
    assert np.abs(closest_points(surface, feet).distances).max() < 1e-9


def test_parameters_and_points_belong_together(surface):
    _, feet, normals = known_feet(surface, 300)
    result = closest_points(surface, feet + normals)
    np.testing.assert_array_equal(surface.points(*result.parameters.T), result.points)
    for axis, (low, high) in enumerate(surface.domain):
        assert result.parameters[:, axis].min() >= low
        assert result.parameters[:, axis].max() <= high


def test_no_dense_sampling_finds_a_closer_point(surface):
    net = surface.control_net.reshape(-1, 3)
    points = np.random.default_rng(1).uniform(net.min(axis=0) - 15.0, net.max(axis=0) + 15.0, (400, 3))
    samples = surface.grid(*(np.linspace(*limits, 201) for limits in surface.domain)).reshape(-1, 3)
    sampled, _ = cKDTree(samples).query(points)
    assert (np.abs(closest_points(surface, points).distances) - sampled).max() < 1e-9


def test_the_line_to_a_foot_is_perpendicular_to_a_closed_surface():
    organ = SURFACES["9x7"]
    points = np.random.default_rng(2).uniform(-25.0, 25.0, (500, 3)) + [10.0, -20.0, 30.0]
    result = closest_points(organ, points)
    offsets = points - result.points
    for order in ({"du": 1}, {"dv": 1}):
        tangents = organ.points(*result.parameters.T, **order)
        length = np.linalg.norm(tangents, axis=1)
        usable = length > 1e-6
        cosines = np.einsum("nk,nk->n", offsets[usable], tangents[usable]) / length[usable]
        assert np.abs(cosines).max() < 1e-7


def test_points_inside_are_negative_and_points_outside_positive():
    organ = SURFACES["9x7"]
    center = organ.control_net.mean(axis=(0, 1))
    directions = np.random.default_rng(3).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert closest_points(organ, center + 5.0 * directions).distances.max() < 0.0
    assert closest_points(organ, center + 80.0 * directions).distances.min() > 0.0


def test_the_centre_of_a_sphere_is_one_radius_inside():
    sphere = models.closed_organ((33, 25), axes=20.0 * np.eye(3))
    result = closest_points(sphere, np.zeros((1, 3)))
    grid = sphere.grid(np.linspace(0.0, 1.0, 200), np.linspace(0.0, 1.0, 200))
    assert result.distances[0] == pytest.approx(-np.linalg.norm(grid, axis=2).min(), abs=1e-4)


def test_points_in_the_middle_of_a_flat_organ_find_the_nearer_wall():
    organ = models.closed_organ(axes=np.diag([39.0, 6.5, 14.0]))
    points = np.array([[0.0, 0.4, 0.0], [0.0, -0.4, 0.0], [10.0, 0.3, 2.0], [10.0, -0.3, 2.0]])
    result = closest_points(organ, points)
    np.testing.assert_array_equal(np.sign(result.points[:, 1]), [1, -1, 1, -1])
    assert result.distances.max() < 0.0


def test_the_sign_over_a_pole_is_that_of_its_tangent_plane():
    organ = SURFACES["ellipsoid"]
    for v in (0.0, 1.0):
        pole, normal = organ.points([0.0], [v]), organ.normals([0.0], [v])
        result = closest_points(organ, np.vstack([pole + 3.0 * normal, pole - 3.0 * normal]))
        np.testing.assert_allclose(result.distances, [3.0, -3.0], atol=1e-9)
        np.testing.assert_allclose(result.points, np.vstack([pole, pole]), atol=1e-6)


def test_points_below_an_open_surface_are_projected_to_its_rim():
    bell = SURFACES["bell"]
    points = np.column_stack([np.linspace(-40.0, 40.0, 60), np.linspace(-30.0, 50.0, 60), np.full(60, -80.0)])
    result = closest_points(bell, points)
    outside = np.linalg.norm(points[:, :2] - [3.0, 4.0], axis=1) > 10.0
    np.testing.assert_array_equal(result.parameters[outside, 1], 0.0)
    rim = bell.grid(np.linspace(0.0, 1.0, 2001), [0.0])[:, 0]
    sampled, _ = cKDTree(rim).query(points)
    # A rim sampled every 0.1 mm is off by less than the square of that over twice the distance.
    np.testing.assert_allclose(np.abs(result.distances), sampled, atol=1e-3)


def test_the_result_moves_with_the_surface():
    organ = SURFACES["9x7"]
    matrix = np.eye(4)
    matrix[:3, :3] = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
    matrix[:3, 3] = [5.0, 6.0, 7.0]
    _, feet, normals = known_feet(organ, 300)
    points = feet + 1.5 * normals
    before = closest_points(organ, points)
    after = closest_points(organ.transformed(matrix), points @ matrix[:3, :3].T + matrix[:3, 3])
    np.testing.assert_allclose(after.distances, before.distances, atol=1e-9)
    np.testing.assert_allclose(after.points, before.points @ matrix[:3, :3].T + matrix[:3, 3], atol=1e-7)


def test_distances_to_a_creased_surface_are_right_within_its_sampling():
    organ = wobbly(degrees=(1, 1))
    points = np.random.default_rng(4).uniform(-40.0, 40.0, (500, 3)) + [10.0, -20.0, 30.0]
    samples = organ.grid(np.linspace(0.0, 1.0, 401), np.linspace(0.0, 1.0, 301)).reshape(-1, 3)
    sampled, _ = cKDTree(samples).query(points)
    # The start grid of 80 x 50 samples has a spacing of about 2.5 mm.
    assert np.abs(np.abs(closest_points(organ, points).distances) - sampled).max() < 0.5


def test_no_points_give_no_feet():
    result = closest_points(SURFACES["9x7"], np.zeros((0, 3)))
    assert result.parameters.shape == (0, 2)
    assert result.points.shape == (0, 3)
    assert result.distances.shape == (0,)


@pytest.mark.parametrize("points", [np.zeros(3), np.zeros((4, 2)), [[0.0, np.nan, 0.0]], [[np.inf, 0.0, 0.0]]])
def test_points_that_are_not_places_are_refused(points):
    with pytest.raises(ValueError, match=r"\(n, 3\) finite RAS coordinates in mm are needed"):
        closest_points(SURFACES["9x7"], points)


def test_a_surface_finds_its_own_closest_points():
    surface = models.closed_organ(axes=20.0 * np.eye(3))
    points = np.array([[30.0, 0.0, 0.0], [0.0, 1.0, 5.0]])
    np.testing.assert_array_equal(surface.closest_points(points).distances, closest_points(surface, points).distances)
