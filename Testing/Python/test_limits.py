"""Limits that follow the signal along an organ, and looking for its edges from where they are seen."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.segmentation.growing import grown_region
from VICRegistrationLib.segmentation.limits import Limits
from VICRegistrationLib.segmentation.ray_edges import Edges, find_edges
from VICRegistrationLib.segmentation.ray_origins import edges_around
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.sphere import sphere
from VICRegistrationLib.segmentation.threshold import threshold_between

RADIUS, WALL_MM = 22.0, 4.0


@pytest.fixture(scope="module")
def fading():
    """A ball in a dark wall in tissue of 80, whose signal falls from 160 at its left to 80 at its right."""
    matrix = np.eye(4)
    matrix[:3, 3] = -32.0
    k, j, i = np.indices((65, 65, 65)) - 32.0
    radius = np.sqrt(i**2 + j**2 + k**2)
    signal = 120.0 - 40.0 * np.clip(i / RADIUS, -1.0, 1.0)
    array = np.where(radius < RADIUS + WALL_MM, 25.0, 80.0)
    array = np.where(radius < RADIUS, signal, array) + 3.0 * np.random.default_rng(0).standard_normal(radius.shape)
    return Image(array, matrix), radius < RADIUS


def test_a_region_follows_a_signal_that_falls_off(fading):
    image, truth = fading
    region = separate(image, [0.0, 0.0, 0.0])
    assert region.volume_ml == pytest.approx(truth.sum() / 1000.0, rel=0.02)
    assert region.touches_border == ()


def test_one_threshold_for_all_cannot_do_that(fading):
    image, _ = fading
    edges = find_edges(image, [0.0, 0.0, 0.0])
    low, _ = threshold_between(edges)
    limits = Limits.along(edges, image)
    left = limits.holds((32, 32, 12), np.full((1, 1, 1), 65.0))
    right = limits.holds((32, 32, 52), np.full((1, 1, 1), 65.0))
    # 65 is the blur of the wall where the organ is bright, and organ where it is dim.
    assert low > 65.0
    assert (bool(left[0, 0, 0]), bool(right[0, 0, 0])) == (False, True)


def edges_at(halves):
    """Edges all around a seed at a radius of 20 mm, half way between whose levels lie these, (n,); 200 inside."""
    directions = sphere().places
    assert len(halves) == len(directions)
    outer = 2.0 * np.asarray(halves, dtype=float) - 200.0
    shape = (1, len(directions))
    return Edges(
        distances=np.full(shape, 20.0),
        found=np.ones(shape, dtype=bool),
        points=20.0 * directions[None],
        inner=np.full(shape, 200.0),
        outer=outer[None],
        levels=np.array([200.0]),
        median_level=200.0,
        spread=2.0,
        directions=directions,
        axes=np.eye(3),
    )


def lowest_held(limits, place):
    """Lowest whole grey level within limits at a place, RAS mm in the grid of the fixture."""
    levels = np.arange(-400.0, 200.0)
    voxel = np.rint(np.array(place)[::-1] + 32.0).astype(int)
    return levels[[bool(limits.holds(voxel, np.full((1, 1, 1), level))[0, 0, 0]) for level in levels]].min()


def test_edges_between_parts_of_an_organ_count_less_than_the_wall_behind_them(fading):
    # Every third edge is the wall; the others are half as deep, between bright and dim parts.
    halves = np.where(np.arange(len(sphere().places)) % 3 == 0, 60.0, 120.0)
    limits = Limits.along(edges_at(halves), fading[0])
    assert limits.low == 120.0
    # Measured: 42 at an edge, where a tenth of the typical limit counts, and nearly that far from all edges.
    assert lowest_held(limits, [20.0, 0.0, 0.0]) < 60.0
    assert lowest_held(limits, [31.0, 31.0, 31.0]) > 105.0


def test_a_few_rays_that_have_left_the_organ_do_not_lower_its_limit(fading):
    directions = sphere().places
    halves = np.where(directions[:, 0] > 0.0, 110.0, 90.0)
    halves[directions[:, 0] > 0.93] = -300.0
    assert 0.0 < np.mean(halves < 0.0) < 0.05
    # As low as 90, and by no ray of theirs lower.
    assert lowest_held(Limits.along(edges_at(halves), fading[0]), [20.0, 0.0, 0.0]) > 90.0


def test_limits_that_are_the_same_everywhere():
    grey = np.array([[[9.0, 10.0, 20.0, 20.1]]], dtype=np.float32)
    assert Limits.constant(10.0, 20.0).holds((5, 5, 5), grey).tolist() == [[[False, True, True, False]]]


def test_limits_do_not_depend_on_the_box_that_is_asked_for(fading):
    image, _ = fading
    limits = Limits.along(find_edges(image, [0.0, 0.0, 0.0]), image)
    whole = limits.holds((0, 0, 0), image.array)
    part = limits.holds((10, 20, 30), image.array[10:40, 20:50, 30:60])
    np.testing.assert_array_equal(part, whole[10:40, 20:50, 30:60])


def test_a_seed_beside_the_organ_is_moved_into_it(fading):
    image, _ = fading
    beside = np.array([0.0, 0.0, RADIUS + 2.0])
    seeds, _ = edges_around(image, beside[None], Limits.constant(95.0, 200.0))
    assert np.linalg.norm(seeds[0]) < RADIUS + 0.5
    assert np.linalg.norm(seeds[0] - beside) <= 4.0
    with pytest.raises(ValueError, match="move the seed into the organ or widen the threshold"):
        edges_around(image, np.array([[0.0, 0.0, RADIUS + 8.0]]), Limits.constant(95.0, 200.0))


# ------------------------------------------------------------------ a long organ


@pytest.fixture(scope="module")
def sausage():
    """A tube of 100 x 14 mm, bent by 20 mm, bright in dark surroundings."""
    matrix = np.diag([1.0, 1.0, 2.0, 1.0])
    matrix[:3, 3] = [-32.0, -32.0, -60.0]
    k, j, i = np.indices((61, 65, 65))
    x, y, z = i - 32.0, j - 32.0, 2.0 * k - 60.0
    inside = np.hypot(x - 20.0 * (z / 50.0) ** 2, y) < 7.0 * np.sqrt(np.clip(1.0 - (z / 50.0) ** 8, 0.0, 1.0))
    array = np.where(inside, 200.0, 50.0) + 5.0 * np.random.default_rng(1).standard_normal(inside.shape)
    return Image(array, matrix), inside.sum() * 2.0


def test_a_long_organ_is_seen_whole_from_a_seed_at_its_end(sausage):
    image, volume = sausage
    at_end = np.array([[14.0, 0.0, -42.0]])
    alone = find_edges(image, at_end)
    assert alone.volume < 0.6 * volume
    _, edges = edges_around(image, at_end, None)
    assert edges.volume > 0.8 * volume


def test_the_region_does_not_depend_on_the_seed(sausage):
    image, volume = sausage
    regions = [grown_region(image, np.array([seed])) for seed in ([14.0, 0.0, -42.0], [17.0, 5.0, 44.0])]
    for region in regions:
        assert region.volume_ml == pytest.approx(volume / 1000.0, rel=0.05)
        assert region.erosion == regions[0].erosion


def test_rays_that_slip_out_do_not_count(sausage):
    image, volume = sausage
    leaky = image.array.copy()
    # A slit through the surroundings that leads far away from the tube.
    leaky[28:33, 31:34, 39:] = 130.0
    edges = find_edges(Image(leaky, image.ijk_to_ras), [0.0, 0.0, 0.0])
    assert edges.volume < 1.3 * volume
