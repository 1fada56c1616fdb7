"""Validity checks: good organs pass, and every fault is called by its own name, with its place."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.geometry import bspline, models
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.geometry.validity import check_surface, crossing_triangles, validate


@pytest.fixture
def sphere():
    """A ball of 30 mm radius about (5, -10, 20)."""
    return models.closed_organ(axes=30.0 * np.eye(3), center=(5.0, -10.0, 20.0))


def bent_tube(angle, *, bend_radius=40.0, tube_radius=8.0):
    """A straight tube whose control net is bent along a circle by an angle, rad."""
    half = bend_radius * angle / 2.0
    straight = models.closed_organ((9, 15), axes=np.diag([tube_radius, tube_radius, half])).control_net
    turn, radius = straight[..., 2] / bend_radius, bend_radius - straight[..., 0]
    net = np.stack([bend_radius - radius * np.cos(turn), straight[..., 1], radius * np.sin(turn)], axis=-1)
    return models.closed_organ((9, 15)).with_control_net(net)


def kinds(surface, **options):
    return {problem.kind for problem in check_surface(surface, **options)}


def single(surface, **options):
    """The only problem of a surface; its place and its parameters agree."""
    (problem,) = check_surface(surface, **options)
    np.testing.assert_allclose(surface.points(*np.transpose([problem.parameters]))[0], problem.point, atol=1e-9)
    return problem


# ------------------------------------------------------------------ valid surfaces


@pytest.mark.parametrize("axes", [(39, 14, 6.5), (6.5, 14, 39)])
@pytest.mark.parametrize("net", [(6, 5), (9, 7), (17, 13)])
@pytest.mark.parametrize("closure", ["smooth", "paper"])
def test_round_and_flat_models_are_valid(axes, net, closure):
    assert check_surface(models.closed_organ(net, axes=np.diag(axes), closure=closure)) == ()


@pytest.mark.parametrize("seed", range(5))
def test_lopsided_organs_are_valid(seed, sphere):
    parametrization = closed_organ(sphere)
    q = np.random.default_rng(seed).normal(scale=2.0, size=parametrization.n_dof)
    assert check_surface(parametrization.deform(q)) == ()


@pytest.mark.parametrize("angle", [1.0, 3.0, 5.0])
def test_a_bent_tube_is_valid_as_long_as_its_ends_stay_apart(angle):
    assert check_surface(bent_tube(angle)) == ()


def test_a_box_with_sharp_edges_is_valid():
    ring = np.array([[1.0, 0], [1, 1], [0, 1], [0, 0], [1, 0]]) - 0.5
    heights = np.array([0.0, 0.0, 1.0, 1.0])
    factors = np.array([0.0, 1.0, 1.0, 0.0])
    net = np.concatenate([ring[:, None] * factors[:, None], np.tile(heights[:, None], (5, 1, 1))], axis=2)
    knots = [bspline.uniform_clamped_knots(1, n) for n in (5, 4)]
    assert check_surface(BSplineSurface((1, 1), *knots, 20.0 * net)) == ()


def test_knot_insertion_does_not_make_a_surface_invalid(sphere):
    assert check_surface(sphere.refined()) == ()


def test_a_small_and_a_large_copy_are_judged_alike(sphere):
    for factor in (1e-3, 1e3):
        assert check_surface(sphere.with_control_net(factor * sphere.control_net)) == ()


def test_validate_is_silent_about_a_valid_surface(sphere):
    assert validate(sphere) is None


# ------------------------------------------------------------------ open


def test_an_open_surface_is_a_problem_only_where_a_solid_is_wanted():
    bell = models.bell(60.0)
    problem = single(bell)
    assert problem.kind == "open"
    assert problem.parameters[1] == 0.0
    assert problem.point[2] == pytest.approx(-30.0)
    assert check_surface(bell, require_closed=False) == ()


def test_a_surface_without_a_seam_is_open_there(sphere):
    net = sphere.control_net.copy()
    net[-1, 2:-2] -= [0.0, 3.0, 0.0]
    assert single(sphere.with_control_net(net)).parameters[0] == 0.0


# ------------------------------------------------------------------ folded poles


@pytest.mark.parametrize(("ring", "pole"), [(1, 0), (-2, -1)])
def test_a_ring_point_pulled_through_its_pole_is_a_folded_pole(sphere, ring, pole):
    net = sphere.control_net.copy()
    net[3, ring, :2] = net[0, pole, :2] - 1.5 * (net[3, ring, :2] - net[0, pole, :2])
    problem = single(sphere.with_control_net(net))
    assert problem.kind == "folded pole"
    np.testing.assert_allclose(problem.point, net[0, pole], atol=1e-9)


def figure_eight(net, ring, pole):
    angle = 2.0 * np.pi * np.arange(len(net)) / (len(net) - 1)
    net[:, ring] = net[0, pole] + 8.0 * np.column_stack([np.sin(angle), np.sin(2.0 * angle), 0.0 * angle])
    net[-1, ring] = net[0, ring]


def test_a_figure_eight_around_a_pole_is_a_folded_pole(sphere):
    net = sphere.control_net.copy()
    figure_eight(net, 1, 0)
    assert single(sphere.with_control_net(net)).kind == "folded pole"


def test_a_ring_that_goes_round_twice_is_a_folded_pole(sphere):
    net = sphere.control_net.copy()
    angle = 4.0 * np.pi * np.arange(len(net)) / (len(net) - 1)
    net[:, -2] = net[0, -1] + 8.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    net[-1, -2] = net[0, -2]
    assert single(sphere.with_control_net(net)).kind == "folded pole"


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (1.0, 0.5, 0.0)], ids=["point", "line"])
def test_a_ring_collapsed_to_a_point_or_a_line_is_a_folded_pole(sphere, direction):
    net = sphere.control_net.copy()
    net[:, 1] = net[0, 0] + np.cos(2.0 * np.pi * np.arange(11) / 10.0)[:, None] * 8.0 * np.array(direction)
    net[-1, 1] = net[0, 1]
    assert single(sphere.with_control_net(net)).kind == "folded pole"


def test_both_poles_are_named_when_both_are_folded(sphere):
    net = sphere.control_net.copy()
    figure_eight(net, 1, 0)
    figure_eight(net, -2, -1)
    problems = check_surface(sphere.with_control_net(net))
    assert [problem.kind for problem in problems] == ["folded pole", "folded pole"]
    assert [problem.parameters[1] for problem in problems] == [0.0, 1.0]


# ------------------------------------------------------------------ flipped normals


def test_a_net_that_is_inside_out_has_flipped_normals(sphere):
    problem = single(sphere.with_control_net(sphere.control_net[::-1]))
    assert problem.kind == "flipped normal"
    assert "inside out" in problem.message


def test_a_mirrored_organ_has_flipped_normals(sphere):
    assert kinds(sphere.transformed(np.diag([-1.0, 1.0, 1.0, 1.0]))) == {"flipped normal"}


@pytest.fixture
def flat_sided():
    """A ball with a flat side, whose rows 3 to 7 lie in the plane A = 10 mm."""
    ball = models.closed_organ((17, 13), axes=30.0 * np.eye(3))
    net = ball.control_net.copy()
    net[..., 1] = np.minimum(net[..., 1], 10.0)
    return ball.with_control_net(net)


def test_exchanged_rows_of_a_flat_side_fold_the_surface_over(flat_sided):
    assert check_surface(flat_sided) == ()
    net = flat_sided.control_net.copy()
    net[[4, 6], 4:-4] = net[[6, 4], 4:-4]
    problem = single(flat_sided.with_control_net(net))
    assert problem.kind == "flipped normal"
    assert "folded over" in problem.message
    assert problem.point[1] == pytest.approx(10.0, abs=1.0)


def test_a_control_point_pulled_past_its_neighbours_folds_a_flat_side_over(flat_sided):
    net = flat_sided.control_net.copy()
    net[5, 6] += 2.0 * (net[7, 6] - net[5, 6])
    net[5, 6, 1] = 10.0
    assert kinds(flat_sided.with_control_net(net)) == {"flipped normal"}


def test_a_facet_folded_flat_over_its_neighbour_has_a_flipped_normal():
    ball = models.closed_organ((9, 9), degrees=(1, 1), axes=30.0 * np.eye(3))
    assert check_surface(ball) == ()
    net = ball.control_net.copy()
    net[2, 2:-2] = net[1, 2:-2] + 0.5 * (net[1, 2:-2] - net[2, 2:-2])
    net[3, 2:-2] = net[1, 2:-2] + 1.5 * (net[2, 2:-2] - net[1, 2:-2])
    assert "flipped normal" in kinds(ball.with_control_net(net))


def test_a_surface_squeezed_into_a_plane_has_flipped_normals(sphere):
    assert kinds(sphere.transformed(np.diag([1.0, 1.0, 0.0, 1.0]))) == {"flipped normal"}


def test_columns_that_coincide_leave_no_normal():
    organ = models.closed_organ((17, 13), axes=30.0 * np.eye(3))
    net = organ.control_net.copy()
    net[:, 4:8] = net[:, 5:6]
    problem = single(organ.with_control_net(net))
    assert problem.kind == "flipped normal"
    assert "has no normal" in problem.message


# ------------------------------------------------------------------ self-intersection


def test_a_loop_of_exchanged_rows_intersects_itself_without_a_fold(sphere):
    net = sphere.control_net.copy()
    net[[4, 6], 2:-2] = net[[6, 4], 2:-2]
    problem = single(sphere.with_control_net(net))
    assert problem.kind == "self-intersection"
    # The rows stand about the middle of the way around.
    assert abs(problem.parameters[0] - 0.5) < 0.25


@pytest.mark.parametrize("angle", [6.6, 7.0, 8.0])
def test_a_tube_whose_ends_pass_through_each_other_intersects_itself(angle):
    problem = single(bent_tube(angle))
    assert problem.kind == "self-intersection"
    # The ends meet opposite to the middle of the tube.
    assert problem.point[0] > 60.0
    assert "passes through itself" in problem.message


def test_a_wall_pushed_through_the_opposite_wall_intersects_itself():
    organ = models.closed_organ((17, 13), axes=np.diag([40.0, 10.0, 40.0]))
    net = organ.control_net.copy()
    # A dent of one wall, smooth and deeper than the organ is thick.
    dent = 40.0 * np.exp(-(net[..., 0] ** 2 + net[..., 2] ** 2) / 12.0**2)
    net[..., 1] -= np.where(net[..., 1] > 0.0, dent, 0.0)
    problem = single(organ.with_control_net(net))
    assert problem.kind == "self-intersection"
    assert problem.point[1] < 0.0


def test_a_dent_that_stays_inside_is_valid():
    organ = models.closed_organ((17, 13), axes=np.diag([40.0, 10.0, 40.0]))
    net = organ.control_net.copy()
    dent = 12.0 * np.exp(-(net[..., 0] ** 2 + net[..., 2] ** 2) / 12.0**2)
    net[..., 1] -= np.where(net[..., 1] > 0.0, dent, 0.0)
    assert check_surface(organ.with_control_net(net)) == ()


def test_an_open_surface_may_intersect_itself_too():
    tube = bent_tube(7.0)
    net = tube.control_net.copy()
    net[:, 0] = net[:, 1] + 0.5 * (net[:, 1] - net[:, 2])
    open_tube = tube.with_control_net(net)
    assert kinds(open_tube, require_closed=False) == {"self-intersection"}
    assert kinds(open_tube) == {"open", "self-intersection"}


# ------------------------------------------------------------------ messages


def test_messages_are_one_sentence_with_place_and_remedy(sphere):
    folded = sphere.control_net.copy()
    figure_eight(folded, 1, 0)
    broken = [
        models.bell(60.0),
        sphere.with_control_net(folded),
        sphere.with_control_net(sphere.control_net[::-1]),
        bent_tube(7.0),
    ]
    found = [single(surface) for surface in broken]
    assert [problem.kind for problem in found] == [
        "open",
        "folded pole",
        "flipped normal",
        "self-intersection",
    ]
    for problem in found:
        r, a, s = problem.point
        assert f"R {r:.1f}, A {a:.1f}, S {s:.1f} mm" in problem.message
        assert f"u {problem.parameters[0]:.3g}, v {problem.parameters[1]:.3g}" in problem.message
        assert problem.message.endswith(".")
        assert "\n" not in problem.message


def test_validate_raises_the_first_problem(sphere):
    with pytest.raises(ValueError, match="^The surface is inside out: its normal at R .* rows\\.$"):
        validate(sphere.with_control_net(sphere.control_net[::-1]))
    with pytest.raises(ValueError, match="^The surface has a rim at"):
        validate(models.bell())


def test_triangles_that_touch_do_not_cross():
    points = np.array(
        [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2), (0.5, 0.5, -1), (0.5, 0.5, 1), (3, 3, 1)], dtype=float
    )
    # Those of the second pair meet from (0.5, 0.5, 0) to (1, 1, 0); each of the others has a corner in common.
    for other, expected in (([0, 1, 3], []), ([4, 5, 6], [[0, 1]])):
        assert crossing_triangles(points, np.array([[0, 1, 2], other])).tolist() == expected
