"""Walls of hollow organs: surfaces at a distance along the normals."""

from __future__ import annotations

import re

import numpy as np
import pytest

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.meshing.sizes import curvatures, size_field
from VICRegistrationLib.meshing.wall import offset_surface
from VICRegistrationLib.phantoms.organs import pelvic_organs

ORGANS = pelvic_organs()


@pytest.mark.parametrize("name", ORGANS)
@pytest.mark.parametrize("thickness", [1.0, 4.0])
def test_the_wall_is_as_thick_as_wanted_everywhere(name, thickness):
    surface = ORGANS[name]
    outer = offset_surface(surface, thickness, name=name)
    assert outer.closed
    assert not check_surface(outer)
    points = outer.grid(np.linspace(*outer.domain[0], 60), np.linspace(*outer.domain[1], 40)).reshape(-1, 3)
    # Promised are 1 % and 0.01 mm between the knots.
    np.testing.assert_allclose(closest_points(surface, points).distances, thickness, atol=0.015 * thickness + 0.005)


@pytest.mark.parametrize(
    "options", [{"closure": "paper"}, {"degrees": (2, 2), "net": (13, 9)}, {"degrees": (4, 5), "net": (13, 9)}]
)
def test_every_closed_model_can_have_a_wall(options):
    surface = closed_organ(axes=np.diag([20.0, 20.0, 30.0]), **options)
    outer = offset_surface(surface, 3.0)
    # Steiner: V + A w + (mean curvature integral) w^2 + 4/3 pi w^3, more than V + A w.
    assert outer.volume() > surface.volume() + 3.0 * surface.area()
    assert not check_surface(outer)


def test_the_wall_of_a_ball_has_the_volume_of_the_shell():
    outer = offset_surface(closed_organ((17, 13), axes=20.0 * np.eye(3)), 3.0)
    assert outer.volume() == pytest.approx(4.0 / 3.0 * np.pi * 23.0**3, rel=1e-3)


def test_a_wall_thicker_than_a_hollow_is_refused_with_the_place():
    ball = closed_organ((17, 13), axes=20.0 * np.eye(3))
    net = ball.control_net.copy()
    towards = np.exp(-np.square(net - [0.0, 20.0, 0.0]).sum(axis=-1, keepdims=True) / 98.0)
    hollow = ball.with_control_net(net - towards * [0.0, 14.0, 0.0])
    assert not check_surface(hollow)
    assert offset_surface(hollow, 1.0).closed
    words = r"A wall of 15 mm around bladder would pass through itself at R .*, A .* hollow with a radius of \S+ mm"
    with pytest.raises(ValueError, match=words) as refusal:
        offset_surface(hollow, 15.0, name="bladder")
    (possible,) = re.findall(r"; (\S+) mm is possible\.", str(refusal.value))
    assert offset_surface(hollow, float(possible)).closed


def test_shallow_creases_at_a_pole_do_not_fold_the_wall():
    """As fits leave them: the pole has a tangent plane, and beside it a crease whose radius is less than the wall."""
    ball = closed_organ((33, 19), axes=np.diag([12.0, 12.0, 20.0]))
    net = ball.control_net.copy()
    around = np.arctan2(net[:, 2, 1], net[:, 2, 0])
    net[:, 2, 2] -= np.sign(net[0, 0, 2]) * 0.1 * (1.0 + np.cos(6.0 * around))
    creased = ball.with_control_net(net)
    assert not check_surface(creased)
    (low, high), u = creased.domain[1], np.linspace(*creased.domain[0], 64)
    assert -1.0 / curvatures(creased, u, np.array([low + 0.01 * (high - low)]))[..., 0].min() < 2.0
    outer = offset_surface(creased, 2.0)
    assert not check_surface(outer)
    points = outer.grid(u, np.linspace(low, low + 0.2 * (high - low), 40)).reshape(-1, 3)
    np.testing.assert_allclose(closest_points(creased, points).distances, 2.0, atol=0.03)


def test_a_wall_that_meets_itself_from_two_sides_is_refused():
    """A sausage bent to a horseshoe with 8 mm between its ends, whose hollow side has a larger radius."""
    sausage = closed_organ((17, 25), axes=np.diag([6.0, 6.0, 1.0]))
    net = sausage.control_net
    angle = 2.75 * net[..., 2]
    radius = 22.0 + net[..., 0]
    bent = np.stack([radius * np.cos(angle), net[..., 1], radius * np.sin(angle)], axis=-1)
    horseshoe = sausage.with_control_net(bent)
    if horseshoe.volume() < 0.0:
        horseshoe = sausage.with_control_net(bent * [1.0, -1.0, 1.0])
    assert not check_surface(horseshoe)
    assert offset_surface(horseshoe, 2.0).closed
    with pytest.raises(ValueError, match="A wall of 9 mm around the organ would pass through itself"):
        offset_surface(horseshoe, 9.0)


def test_curvatures_of_an_ellipsoid_are_known_at_its_waist():
    surface = closed_organ((33, 25), axes=np.diag([20.0, 20.0, 40.0]))
    (u_low, u_high), (v_low, v_high) = surface.domain
    found = curvatures(surface, np.array([0.3 * u_low + 0.7 * u_high]), np.array([(v_low + v_high) / 2.0]))[0, 0]
    np.testing.assert_allclose(found, [20.0 / 40.0**2, 1.0 / 20.0], rtol=0.02)


def test_sizes_are_smaller_where_the_surface_is_curved_and_grow_away_from_there():
    surface = closed_organ((17, 13), axes=np.diag([10.0, 30.0, 60.0]))
    field = size_field([surface], 5, order=1, volume_error=0.005)
    assert field.sizes.max() > 1.5 * field.sizes.min()
    assert field.sizes.dtype == float
    assert field.sizes.max() <= 5.0
    slope = max(np.abs(np.diff(field.sizes, axis=axis)).max() for axis in range(3)) / field.spacing
    assert slope <= 1.0
    coarse = size_field([surface], 5.0, order=1, volume_error=0.02)
    assert coarse.sizes.mean() > field.sizes.mean()
