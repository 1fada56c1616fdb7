"""An organ is cut out of its volume, the same whichever way the grid lies."""

from __future__ import annotations

import numpy as np
import pytest
from reorientation import ORIENTATIONS, reordered
from scipy import ndimage

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.morphology import ball_reach, boundary_voxels, dilate, erode, fill_holes, largest_piece
from VICRegistrationLib.imaging.region import region_from_label, region_from_mask
from VICRegistrationLib.segmentation.growing import grown_region
from VICRegistrationLib.segmentation.separation import separate

SPACING = np.array([0.8, 0.8, 3.0])
CENTER = np.array([5.0, -3.0, 8.0])


def ball_image(*, radius=14.0, inside=200.0, outside=80.0, noise=6.0, shape=(18, 70, 64), spacing=SPACING):
    """Return a noisy ball around CENTER, with soft edges, in a volume around the same point."""
    matrix = np.diag([*spacing, 1.0])
    matrix[:3, 3] = CENTER - spacing * (np.array(shape[::-1]) - 1) / 2
    k, j, i = np.indices(shape)
    ras = np.stack([i, j, k], axis=-1) * spacing + matrix[:3, 3]
    distance = np.linalg.norm(ras - CENTER, axis=-1) - radius
    levels = outside + (inside - outside) * np.clip(0.5 - distance, 0, 1)
    levels += np.random.default_rng(0).normal(0, noise, shape)
    return Image(levels.astype(np.float32), matrix)


@pytest.fixture(scope="module")
def image():
    return ball_image()


@pytest.mark.parametrize(
    ("spacing", "radius"),
    [((0.6, 0.6, 4.0), 3.0), ((0.5, 1.0, 0.5), 2.0), ([[0.6, 0.1, 0.3], [0, 0.5, 0.2], [0, 0, -2.0]], 2.5)],
)
def test_dilation_and_erosion_use_the_ball_in_mm(spacing, radius):
    steps = np.diag(spacing) if np.ndim(spacing) == 1 else np.array(spacing)
    reach = ball_reach(spacing, radius)
    k, j, i = np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij")
    ball = np.linalg.norm(np.stack([i, j, k], axis=-1) @ steps.T, axis=-1) <= radius + 1e-6
    sparse = np.random.default_rng(0).random((9, 20, 17)) < 0.02
    expected = ndimage.binary_dilation(sparse, ball)
    np.testing.assert_array_equal(dilate(sparse, spacing, radius), expected)
    expected = ndimage.binary_erosion(~sparse, ball, border_value=1)
    np.testing.assert_array_equal(erode(~sparse, spacing, radius), expected)


def test_the_largest_piece_is_that_of_voxels_that_share_faces():
    mask = np.zeros((6, 6), dtype=bool)
    mask[0, :4] = mask[1, 4] = mask[3:5, 1:3] = mask[5, 3] = True
    first = np.zeros_like(mask)
    first[0, :4] = True
    np.testing.assert_array_equal(largest_piece(mask), first)
    np.testing.assert_array_equal(largest_piece(first), first)
    assert not largest_piece(np.zeros_like(mask)).any()


def test_boundary_voxels_have_a_face_outside_or_at_the_border():
    mask = np.random.default_rng(3).random((6, 7, 8)) < 0.8
    np.testing.assert_array_equal(boundary_voxels(mask), np.argwhere(mask & ~ndimage.binary_erosion(mask)))


def test_a_radius_below_the_slice_distance_stays_in_the_slice():
    mask = np.zeros((3, 9, 9), dtype=bool)
    mask[1, 4, 4] = True
    grown = dilate(mask, (1.0, 1.0, 4.0), 2.0)
    assert not grown[[0, 2]].any()
    assert grown[1].sum() == 13


def test_a_cavity_is_filled_but_not_a_bay():
    mask = np.zeros((5, 7, 7), dtype=bool)
    mask[1:4, 1:6, 1:6] = True
    mask[2, 3, 2] = False
    mask[2:, 3, 4] = False
    filled = fill_holes(mask)
    assert filled[2, 3, 2]
    assert not filled[2, 3, 4]


@pytest.mark.parametrize("levels", [(200.0, 80.0), (60.0, 180.0)], ids=["brighter", "darker"])
def test_a_ball_has_its_volume_with_nothing_but_a_seed(levels):
    image = ball_image(inside=levels[0], outside=levels[1])
    region = separate(image, CENTER + [4, 3, 2])
    # The voxels of 2 mm^3 at the surface are counted whole or not at all, and erosion clips some corners.
    assert region.volume_ml == pytest.approx(4 / 3 * np.pi * 14**3 / 1000, rel=0.03)
    assert region.touches_border == ()
    assert region.erosion == 2.0


def test_automatic_limits_are_not_below_the_lowest_grey_level_of_the_image():
    dark = ball_image(inside=80.0, outside=300.0)
    low, high = grown_region(dark, CENTER[None]).threshold
    assert low == dark.array.min()
    assert separate(dark, CENTER[None]).threshold[0] >= dark.array.min()
    assert 80.0 < high < 300.0
    # What is given is kept as it is, and means the same voxels.
    given = separate(dark, CENTER[None], threshold=(-50.0, high))
    assert given.threshold == (-50.0, high)
    np.testing.assert_array_equal(given.mask, separate(dark, CENTER[None], threshold=(low, high)).mask)


def test_the_region_is_in_its_place_with_a_margin(image):
    region = separate(image, [CENTER])
    for axis in range(3):
        assert not region.mask.take([0, -1], axis=axis).any()
    k, j, i = np.argwhere(region.mask).mean(axis=0)
    middle = region.image.to_ras([[i, j, k]])[0]
    np.testing.assert_allclose(middle, CENTER, atol=0.1)
    np.testing.assert_allclose(middle, image.to_ras([np.array([i, j, k]) + region.offset[::-1]])[0])


def test_the_growing_box_gives_the_result_of_the_whole_volume(image):
    low, high = 140.0, 300.0
    for seed in ([0, 0, 0], [12, 0, 0], [0, -9, 6]):
        region = separate(image, CENTER + seed, threshold=(low, high), erosion=2.0)
        inside = (image.array >= low) & (image.array <= high)
        core = erode(inside, image.spacing, 2.0)
        pieces, _ = ndimage.label(core)
        piece = pieces == pieces[tuple(np.rint(image.to_ijk([CENTER])[0, ::-1]).astype(int))]
        expected = fill_holes(dilate(piece, image.spacing, 2.0) & inside)
        np.testing.assert_array_equal(region.in_box((0, 0, 0), image.array.shape), expected)


SEEDS = CENTER + [[6.0, 2.0, 1.0], [-3.0, 4.0, -5.0]]


@pytest.fixture(scope="module")
def expected(image):
    return separate(image, SEEDS)


@pytest.mark.parametrize(("order", "flips"), ORIENTATIONS[3::4])
def test_copies_with_other_axes_give_the_same_voxels(image, expected, order, flips):
    full = Image(expected.in_box((0, 0, 0), image.array.shape), image.ijk_to_ras).canonical()
    copy = reordered(image, order, flips)
    region = separate(copy, SEEDS)
    np.testing.assert_allclose(region.threshold, expected.threshold, rtol=1e-6)
    same_grid = Image(region.in_box((0, 0, 0), copy.array.shape), copy.ijk_to_ras).canonical()
    np.testing.assert_array_equal(same_grid.array, full.array)


def test_a_copy_rotated_in_the_world_gives_the_same_voxels(image, expected):
    turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    turned = np.eye(4)
    turned[:3, :3] = turn
    region = separate(Image(image.array, turned @ image.ijk_to_ras), SEEDS @ turn.T)
    assert region.offset == expected.offset
    np.testing.assert_array_equal(region.mask, expected.mask)


def bridged():
    """Return two balls joined by a bar three voxels thick, and where they are."""
    first, second = ball_image(radius=9.0), ball_image(radius=9.0, noise=0)
    array = np.maximum(np.roll(first.array, -12, axis=2), np.roll(second.array, 14, axis=2))
    array[8:10, 34:37, 25:40] = 200
    shift = 0.8 * np.array([1.0, 0, 0])
    return Image(array, first.ijk_to_ras), CENTER - 12 * shift, CENTER + 14 * shift


def test_erosion_cuts_a_bridge_that_no_erosion_leaves():
    image, first, _ = bridged()
    ball = 4 / 3 * np.pi * 9**3 / 1000
    joined = separate(image, first, threshold=(140, 300), erosion=0.0)
    assert joined.volume_ml > 1.8 * ball
    cut = separate(image, first, threshold=(140, 300), erosion=2.0)
    # A stub of the bridge of up to 2 mm comes back with the dilation.
    assert cut.volume_ml == pytest.approx(ball, rel=0.06)


def test_the_default_erosion_grows_until_the_region_fits_what_the_seed_sees():
    image, first, _ = bridged()
    thick = image.array.copy()
    thick[6:12, 32:39, 25:40] = 200
    region = separate(Image(thick, image.ijk_to_ras), first, threshold=(140, 300))
    assert region.erosion > 2.0
    assert region.volume_ml == pytest.approx(4 / 3 * np.pi * 9**3 / 1000, rel=0.2)


def test_seeds_in_separate_pieces_are_refused():
    image, first, second = bridged()
    with pytest.raises(ValueError, match="falls into 2 pieces, which one closed surface cannot hold") as refusal:
        separate(image, [first, second], threshold=(140, 300), erosion=2.0)
    assert "Fit them one by one, or widen the threshold or lower the erosion so that they join." in str(refusal.value)


def test_the_default_erosion_keeps_the_pieces_of_the_seeds_together():
    image, first, second = bridged()
    both = separate(image, [first, second], threshold=(140, 300))
    assert ndimage.label(both.mask)[1] == 1
    assert both.erosion < 2.0
    assert both.volume_ml > 1.8 * 4 / 3 * np.pi * 9**3 / 1000


def test_seeds_in_one_piece_agree():
    image, first, second = bridged()
    joined = separate(image, [first, second], threshold=(140, 300), erosion=0.0)
    assert joined.volume_ml == pytest.approx(separate(image, first, threshold=(140, 300), erosion=0.0).volume_ml)


def test_a_region_beyond_what_the_seed_sees_carries_a_warning():
    image, first, _ = bridged()
    leaked = separate(image, first, threshold=(140, 300), erosion=0.0)
    (found,) = leaked.diagnostics
    assert found.code == "region_larger_than_seen"
    assert found.values["region_ml"] == leaked.volume_ml > 1.3 * found.values["seen_ml"]
    assert "the region may have leaked into other tissue (threshold 140 to 300, erosion 0 mm)" in found.sentence()
    assert separate(image, first, threshold=(140, 300), erosion=2.0).diagnostics == ()


@pytest.mark.parametrize("erosion", [1e308, 1e6, 60.0])
def test_an_erosion_larger_than_half_of_the_volume_is_refused_at_once(image, erosion):
    with pytest.raises(ValueError, match="more than half of the volume's longest side, 28 mm.* Use a few millimetres"):
        separate(image, CENTER, threshold=(140, 300), erosion=erosion)


def test_a_thin_organ_is_eroded_less_by_default():
    levels = np.full((10, 40, 40), 50.0)
    levels[4:7, 18:21, 5:35] = 200.0
    image = Image(levels, np.eye(4))
    region = separate(image, [20, 19, 5], threshold=(120, 250))
    assert region.erosion < 2.0
    assert region.mask.any(axis=(0, 1)).sum() == 30


def test_a_cavity_of_the_organ_is_filled_if_wanted(image):
    hollow = image.array.copy()
    hollow[8:10, 30:34, 26:30] = 80
    hollow = Image(hollow, image.ijk_to_ras)
    seed = CENTER + [8, 5, 0]
    options = {"threshold": (140, 300), "erosion": 1.0}
    difference = separate(hollow, seed, **options).volume_ml - separate(hollow, seed, fill=False, **options).volume_ml
    assert difference == pytest.approx(32 * image.voxel_volume / 1000)


def test_an_organ_cut_by_the_volume_says_at_which_faces(image):
    half = image.crop((0, 0, 32), image.array.shape)
    region = separate(half, CENTER + [3, 0, 0])
    assert region.touches_border == ("i-",)
    assert region.mask[:, :, 0].any()


def test_a_given_mask_becomes_a_region(image):
    mask = np.zeros(image.array.shape, dtype=np.uint8)
    mask[5:9, 10:20, 30:42] = 3
    mask[0, 0, 0] = 3
    region = region_from_mask(image, mask)
    assert set(region.touches_border) == {"k-", "j-", "i-"}
    region = region_from_mask(image, mask, largest_component=True)
    assert region.offset == (4, 9, 29)
    assert region.mask.shape == (6, 12, 14)
    assert region.threshold is None
    assert region.diagnostics == ()


@pytest.mark.parametrize("from_label", [True, False])
def test_what_an_empty_slice_cuts_off_is_reported(image, from_label):
    mask = np.zeros(image.array.shape, dtype=np.uint8)
    mask[3:9, 10:20, 30:40] = 1
    mask[6] = 0
    if from_label:
        region = region_from_label(image, Image(mask, image.ijk_to_ras))
    else:
        region = region_from_mask(image, mask, largest_component=True)
    (found,) = region.diagnostics
    assert (found.code, found.values["count"]) == ("segmentation_in_pieces", 2)
    assert found.values["left_out"] == pytest.approx(0.4)
    assert "2 pieces. The largest was taken; the others, 40% of the voxels, were left out" in found.sentence()
