"""Gaps and overlaps of organs: distances, places and common volumes that are known by formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from VICRegistrationLib.analysis.gaps import gap, gaps
from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.surface import BSplineSurface
from VICRegistrationLib.phantoms.organs import pelvic_organs

# Not along an axis or through a pole or the seam.
DIRECTION = np.array([0.48, -0.6, 0.64])
# The generic model with this net is a sphere to 4e-5 of its radius.
SPHERE_NET = (17, 13)
SPHERE_ERROR = 0.002


def ball(radius, center=(0.0, 0.0, 0.0)):
    return models.closed_organ(SPHERE_NET, axes=radius * np.eye(3), center=center)


def lens(first, second, distance):
    """Common volume of two balls."""
    deep = first + second - distance
    squares = distance**2 + 2.0 * distance * (first + second) - 3.0 * (first - second) ** 2
    return np.pi * deep**2 * squares / (12.0 * distance)


@pytest.fixture(scope="module")
def overlapping():
    """Gap of two balls whose centres are 40 mm apart."""
    return gap(ball(30.0), ball(20.0, 40.0 * DIRECTION))


@pytest.fixture(scope="module")
def demo_gaps():
    """Gaps of the demo's organs."""
    return gaps(pelvic_organs())


@pytest.mark.parametrize("distance", [0.01, 1.0, 40.0])
def test_balls_that_are_apart_have_their_known_gap_at_its_place(distance):
    found = gap(ball(30.0), ball(20.0, (50.0 + distance) * DIRECTION))
    assert found.relation == "apart"
    assert found.deepest is None
    assert found.common_volume == 0.0
    assert found.distance == pytest.approx(distance, abs=SPHERE_ERROR)
    # Where a gap of 0.01 mm is narrowest is felt less than the net's 0.001 mm of roundness.
    np.testing.assert_allclose(found.nearest.points[0], 30.0 * DIRECTION, atol=0.2 if distance < 1.0 else 0.05)


def test_the_places_lie_on_both_surfaces_at_their_parameters_as_far_apart_as_told():
    first, second = ball(30.0), ball(20.0, 53.0 * DIRECTION)
    found = gap(first, second).nearest
    for surface, point, parameters in zip((first, second), found.points, found.parameters):
        np.testing.assert_allclose(surface.points(*np.array([parameters]).T)[0], point, atol=1e-9)
    assert np.linalg.norm(np.subtract(*found.points)) == pytest.approx(found.distance, abs=1e-9)


def test_a_gap_at_two_poles_is_found():
    first = models.closed_organ(axes=np.diag([10.0, 12.0, 25.0]))
    second = models.closed_organ(axes=np.diag([14.0, 9.0, 20.0]), center=(0.0, 0.0, 47.5))
    tips = first.points([0.0], [1.0])[0], second.points([0.0], [0.0])[0]
    found = gap(first, second)
    # Both ends are round caps about the axis, so that the poles are closest.
    assert found.distance == pytest.approx(np.linalg.norm(tips[1] - tips[0]), abs=1e-5)
    np.testing.assert_allclose(found.nearest.points, tips, atol=0.05)


def test_no_place_is_nearer_than_the_gap(demo_gaps):
    organs = pelvic_organs()
    found = demo_gaps[0]
    u, v = np.random.default_rng(4).random((2, 4000))
    assert closest_points(organs["vagina"], organs["bladder"].points(u, v)).distances.min() > found.distance
    # The first organ's place, moved by a little, is farther away.
    (u, v), _ = found.nearest.parameters
    around = organs["bladder"].points(u + np.array([0.0, 1e-4, -1e-4, 0.0, 0.0]), v + np.array([0, 0, 0, 1e-4, -1e-4]))
    near = closest_points(organs["vagina"], around).distances
    np.testing.assert_allclose(near, found.distance, atol=1e-4)
    assert near[1:].min() > near[0] - 1e-7


@pytest.mark.parametrize(("distance", "tolerance"), [(40.0, 0.01), (49.7, 0.01)])
def test_overlapping_balls_have_a_lens_in_common(overlapping, distance, tolerance):
    found = overlapping if distance == 40.0 else gap(ball(30.0), ball(20.0, distance * DIRECTION))
    known = lens(30.0, 20.0, distance)
    assert found.relation == "overlapping"
    assert found.distance == pytest.approx(distance - 50.0, abs=SPHERE_ERROR)
    assert found.nearest.distance == 0.0
    assert found.common_volume == pytest.approx(known, rel=tolerance)


def test_a_place_where_the_surfaces_cross_lies_on_both(overlapping):
    points = np.array(overlapping.nearest.points)
    np.testing.assert_allclose(points[0], points[1], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(points[0]), 30.0, atol=SPHERE_ERROR)
    np.testing.assert_allclose(np.linalg.norm(points[0] - 40.0 * DIRECTION), 20.0, atol=SPHERE_ERROR)


def test_an_organ_inside_another_one_is_told_with_its_volume_and_the_thinnest_place():
    inner, outer = ball(20.0, 7.0 * DIRECTION), ball(30.0)
    for first, second, relation in ((inner, outer, "first inside second"), (outer, inner, "second inside first")):
        found = gap(first, second)
        assert found.relation == relation
        assert found.nearest.distance == pytest.approx(3.0, abs=SPHERE_ERROR)
        assert found.common_volume == pytest.approx(inner.volume(), rel=1e-12)
        # The inner ball's far side is 17 mm from the outer one, and no point is deeper.
        assert found.distance == pytest.approx(-17.0, abs=SPHERE_ERROR)


def test_balls_that_touch_have_no_common_volume():
    found = gap(ball(30.0), ball(20.0, 50.0 * DIRECTION))
    assert found.relation == "touching"
    assert abs(found.distance) <= 1e-3


def test_identical_surfaces_have_everything_in_common():
    surface = pelvic_organs()["rectum"]
    same = surface.refined()
    found = gap(surface, same)
    assert found.relation == "identical"
    assert found.distance == pytest.approx(0.0, abs=1e-9)
    assert found.common_volume == pytest.approx(surface.volume(), rel=1e-12)


def test_the_order_of_two_organs_only_swaps_the_places(overlapping):
    one, other = overlapping, gap(ball(20.0, 40.0 * DIRECTION), ball(30.0))
    assert one.distance == pytest.approx(other.distance, abs=1e-4)
    np.testing.assert_allclose(one.deepest.points, other.deepest.points[::-1], atol=0.5)
    assert one.common_volume == pytest.approx(other.common_volume, rel=0.005)


def test_every_pair_of_the_demo_s_organs_is_measured_once(demo_gaps):
    found = demo_gaps
    assert [(each.first, each.second) for each in found] == [
        ("bladder", "vagina"),
        ("bladder", "rectum"),
        ("vagina", "rectum"),
    ]
    assert [each.relation for each in found] == ["apart"] * 3
    # As measured when the organs were drawn; independent of the samples to 0.001 mm.
    np.testing.assert_allclose([each.distance for each in found], [5.1319, 19.7757, 4.1506], atol=1e-3)
    assert "bladder and vagina are 5.13 mm apart at R 2.0" in str(found[0])


def test_an_overlap_is_told_in_a_sentence(overlapping):
    told = str(replace(overlapping, first="bladder", second="vagina"))
    assert f"bladder and vagina have {overlapping.common_volume / 1000.0:.1f} ml in common (overlapping)" in told
    assert "have 123 mm³ in common" in str(replace(overlapping, common_volume=123.4))


@pytest.mark.long
def test_the_demo_s_organs_overlap_where_one_is_moved_into_the_other():
    organs = pelvic_organs()
    shift = np.eye(4)
    shift[1, 3] = 8.0
    (found,) = gaps({"bladder": organs["bladder"], "vagina": organs["vagina"].transformed(shift)})
    assert found.relation == "overlapping"
    assert "bladder and vagina have" in str(found)
    assert "in common (overlapping)" in str(found)


def test_an_open_or_inverted_surface_is_refused_by_name():
    good = ball(10.0)
    with pytest.raises(ValueError, match="surface of bell is open"):
        gaps({"good": good, "bell": models.bell(20.0)})
    inverted = BSplineSurface(good.degrees, good.knots_u, good.knots_v, good.control_net[::-1])
    with pytest.raises(ValueError, match="surface of turned is inside out"):
        gaps({"turned": inverted, "good": good})
