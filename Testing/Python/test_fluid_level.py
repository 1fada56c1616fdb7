"""A layer of darker fluid at the back or front of an organ belongs to it; a wall is no level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.messages import Diagnostic
from VICRegistrationLib.segmentation import separation
from VICRegistrationLib.segmentation.fluid_level import find_fluid_level
from VICRegistrationLib.segmentation.separation import separate

RADIUS, WALL_MM, HALF = 20.0, 3.0, 32
LUMEN, LAYER, WALL, TISSUE = 150.0, 85.0, 30.0, 110.0


def ball(*, depth=10.0, degrees=0.0, bulge=0.0, layer=LAYER, wall_mm=WALL_MM, sign=-1.0):
    """A ball in a wall, with a layer behind a level at the back (RAS), so far from the middle, tilted or bulging."""
    s, a, r = np.indices((2 * HALF + 1,) * 3) - float(HALF)
    radius = np.sqrt(s**2 + a**2 + r**2)
    behind = sign * a - depth - np.tan(np.radians(degrees)) * r + bulge * (1.0 - (r**2 + s**2) / RADIUS**2)
    inside = radius < RADIUS
    share = np.clip(0.5 + behind, 0.0, 1.0)
    levels = np.where(inside, LUMEN + share * (layer - LUMEN), np.where(radius < RADIUS + wall_mm, WALL, TISSUE))
    levels = ndimage.gaussian_filter(levels, 0.5) + 3.0 * np.random.default_rng(0).standard_normal(levels.shape)
    matrix = np.eye(4)
    matrix[:3, 3] = -HALF
    return Image(np.rint(levels), matrix), inside, behind


@pytest.fixture(scope="module")
def separated():
    """The ball's image, and what is separated from a click into its bright part."""
    image, inside, _ = ball()
    return image, inside, separate(image, [0.0, 5.0, 0.0])


def before_the_level(image, inside, behind):
    return region_from_mask(image, inside & (behind < 0.5), largest_component=True)


def turned(image, *, axes):
    """The same volume with its axes in memory in another order."""
    order = [2 - axis for axis in axes][::-1]
    return Image(np.ascontiguousarray(image.array.transpose(order)), image.ijk_to_ras[:, [*axes, 3]])


@pytest.mark.parametrize(("degrees", "sign"), [(0.0, -1.0), (3.0, -1.0), (0.0, 1.0)])
def test_a_level_is_found_where_it_is(degrees, sign):
    image, inside, behind = ball(degrees=degrees, sign=sign)
    level = find_fluid_level(image, before_the_level(image, inside, behind))
    assert level.side == ("anterior" if sign > 0.0 else "posterior")
    np.testing.assert_allclose(level.plane, [sign * np.tan(np.radians(degrees)), 0.0, sign * 10.0], atol=0.2)
    # The circle of 300 mm2 times pi but for its rim.
    assert level.area_cm2 == pytest.approx(np.pi * (np.sqrt(3.0) - 0.2) ** 2, abs=0.8)


def test_a_level_is_taken_away_and_all_before_it_stays():
    image, inside, behind = ball()
    even = find_fluid_level(image, before_the_level(image, inside, behind)).removed_from(image)
    np.testing.assert_allclose(even.array[behind < -3.0], image.array[behind < -3.0])
    deep = ndimage.binary_erosion(inside, iterations=2)
    assert even.array[deep].mean() == pytest.approx(LUMEN, abs=1.0)
    assert np.abs(even.array[deep] - LUMEN).max() < 20.0


def test_a_region_is_continued_behind_a_level_alone():
    image, inside, behind = ball()
    before = before_the_level(image, ndimage.binary_erosion(inside), behind)
    further = region_from_mask(image, ndimage.binary_dilation(inside))
    whole = find_fluid_level(image, before).joined(image, before, further)
    found = whole.in_box((0, 0, 0), inside.shape)
    np.testing.assert_array_equal(found[behind < -9.0], ndimage.binary_erosion(inside)[behind < -9.0])
    np.testing.assert_array_equal(found[behind > 1.0], ndimage.binary_dilation(inside)[behind > 1.0])


def test_a_piece_beside_the_layer_is_left_out_without_a_word():
    # It is a matter of how the region was continued, and of no segmentation.
    image, inside, behind = ball()
    beside = inside.copy()
    beside[2:8, 2:8, 2:8] = True
    before = before_the_level(image, inside, behind)
    whole = find_fluid_level(image, before).joined(image, before, region_from_mask(image, beside))
    assert whole.diagnostics == ()
    assert whole.volume_ml == pytest.approx(np.count_nonzero(inside) / 1000.0, rel=0.01)


@pytest.mark.parametrize(
    "how",
    [{"degrees": 9.0}, {"bulge": 3.0}, {"bulge": -3.0}, {"layer": LUMEN}],
    ids=["steep", "convex", "hollow", "none"],
)
def test_what_is_no_level_is_not_found(how):
    image, inside, behind = ball(**how)
    assert find_fluid_level(image, before_the_level(image, inside, behind)) is None
    assert find_fluid_level(image, region_from_mask(image, inside)) is None


@pytest.mark.parametrize("depth", [4, 8, 12])
def test_the_flat_end_where_the_volume_cuts_an_organ_is_no_level(depth):
    image, inside, _ = ball(depth=2.0 * RADIUS)
    start = np.array([0, HALF - depth, 0])
    cut = image.crop(start, image.array.shape)
    assert find_fluid_level(cut, region_from_mask(cut, inside[:, start[1] :], largest_component=True)) is None


def test_a_flat_and_horizontal_wall_is_no_level():
    image, inside, behind = ball()
    walled = np.where(behind > 5.0, TISSUE, np.where(behind > 0.0, WALL, image.array))
    assert find_fluid_level(Image(walled, image.ijk_to_ras), before_the_level(image, inside, behind)) is None


def test_an_organ_is_separated_with_its_layer(separated):
    _, inside, region = separated
    (found,) = region.diagnostics
    assert (found.code, found.values["side"]) == ("layer_included", "posterior")
    # Of a ball of 33.5 ml, the cap of 10 mm.
    assert found.values["layer_ml"] == pytest.approx(np.pi * 100.0 * (60.0 - 10.0) / 3.0 / 1000.0, rel=0.1)
    assert region.volume_ml == pytest.approx(np.count_nonzero(inside) / 1000.0, rel=0.03)


def test_a_click_into_the_layer_finds_the_whole_organ():
    image, inside, _ = ball(depth=5.0)
    region = separate(image, [0.0, -10.0, 0.0])
    assert np.count_nonzero(region.in_box((0, 0, 0), inside.shape) & inside) > 0.99 * np.count_nonzero(inside)
    # The dim layer lowers the limits all around: less than half a voxel more is taken.
    assert region.volume_ml < 1.07 * np.count_nonzero(inside) / 1000.0


def test_neither_offset_and_scale_of_the_grey_levels_nor_the_order_of_axes_change_what_is_found(separated):
    image, inside, region = separated
    other = turned(Image(0.25 * image.array - 1000.0, image.ijk_to_ras), axes=(1, 2, 0))
    again = separate(other, [0.0, 5.0, 0.0])
    (found,) = again.diagnostics
    assert (found.code, found.values["side"]) == ("layer_included", "posterior")
    expected = region.in_box((0, 0, 0), inside.shape).transpose([2, 0, 1])
    np.testing.assert_array_equal(again.in_box((0, 0, 0), inside.shape), expected)


def test_what_was_found_before_the_level_stays_a_diagnostic_and_is_no_leak(monkeypatch):
    image, inside, behind = ball()
    region = before_the_level(image, inside, behind)
    sizes = {"grown_ml": 5.0, "shaped_ml": 30.0, "taken_ml": 30.0}
    differs = replace(region, threshold=(100.0, 200.0), diagnostics=(Diagnostic("starts_differ", sizes),))
    monkeypatch.setattr(separation, "_by_both_ways", lambda *_: differs)
    whole = separate(image, [0.0, 5.0, 0.0])
    assert [each.code for each in whole.diagnostics] == ["starts_differ", "layer_included"]
    # Of the region before the level, continued.
    assert whole.threshold == (100.0, 200.0)


def test_a_region_that_misses_a_part_of_the_organ_gives_way_to_the_shape_behind_the_level(monkeypatch):
    image, inside, behind = ball()
    left = np.arange(inside.shape[2]) < HALF + 5
    part = region_from_mask(image, inside & (behind < 0.5) & left, largest_component=True)
    monkeypatch.setattr(separation, "_by_both_ways", lambda *_: part)
    whole = separate(image, [0.0, 5.0, 0.0])
    assert [each.code for each in whole.diagnostics] == ["layer_included"]
    assert whole.volume_ml == pytest.approx(np.count_nonzero(inside) / 1000.0, rel=0.03)


def test_what_has_no_wall_behind_a_level_is_left_out_and_reported():
    """Tissue behind a flat wall, as even as a fluid, which goes on to the border of the volume."""
    image, inside, behind = ball()
    open_ended = np.where(behind > 0.0, LAYER, image.array)
    region = separate(Image(open_ended, image.ijk_to_ras), [0.0, 5.0, 0.0])
    assert [each.code for each in region.diagnostics] == ["ends_at_level"]
    assert region.volume_ml == pytest.approx(np.count_nonzero(inside & (behind < 0.0)) / 1000.0, rel=0.05)
