"""Parametrizations: what degrees of freedom may and may not do to a surface."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.geometry import bspline, models
from VICRegistrationLib.geometry.bending import bending_matrix
from VICRegistrationLib.geometry.parametrization import (
    AFFINE_NAMES,
    AFFINE_PRESETS,
    affine,
    affine_matrix,
    closed_organ,
)
from VICRegistrationLib.geometry.surface import BSplineSurface

AXES = np.array([[30.0, 4.0, 0.0], [-3.0, 22.0, 2.0], [0.0, 5.0, 45.0]])


@pytest.fixture(params=["smooth", "paper"])
def closure(request):
    return request.param


def organ_of(closure, net=(9, 7), degrees=(3, 3)):
    return models.closed_organ(net, degrees=degrees, closure=closure, axes=AXES, center=(12.0, -30.0, 80.0))


def random_q(parametrization, scale=5.0, seed=0):
    return np.random.default_rng(seed).normal(scale=scale, size=parametrization.n_dof)


def every_parametrization():
    return {
        "affine": affine(organ_of("smooth")),
        "scaling": affine(organ_of("smooth"), free="scaling"),
        "mixed": affine(organ_of("smooth"), free=("T2", "R01", "R11")),
        "smooth": closed_organ(organ_of("smooth")),
        "paper": closed_organ(organ_of("paper"), closure="paper"),
    }


@pytest.fixture(params=["affine", "scaling", "mixed", "smooth", "paper"])
def parametrization(request):
    return every_parametrization()[request.param]


# ------------------------------------------------------------------ all of them


def test_no_degrees_of_freedom_leave_the_surface_to_the_last_bit(parametrization):
    net = parametrization.control_net(np.zeros(parametrization.n_dof))
    np.testing.assert_array_equal(net, parametrization.surface.control_net)


def test_the_map_is_linear(parametrization):
    start = parametrization.surface.control_net
    one, two = random_q(parametrization, seed=1), random_q(parametrization, seed=2)
    together = parametrization.control_net(2.0 * one - 3.0 * two) - start
    apart = 2.0 * (parametrization.control_net(one) - start) - 3.0 * (parametrization.control_net(two) - start)
    np.testing.assert_allclose(together, apart, atol=1e-13 * np.abs(together).max() * 10)


def test_fit_recovers_the_degrees_of_freedom_of_a_net_it_can_reach(parametrization):
    q = random_q(parametrization)
    # The affine map mixes millimetres and plain numbers; 1e-9 is the rounding of its normal equations.
    np.testing.assert_allclose(parametrization.fit(parametrization.control_net(q)), q, atol=1e-9)


def test_fit_of_another_net_leaves_a_residual_that_no_degree_of_freedom_could_reduce(parametrization):
    generator = np.random.default_rng(4)
    target = parametrization.surface.control_net + generator.normal(size=parametrization.surface.control_net.shape)
    q = parametrization.fit(target)
    residual = (target - parametrization.control_net(q)).reshape(-1, 3)
    gradient = np.zeros(parametrization.n_dof)
    for k in range(3):
        gradient[parametrization.indices[k]] += parametrization.matrices[k].T @ residual[:, k]
    assert np.abs(gradient / parametrization.scales()).max() < 1e-8


def test_scales_are_the_root_mean_square_displacement_of_one_unit(parametrization):
    start = parametrization.surface.control_net
    for k in range(0, parametrization.n_dof, 7):
        unit = np.zeros(parametrization.n_dof)
        unit[k] = 1.0
        moved = parametrization.control_net(unit) - start
        expected = np.sqrt(np.square(moved).sum(axis=2).mean())
        # The difference of coordinates near 100 mm is rounded at 1e-14.
        assert parametrization.scales()[k] == pytest.approx(expected, rel=1e-10)


def test_a_quadratic_form_of_the_control_points_is_carried_to_the_degrees_of_freedom(parametrization):
    form = bending_matrix(parametrization.surface)
    q = random_q(parametrization)
    moved = (parametrization.control_net(q) - parametrization.surface.control_net).reshape(-1, 3)
    expected = np.einsum("nk,nk->", moved, form @ moved)
    matrix = parametrization.quadratic_form(form)
    # An affine map mixes large numbers that cancel where it costs no energy.
    assert q @ (matrix @ q) == pytest.approx(expected, rel=1e-9)


def test_every_degree_of_freedom_moves_something(parametrization):
    assert parametrization.scales().min() > 0.0


def test_deform_keeps_degrees_and_knots(parametrization):
    moved = parametrization.deform(random_q(parametrization))
    assert moved.degrees == parametrization.surface.degrees
    np.testing.assert_array_equal(moved.knots_u, parametrization.surface.knots_u)
    np.testing.assert_array_equal(moved.knots_v, parametrization.surface.knots_v)


# ------------------------------------------------------------------ affine


@pytest.mark.parametrize(
    "free", ["affine", "linear", "scaling", "translation", "R12", ("T1", "R20", "R00"), AFFINE_NAMES[::-1]]
)
def test_affine_is_equation_2_for_any_subset(free):
    surface = organ_of("smooth")
    names = AFFINE_PRESETS.get(free, (free,)) if isinstance(free, str) else free
    center = np.array([3.0, -20.0, 60.0])
    parametrization = affine(surface, free=free, center=center)
    q = np.random.default_rng(3).normal(scale=0.4, size=len(names))
    rotation, shift = np.eye(3), np.zeros(3)
    for name, value in zip(names, q):
        if name.startswith("R"):
            rotation[int(name[1]), int(name[2])] += value
        else:
            shift[int(name[1])] += value
    expected = (surface.control_net - center) @ rotation.T + shift + center
    assert parametrization.n_dof == len(names)
    np.testing.assert_allclose(parametrization.control_net(q), expected, atol=1e-12)
    matrix = affine_matrix(q, free=free, center=center)
    np.testing.assert_allclose(matrix[:3, :3], rotation, atol=1e-15)
    np.testing.assert_allclose(surface.transformed(matrix).control_net, expected, atol=1e-12)


def test_the_local_origin_is_the_mean_of_the_control_points_by_default():
    surface = organ_of("smooth")
    turned = affine(surface, free="scaling").control_net(np.array([1.0, 1.0, 1.0]))
    np.testing.assert_allclose(turned.mean(axis=(0, 1)), surface.control_net.mean(axis=(0, 1)), atol=1e-12)


def test_the_presets_hold_what_their_names_say():
    assert [len(AFFINE_PRESETS[name]) for name in ("scaling", "translation", "linear", "affine")] == [
        3,
        3,
        9,
        12,
    ]
    assert AFFINE_PRESETS["affine"] == AFFINE_NAMES


# ------------------------------------------------------------------ closed organ


@pytest.mark.parametrize(("net", "degrees"), [((9, 7), (3, 3)), ((7, 5), (2, 3)), ((13, 9), (5, 4)), ((8, 6), (3, 1))])
def test_seam_and_poles_stay_closed_to_the_last_bit(closure, net, degrees):
    parametrization = closed_organ(organ_of(closure, net, degrees), closure=closure)
    surface = parametrization.deform(random_q(parametrization, scale=20.0))
    moved = surface.control_net - parametrization.surface.control_net
    np.testing.assert_array_equal(surface.control_net[0], surface.control_net[-1])
    for pole in (0, -1):
        # The displacements of all points of a pole are the same number.
        assert np.ptp(surface.control_net[:, pole], axis=0).max() == 0.0
    assert np.isfinite(moved).all()
    assert surface.closed


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_a_smooth_organ_has_a_seam_as_smooth_as_its_spline(degree):
    parametrization = closed_organ(organ_of("smooth", (11, 8), (degree, 3)))
    surface = parametrization.deform(random_q(parametrization))
    v = np.linspace(0.0, 1.0, 21)
    for order in range(degree):
        ends = surface.grid([0.0, 1.0], v, du=order)
        # Every derivative multiplies the rounding of the coordinates by the number of spans.
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-12 * 10.0**order * degree**order)


def test_the_papers_organ_has_a_seam_with_one_tangent():
    parametrization = closed_organ(organ_of("paper"), closure="paper")
    surface = parametrization.deform(random_q(parametrization))
    inner = np.linspace(0.0, 1.0, 21)
    first, last = surface.grid([0.0, 1.0], inner, du=1)
    np.testing.assert_allclose(first, last, atol=1e-11)
    net = surface.control_net
    np.testing.assert_allclose(net[0, 2:-2], (net[1, 2:-2] + net[-2, 2:-2]) / 2.0, atol=1e-12)


def test_a_smooth_organ_keeps_a_tangent_plane_at_its_poles():
    parametrization = closed_organ(organ_of("smooth"))
    surface = parametrization.deform(random_q(parametrization))
    u = np.linspace(0.0, 1.0, 50)
    for v in (0.0, 1.0):
        leaving = surface.grid(u, [v], dv=1)[:, 0]
        singular = np.linalg.svd(leaving, compute_uv=False)
        assert singular[2] < 1e-12 * singular[0]
        assert singular[1] > 1e-3 * singular[0]


def test_the_papers_poles_move_together_with_their_rings():
    parametrization = closed_organ(organ_of("paper"), closure="paper")
    moved = parametrization.control_net(random_q(parametrization)) - parametrization.surface.control_net
    for columns in ((0, 1), (-1, -2)):
        together = moved[:, columns].reshape(-1, 3)
        np.testing.assert_allclose(together, np.tile(together[0], (len(together), 1)), atol=1e-12)


def test_degrees_of_freedom_count_what_is_free():
    # 8 different rows and 3 columns away from the poles, and at either pole 3 vectors or 1.
    assert closed_organ(organ_of("smooth")).n_dof == 3 * (8 * 3 + 2 * 3)
    assert closed_organ(organ_of("paper"), closure="paper").n_dof == 3 * (7 * 3 + 2 * 1)


def test_a_closed_organ_can_follow_every_affine_map(closure):
    # The paper's poles are translated only, together with their rings.
    free = "translation" if closure == "paper" else "affine"
    surface = organ_of(closure)
    moved = affine(surface, free=free)
    target = moved.control_net(np.random.default_rng(8).normal(scale=0.3, size=moved.n_dof))
    parametrization = closed_organ(surface, closure=closure)
    np.testing.assert_allclose(parametrization.control_net(parametrization.fit(target)), target, atol=1e-9)


def test_degrees_of_freedom_of_an_organ_deformed_before_reach_the_same_shapes():
    first = closed_organ(organ_of("smooth"))
    deformed = first.deform(random_q(first, scale=2.0))
    second = closed_organ(deformed)
    target = first.control_net(random_q(first, scale=2.0, seed=9))
    np.testing.assert_allclose(second.control_net(second.fit(target)), target, atol=1e-8)


# ------------------------------------------------------------------ refusals


def test_an_open_surface_is_no_closed_organ():
    with pytest.raises(ValueError, match="no seam in u or no two poles; a closed organ needs both"):
        closed_organ(models.bell())


def test_an_unknown_closure_is_refused():
    with pytest.raises(ValueError, match="closure 'round' was asked for; choose one of smooth, paper"):
        closed_organ(organ_of("smooth"), closure="round")


def test_too_few_columns_are_refused():
    knots_u, around = bspline.periodic_to_clamped(3, np.linspace(0.0, 1.0, 9))
    angle = np.arange(8) * np.pi / 4.0
    ring = around @ np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)])
    pole = np.zeros_like(ring)
    net = np.stack([pole - [0, 0, 1], ring, pole + [0, 0, 1]], axis=1)
    surface = BSplineSurface((3, 2), knots_u, bspline.uniform_clamped_knots(2, 3), net)
    with pytest.raises(ValueError, match="3 columns of control points were given; a closed organ needs at least 4"):
        closed_organ(surface)


def test_the_smooth_closure_needs_clamped_simple_knots():
    doubled = organ_of("smooth").insert_knots(u=[0.5])
    with pytest.raises(ValueError, match="knots in u are not clamped or not simple; the smooth closure needs"):
        closed_organ(doubled)


def test_the_smooth_closure_needs_flat_rings_at_the_poles():
    organ = organ_of("smooth")
    net = organ.control_net.copy()
    net[3, 1] += [0.0, 0.0, 4.0]
    with pytest.raises(ValueError, match="next to a pole do not lie in one plane through it; start from a generic"):
        closed_organ(organ.with_control_net(net))


def test_the_papers_closure_needs_four_rows():
    knots = bspline.uniform_clamped_knots(1, 3)
    ring = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    pole = np.zeros((3, 3))
    net = np.stack([pole - [0, 0, 1], ring, ring + [0, 1, 0], pole + [0, 0, 1]], axis=1)
    surface = BSplineSurface((1, 1), knots, bspline.uniform_clamped_knots(1, 4), net)
    with pytest.raises(ValueError, match="3 rows of control points were given; the closure of the paper needs"):
        closed_organ(surface, closure="paper")
