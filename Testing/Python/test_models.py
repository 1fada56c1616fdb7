"""The generic models: a closed organ of any size and degree, and the paper's bell."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.validity import check_surface

CLOSURES = ("smooth", "paper")
ROTATION = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def radii(surface, center=(0.0, 0.0, 0.0)):
    """Distances of many points of a surface from a centre."""
    grid = surface.grid(*(np.linspace(low, high, 61) for low, high in surface.domain))
    return np.linalg.norm(grid - np.asarray(center), axis=2)


def outwardness(surface):
    """Smallest cosine between the normals and the directions from the origin."""
    u, v = (axis.ravel() for axis in np.meshgrid(*(np.linspace(*limits, 41) for limits in surface.domain)))
    points = surface.points(u, v)
    return (np.einsum("nk,nk->n", surface.normals(u, v), points) / np.linalg.norm(points, axis=1)).min()


def test_the_default_is_the_papers_9_by_7_as_a_smooth_unit_sphere():
    organ = models.closed_organ()
    # Eight different rows and the three repeated ones that clamp a closed cubic.
    assert organ.control_net.shape == (11, 7, 3)
    assert organ.degrees == (3, 3)
    assert np.abs(radii(organ) - 1.0).max() < 0.06


def test_the_papers_closure_has_as_many_rows_as_its_net_says():
    assert models.closed_organ((9, 7), closure="paper").control_net.shape == (9, 7, 3)


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("net", [(6, 5), (9, 7), (12, 9), (33, 25)])
def test_models_of_every_size_are_closed_and_outward(net, closure):
    organ = models.closed_organ(net, closure=closure)
    assert organ.closed
    assert organ.volume() > 0.0
    assert outwardness(organ) > 0.5
    assert check_surface(organ) == ()


def test_the_smallest_smooth_net_is_6_by_4_for_cubics():
    organ = models.closed_organ((6, 4))
    assert check_surface(organ) == ()
    assert outwardness(organ) > 0.5


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("degrees", [(1, 1), (2, 2), (4, 4), (5, 5), (2, 4), (5, 1)])
def test_models_of_every_degree_are_closed_and_outward(degrees, closure):
    organ = models.closed_organ((10, 9), degrees=degrees, closure=closure)
    assert organ.degrees == degrees
    assert organ.closed
    assert outwardness(organ) > 0.5
    assert check_surface(organ) == ()


def test_larger_nets_come_closer_to_the_sphere():
    errors = [np.abs(radii(models.closed_organ(net)) - 1.0).max() for net in ((6, 5), (9, 7), (17, 13), (33, 25))]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.005


def test_axes_and_centre_place_an_ellipsoid():
    axes = np.array([39.0, 14.0, 6.5])[:, None] * ROTATION
    center = np.array([10.0, -40.0, 25.0])
    organ = models.closed_organ((17, 13), axes=axes, center=center)
    local = (organ.control_net - center) @ np.linalg.inv(axes)
    sphere = organ.with_control_net(local)
    np.testing.assert_allclose(local, models.closed_organ((17, 13)).control_net, atol=1e-13)
    assert np.abs(radii(sphere) - 1.0).max() < 0.02
    assert organ.volume() == pytest.approx(4.0 / 3.0 * np.pi * 39.0 * 14.0 * 6.5, rel=0.01)


def test_the_poles_lie_at_both_ends_of_the_last_axis():
    axes = np.diag([1.0, 2.0, 5.0]) @ ROTATION
    organ = models.closed_organ(axes=axes, center=(1.0, 2.0, 3.0))
    first, last = organ.control_net[0, [0, -1]] - [1.0, 2.0, 3.0]
    along = axes[2] / np.linalg.norm(axes[2])
    # The default net's poles lie within 6 % of the ellipsoid.
    assert first @ along == pytest.approx(-5.0, rel=0.06)
    assert last @ along == pytest.approx(5.0, rel=0.06)
    np.testing.assert_allclose(np.cross(first, along), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "axes",
    [np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 1.0, 0.0]), np.eye(2), np.full((3, 3), np.nan)],
    ids=["mirrored", "flat", "two-dimensional", "nan"],
)
def test_axes_that_are_not_right_handed_are_refused(axes):
    with pytest.raises(ValueError, match="not three right-handed vectors; a mirrored or flat organ"):
        models.closed_organ(axes=axes)


@pytest.mark.parametrize(
    ("net", "options", "message"),
    [
        ((4, 7), {}, "net of 4x7 was asked for; degrees 3 and 3 with the smooth closure need at least 5x4"),
        ((9, 3), {}, "net of 9x3 was asked for"),
        ((5, 7), {"closure": "paper"}, "with the paper closure need at least 6x5"),
        ((9, 4), {"closure": "paper"}, "need at least 6x5"),
        ((6, 5), {"degrees": (5, 5)}, "degrees 5 and 5 with the smooth closure need at least 7x6"),
        ((9, 7), {"closure": "round"}, "closure 'round' was asked for; choose one of smooth, paper"),
    ],
)
def test_impossible_nets_are_refused_with_what_is_needed(net, options, message):
    with pytest.raises(ValueError, match=message):
        models.closed_organ(net, **options)


# ------------------------------------------------------------------ bell


def test_the_bell_has_the_control_points_of_equations_8_and_9():
    bell = models.bell()
    net = bell.control_net
    assert net.shape == (9, 4, 3)
    signs = [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]]
    for column, height in enumerate((-0.5, 0.0, 0.5)):
        np.testing.assert_array_equal(net[:, column, :2], 0.5 * np.array(signs))
        np.testing.assert_array_equal(net[:, column, 2], height)
    np.testing.assert_array_equal(net[:, 3], np.tile([0.0, 0.0, 0.5], (9, 1)))


def test_the_bell_is_open_at_the_bottom_and_its_normals_point_outward():
    bell = models.bell(60.0, center=(5.0, 6.0, 7.0))
    assert bell.poles == (False, True)
    u = np.linspace(0.0, 1.0, 30)
    points, normals = bell.points(u, np.full(30, 0.3)), bell.normals(u, np.full(30, 0.3))
    assert np.einsum("nk,nk->n", points - [5.0, 6.0, 7.0], normals).min() > 0.0
    np.testing.assert_allclose(bell.normals([0.2], [1.0]), [[0.0, 0.0, 1.0]], atol=1e-12)
    assert check_surface(bell, require_closed=False) == ()


def test_the_bell_is_scaled_and_placed():
    small, large = models.bell(), models.bell(40.0, center=(1.0, 2.0, 3.0))
    np.testing.assert_allclose(large.control_net, 40.0 * small.control_net + [1.0, 2.0, 3.0], atol=1e-13)
