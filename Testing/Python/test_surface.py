"""A B-spline surface: points, derivatives, normals, closedness, exact refinement, volume and area."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import interpolate

from VICRegistrationLib.geometry import bspline, models
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.triangulation import triangulate


@pytest.fixture
def organ():
    """A lopsided organ of about 60 mm away from the origin."""
    parametrization = closed_organ(models.closed_organ(axes=30.0 * np.eye(3), center=(40.0, -25.0, 110.0)))
    return parametrization.deform(np.random.default_rng(2).normal(scale=1.5, size=parametrization.n_dof))


@pytest.fixture
def patch():
    """An open patch of unequal degrees on unclamped, non-uniform knots."""
    knots_u = np.array([0.0, 0.2, 0.5, 0.9, 1.4, 2.0, 2.2])
    knots_v = np.array([-1.0, -1, -1, -1, 0.2, 0.9, 3, 3, 3, 3])
    net = np.random.default_rng(3).normal(size=(4, 6, 3))
    return BSplineSurface((2, 3), knots_u, knots_v, net)


def random_parameters(surface, number=200, seed=0, margin=0.0):
    generator = np.random.default_rng(seed)
    return [
        generator.uniform(low + margin * (high - low), high - margin * (high - low), number)
        for low, high in surface.domain
    ]


def prism(corners, heights):
    """Closed degree-1 surface: a polygon (n, 2) swept between two heights, with a pole in either cap."""
    ring = np.vstack([corners, corners[:1]])
    bottom, top = (np.column_stack([ring, np.full(len(ring), height)]) for height in heights)
    middle = ring.mean(axis=0)
    poles = [np.tile([*middle, height], (len(ring), 1)) for height in heights]
    net = np.stack([poles[0], bottom, top, poles[1]], axis=1)
    return BSplineSurface((1, 1), bspline.uniform_clamped_knots(1, len(ring)), bspline.uniform_clamped_knots(1, 4), net)


@pytest.fixture
def box():
    """A box of 2 x 3 x 5 mm."""
    return prism(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0], [0.0, 3.0]]), (0.0, 5.0))


# ------------------------------------------------------------------ points and derivatives


@pytest.mark.parametrize(("du", "dv"), [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)])
def test_points_and_derivatives_are_the_tensor_product(patch, du, dv):
    u, v = random_parameters(patch)
    along_u = interpolate.BSpline(patch.knots_u.copy(), patch.control_net.copy(), patch.degrees[0])(u, nu=du)
    expected = [
        interpolate.BSpline(patch.knots_v.copy(), row, patch.degrees[1])(y, nu=dv) for row, y in zip(along_u, v)
    ]
    # Second derivatives over spans of 0.2 are about 100 times the coordinates.
    np.testing.assert_allclose(patch.points(u, v, du=du, dv=dv), expected, atol=1e-11)


@pytest.mark.parametrize(("du", "dv"), [(0, 0), (1, 0), (1, 1), (0, 2)])
def test_the_grid_holds_the_points_of_all_pairs(patch, du, dv):
    u, v = np.linspace(*patch.domain[0], 5), np.linspace(*patch.domain[1], 7)
    grid = patch.grid(u, v, du=du, dv=dv)
    pairs = patch.points(np.repeat(u, 7), np.tile(v, 5), du=du, dv=dv)
    np.testing.assert_allclose(grid.reshape(-1, 3), pairs, atol=1e-12 * np.abs(pairs).max())


def test_moving_the_control_net_moves_the_surface(organ):
    matrix = np.eye(4)
    matrix[:3] = [[0.0, -1.2, 0.1, 5.0], [1.0, 0.0, 0.0, -7.0], [0.3, 0.0, 0.8, 2.0]]
    u, v = random_parameters(organ)
    expected = organ.points(u, v) @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(organ.transformed(matrix).points(u, v), expected, atol=1e-12)


def test_the_arrays_of_a_surface_cannot_be_changed(organ):
    with pytest.raises(ValueError, match="read-only"):
        organ.control_net[0, 0, 0] = 1.0


def test_the_arrays_a_surface_was_made_from_stay_free():
    net = np.zeros((2, 2, 3))
    net[1, :, 0] = net[:, 1, 1] = 1.0
    surface = BSplineSurface((1, 1), [0, 0, 1, 1], [0, 0, 1, 1], net)
    net[0, 0, 0] = 9.0
    assert surface.control_net[0, 0, 0] == 0.0


# ------------------------------------------------------------------ normals


def test_normals_are_unit_and_perpendicular_to_both_tangents(organ):
    u, v = random_parameters(organ, margin=0.01)
    normals = organ.normals(u, v)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-14)
    for order in ({"du": 1}, {"dv": 1}):
        tangents = organ.points(u, v, **order)
        cosines = np.einsum("nk,nk->n", normals, tangents) / np.linalg.norm(tangents, axis=1)
        assert np.abs(cosines).max() < 1e-13


@pytest.mark.parametrize("end", [0, 1])
def test_the_normal_at_a_pole_is_the_limit_of_the_normals_around_it(organ, end):
    u = np.linspace(0.0, 1.0, 33)
    at_pole = organ.normals(u, np.full(33, float(end)))
    # The smooth closure has one tangent plane at a pole; 1e-12 is rounding in the small products.
    np.testing.assert_allclose(at_pole, np.tile(at_pole[0], (33, 1)), atol=1e-12)
    for distance in (1e-3, 1e-5, 1e-7, 1e-9):
        near = organ.normals(u, np.full(33, abs(end - distance)))
        # The normal turns by some tens of radians per unit of v there; the rest is rounding.
        assert np.abs(near - at_pole).max() < 100.0 * distance + 1e-7


def test_normals_of_a_flat_patch_do_not_depend_on_the_place():
    net = np.stack([*np.meshgrid(np.arange(4.0), np.arange(5.0), indexing="ij"), np.zeros((4, 5))], axis=-1)
    flat = BSplineSurface((2, 3), bspline.uniform_clamped_knots(2, 4), bspline.uniform_clamped_knots(3, 5), net)
    u, v = random_parameters(flat)
    np.testing.assert_allclose(flat.normals(u, v), np.tile([0.0, 0.0, 1.0], (200, 1)), atol=1e-14)


# ------------------------------------------------------------------ closedness


def test_a_closed_organ_has_a_seam_and_two_poles(organ):
    assert organ.closed_u
    assert organ.poles == (True, True)
    assert organ.closed
    assert not organ.closed_v


def test_the_bell_has_a_seam_and_one_pole():
    bell = models.bell()
    assert bell.closed_u
    assert bell.poles == (False, True)
    assert not bell.closed


def test_a_torus_is_closed_by_two_seams():
    torus = make_torus()
    assert torus.closed_u
    assert torus.closed_v
    assert torus.closed
    # Pappus: the tube's area times the way of its centre. Splines of 24 spans follow a circle to about 1e-5.
    assert torus.volume() == pytest.approx(2.0 * np.pi**2 * 10.0 * 3.0**2, rel=1e-4)


def make_torus():
    knots, around = bspline.periodic_to_clamped(3, np.linspace(0.0, 1.0, 25))
    # The control polygon of the cubic closest to a circle lies outside of it by this factor (uniform knots).
    factor = 3.0 / (2.0 + np.cos(2.0 * np.pi / 24.0))
    angle = 2.0 * np.pi * np.arange(24) / 24.0
    circle = around @ np.column_stack([np.cos(angle), np.sin(angle)]) * factor
    radius = 10.0 + 3.0 * circle[:, 0]
    net = np.stack(
        [
            circle[:, None, 0] * radius,
            circle[:, None, 1] * radius,
            np.broadcast_to(3.0 * circle[:, 1], (len(circle), len(circle))),
        ],
        axis=-1,
    )
    return BSplineSurface((3, 3), knots, knots, net)


def test_an_open_patch_is_open(patch):
    assert not patch.closed_u
    assert not patch.closed_v
    assert patch.poles == (False, False)


# ------------------------------------------------------------------ knot insertion


def test_knot_insertion_and_halving_leave_the_surface_as_it_is(patch):
    u, v = random_parameters(patch)
    inserted = patch.insert_knots(u=[0.6, 1.0, 1.0], v=[0.2, 0.2, 2.5])
    assert inserted.control_net.shape == (7, 9, 3)
    np.testing.assert_allclose(inserted.points(u, v), patch.points(u, v), atol=1e-13)
    np.testing.assert_allclose(patch.refined().points(u, v), patch.points(u, v), atol=1e-13)
    assert patch.refined().control_net.shape == (6, 9, 3)


def test_a_refined_organ_keeps_its_seam_and_poles(organ):
    refined = organ.refined().refined()
    assert refined.closed
    assert refined.volume() == pytest.approx(organ.volume(), rel=1e-13)


# ------------------------------------------------------------------ volume and area


def test_volume_and_area_of_a_box_are_exact(box):
    assert box.volume() == pytest.approx(30.0, rel=1e-14)
    assert box.area() == pytest.approx(2.0 * (6.0 + 10.0 + 15.0), rel=1e-12)


def test_volume_follows_the_determinant_of_an_affine_map(organ):
    matrix = np.eye(4)
    matrix[:3, :3] = [[1.1, 0.3, 0.0], [-0.2, 0.9, 0.4], [0.0, 0.1, 1.3]]
    determinant = np.linalg.det(matrix[:3, :3])
    assert organ.transformed(matrix).volume() == pytest.approx(determinant * organ.volume(), rel=1e-13)


def test_volume_keeps_its_digits_far_from_the_origin(box):
    far = np.eye(4)
    far[:3, 3] = [1e6, -3e6, 2e6]
    # The coordinates themselves are rounded at 5e-10 mm there.
    assert box.transformed(far).volume() == pytest.approx(30.0, abs=1e-7)


def test_turned_it_is_the_same_surface_with_its_normals_on_the_other_side(organ):
    turned = organ.turned()
    u, v = np.array([0.1, 0.45, 0.8]), np.array([0.3, 0.5, 0.9])
    np.testing.assert_allclose(turned.points(1.0 - u, v), organ.points(u, v), atol=1e-12)
    np.testing.assert_allclose(turned.normals(1.0 - u, v), -organ.normals(u, v), atol=1e-12)
    assert turned.volume() == pytest.approx(-organ.volume(), rel=1e-12)
    assert turned.closed


def test_volume_and_area_are_the_limits_of_fine_triangulations(organ):
    volumes, areas = [], []
    for n in (48, 96, 192):
        mesh = triangulate(organ, resolution=(n, n))
        a, b, c = (mesh.points[mesh.triangles[:, k]] - mesh.points[0] for k in range(3))
        cross = np.cross(b - a, c - a)
        volumes.append(np.einsum("nk,nk->", a, cross) / 6.0)
        areas.append(np.linalg.norm(cross, axis=1).sum() / 2.0)
    # The error of triangles falls with the square of their size; Richardson's extrapolation removes it.
    volume = (4.0 * volumes[2] - volumes[1]) / 3.0
    area = (4.0 * areas[2] - areas[1]) / 3.0
    assert abs(volumes[2] - organ.volume()) < abs(volumes[1] - organ.volume()) / 3.5
    assert organ.volume() == pytest.approx(volume, rel=1e-6)
    assert organ.area() == pytest.approx(area, rel=1e-6)


def test_area_of_a_plane_patch_does_not_depend_on_its_parametrization():
    u, v = np.array([0.0, 0.1, 0.7, 1.0]), np.array([0.0, 0.5, 0.6, 2.0])
    net = np.stack([*np.meshgrid(u, v, indexing="ij"), np.zeros((4, 4))], axis=-1)
    knots = bspline.uniform_clamped_knots(3, 4)
    assert BSplineSurface((3, 3), knots, knots, net).area() == pytest.approx(2.0, rel=1e-12)


def test_an_open_surface_has_no_volume():
    with pytest.raises(ValueError, match="The surface is open; a volume needs a closed surface"):
        models.bell().volume()


# ------------------------------------------------------------------ refusals


def test_a_net_that_does_not_fit_its_knots_is_refused():
    with pytest.raises(ValueError, match=r"shape \(2, 3, 3\) was given; the degrees and knots need \(2, 2, 3\)"):
        BSplineSurface((1, 1), [0, 0, 1, 1], [0, 0, 1, 1], np.zeros((2, 3, 3)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_control_points_that_are_not_finite_are_refused(bad):
    net = np.zeros((2, 2, 3))
    net[1, 1, 1] = bad
    with pytest.raises(ValueError, match="points that are not finite; give coordinates in mm"):
        BSplineSurface((1, 1), [0, 0, 1, 1], [0, 0, 1, 1], net)


def test_parameters_outside_the_surface_are_refused(organ):
    with pytest.raises(ValueError, match="the surface is defined on 0 to 1"):
        organ.points([0.5], [1.01])
    with pytest.raises(ValueError, match="the surface is defined on 0 to 1"):
        organ.grid([-0.01], [0.5])
