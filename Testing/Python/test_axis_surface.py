"""The surface of a long or bent organ along its axis, and the choice between it and other regions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reorientation import ORIENTATIONS, reordered
from tubes import RADIUS_MM, bent_tube, walled_tube

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import dice_coefficient, region_from_mask
from VICRegistrationLib.segmentation.axis_surface import capsule, find_along_axis
from VICRegistrationLib.segmentation.edge_support import strength_apart
from VICRegistrationLib.segmentation.growing import grown_region
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.shaped_region import shaped_region
from VICRegistrationLib.segmentation.star_surface import find_star

FIRST, MIDDLE, LAST = 40, 200, 360


@pytest.fixture(scope="module")
def tube():
    """A tube that is bent by 140 degrees."""
    return bent_tube(140.0)


@pytest.fixture(scope="module")
def surface(tube):
    """What is found along the axis from a click near an end."""
    return find_along_axis(tube.image, find_star(tube.image, tube.axis[LAST]))


@pytest.fixture(scope="module")
def whole(tube, surface):
    """The region inside of that surface."""
    return shaped_region(tube.image, surface, tube.axis[LAST])


@pytest.mark.parametrize("half_length", [0.2, 1.0, 4.0])
def test_rays_are_evenly_spread_over_a_capsule(half_length):
    graph = capsule(half_length, 0.3)
    on_axis = np.clip(graph.places, [0.0, 0.0, -half_length], [0.0, 0.0, half_length])
    np.testing.assert_allclose(np.linalg.norm(graph.places - on_axis, axis=1), 1.0, atol=1e-12)
    area = 4.0 * np.pi * (1.0 + half_length)
    assert len(graph.places) * 0.3**2 == pytest.approx(area, rel=0.15)
    np.testing.assert_array_equal(graph.first[graph.back], graph.second)
    counts = np.bincount(graph.first, minlength=len(graph.places))
    assert counts.min() >= 3
    assert counts.mean() == pytest.approx(5.0, abs=1.0)
    np.testing.assert_allclose(np.linalg.norm(graph.on_sphere, axis=1), 1.0, atol=1e-12)


def test_equal_areas_of_a_capsule_are_equal_areas_of_the_sphere():
    heights = np.sort(capsule(4.0, 0.1).on_sphere[:, 2])
    np.testing.assert_allclose(heights, np.linspace(-1.0, 1.0, len(heights)), atol=0.02)


def test_a_ray_passes_the_place_that_its_points_have(surface):
    axis = surface.source
    places, distances = axis.coordinates(surface.points)
    np.testing.assert_allclose(distances, surface.radii, atol=0.1)
    assert np.linalg.norm(places - surface.graph.places, axis=1).max() < 0.1


def test_the_axis_grows_from_one_end_of_a_tube_to_the_other(tube, surface):
    ends = surface.source.points[[0, -1]]
    expected = tube.axis[[0, -1]]
    away = min(np.linalg.norm(ends - each, axis=1).max() for each in (expected, expected[::-1]))
    assert away < RADIUS_MM / 2.0
    np.testing.assert_allclose(tube.distances(surface.points), 0.0, atol=2.0)
    assert surface.found.mean() > 0.95


def test_one_click_near_an_end_finds_all_of_a_bent_tube(tube, whole):
    star = find_star(tube.image, tube.axis[LAST])
    truth = region_from_mask(tube.image, tube.mask)
    assert dice_coefficient(shaped_region(tube.image, star, tube.axis[LAST]), truth) < 0.8
    assert dice_coefficient(whole, truth) > 0.97


def test_a_ball_behind_a_gap_in_the_wall_is_cut_off():
    # It has an eighth of the region's volume, and clear edges.
    tube = walled_tube(180.0, gap_mm=8.0)
    truth = region_from_mask(tube.image, tube.mask)
    assert 0.85 < dice_coefficient(grown_region(tube.image, tube.axis[[FIRST]]), truth) < 0.92
    assert dice_coefficient(separate(tube.image, tube.axis[FIRST]), truth) > 0.97


def test_a_bent_organ_is_separated_where_the_signal_falls_to_half_along_it():
    tube = walled_tube(100.0, left=0.5)
    region = separate(tube.image, tube.axis[MIDDLE])
    assert dice_coefficient(region, region_from_mask(tube.image, tube.mask)) > 0.95


def test_there_is_no_diagnostic_where_growing_agrees_with_the_surface_along_the_axis(tube, whole):
    assert dice_coefficient(grown_region(tube.image, tube.axis[[FIRST]]), whole) > 0.95
    region = separate(tube.image, tube.axis[FIRST])
    assert region.diagnostics == ()


def test_several_clicks_may_have_their_mean_outside_of_a_bent_organ():
    tube = walled_tube(220.0)
    seeds = tube.axis[[FIRST, MIDDLE, LAST]]
    assert tube.distances(seeds.mean(axis=0)[None])[0] > 0.0
    whole = shaped_region(tube.image, find_along_axis(tube.image, find_star(tube.image, seeds)), seeds)
    assert dice_coefficient(whole, region_from_mask(tube.image, tube.mask)) > 0.97


@pytest.mark.parametrize(("order", "flips"), ORIENTATIONS[3:4])
def test_a_region_along_an_axis_hardly_depends_on_the_order_of_the_volumes_axes(tube, whole, order, flips):
    copy = reordered(tube.image, order, flips)
    again = shaped_region(copy, find_along_axis(copy, find_star(copy, tube.axis[LAST])), tube.axis[LAST])
    expected, found = (
        Image(region.in_box((0, 0, 0), image.array.shape), image.ijk_to_ras).canonical().array
        for region, image in ((whole, tube.image), (again, copy))
    )
    assert np.count_nonzero(found != expected) < 0.01 * np.count_nonzero(expected)


def test_the_axis_of_a_ball_adds_nothing_to_its_star_shaped_surface():
    places = np.indices((41,) * 3) - 20.0
    levels = np.where(np.linalg.norm(places, axis=0) < 15.0, 150.0, 50.0)
    image = Image(levels + np.random.default_rng(0).normal(0.0, 3.0, levels.shape), np.eye(4))
    star = find_star(image, np.full(3, 20.0))
    along = find_along_axis(image, star)
    first, second = (shaped_region(image, each, np.full(3, 20.0)) for each in (star, along))
    assert dice_coefficient(first, second) > 0.97
    assert strength_apart(image, first, along, star) == strength_apart(image, second, star, star) == 1.0


def test_edges_are_clearer_where_the_whole_organ_is_apart_from_a_part_of_it(tube, surface, whole):
    star = find_star(tube.image, tube.axis[LAST])
    part = shaped_region(tube.image, star, tube.axis[LAST])
    assert strength_apart(tube.image, whole, star, star) > 0.9
    assert strength_apart(tube.image, part, surface, star) < 0.5


def test_a_region_along_an_axis_depends_on_contrast_alone(tube, whole):
    image = Image(4000.0 - 100.0 * tube.image.array, tube.image.ijk_to_ras)
    along = find_along_axis(image, find_star(image, tube.axis[LAST]))
    assert not along.bright
    again = shaped_region(image, along, tube.axis[LAST])
    assert again.offset == whole.offset
    np.testing.assert_array_equal(again.mask, whole.mask)


def test_a_tube_that_the_volume_cuts_goes_on_to_the_volumes_end(tube):
    image = tube.image.crop((0, 0, 0), (*tube.image.array.shape[:2], 100))
    star = find_star(image, tube.axis[MIDDLE])
    region = shaped_region(image, find_along_axis(image, star), tube.axis[MIDDLE])
    truth = region_from_mask(image, tube.mask[:, :, :100])
    assert region.touches_border == ("i+",)
    assert dice_coefficient(region, truth) > 0.96


def test_an_organ_that_is_very_thin_for_its_length_has_no_axis():
    """Rays along it would be many, and take a minute."""
    k, j, _ = np.indices((15, 15, 200)) - 7.0
    image = Image(np.where(np.hypot(k, j) < 1.5, 150.0, 50.0), np.eye(4))
    star = find_star(image, np.array([100.0, 7.0, 7.0]))
    rod = replace(star, radii=np.where(np.abs(star.directions[:, 0]) > 0.99, 99.0, 1.5))
    assert find_along_axis(image, rod) is None
