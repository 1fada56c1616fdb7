"""Pieces by which two regions of one organ differ are decided by the edges around them."""

from __future__ import annotations

import numpy as np
import pytest
from bladders import load_bladder
from reorientation import ORIENTATIONS, motion, reordered

from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import dice_coefficient, region_from_mask
from VICRegistrationLib.segmentation.region_pieces import with_pieces
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.star_surface import find_star

RADIUS, HALF = 20.0, 32


def places():
    """Voxels' places (k, j, i), mm from the middle."""
    return np.indices((2 * HALF + 1,) * 3) - float(HALF)


def image_of(inside, tumour=False):
    """A bright lumen in grey tissue, with a grey tumour in it."""
    levels = np.where(inside & ~tumour, 150.0, 60.0) + np.random.default_rng(0).standard_normal(inside.shape)
    matrix = np.eye(4)
    matrix[:3, 3] = -HALF
    return Image(levels, matrix)


def lobe(middle, radius):
    """Voxels of a ball around a place (k, j, i), mm."""
    return np.linalg.norm(places() - np.reshape(middle, (3, 1, 1, 1)), axis=0) < radius


BALL = lobe([0.0, 0.0, 0.0], RADIUS)
# A share of 0.02 and of 0.05 of the ball.
TUMOUR, LARGE = lobe([0.0, 0.0, 17.0], 6.0) & BALL, lobe([0.0, 0.0, 17.0], 9.0) & BALL
BAY = lobe([0.0, 0.0, 19.0], 6.0) & ~BALL


def decided(image, region, other):
    """Mask of the first of two regions after the pieces are decided."""
    star = find_star(image, np.zeros(3))
    regions = (region_from_mask(image, mask) for mask in (region, other))
    return with_pieces(image, *regions, star).in_box((0, 0, 0), BALL.shape)


@pytest.mark.parametrize(
    ("inside", "first", "other"),
    [
        (BALL & ~TUMOUR, BALL, BALL & ~TUMOUR),
        (BALL & ~TUMOUR, BALL & ~TUMOUR, BALL),
        (BALL | BAY, BALL, BALL | BAY),
        (BALL, BALL | BAY, BALL),
        (BALL, BALL, BALL | BAY),
    ],
    ids=["tumour taken in", "tumour left out", "bay left out", "lobe taken in", "lobe left out"],
)
def test_a_piece_is_decided_by_the_edges_around_it(inside, first, other):
    # A few voxels at a piece's sharp rim hold no ball.
    assert np.count_nonzero(decided(image_of(inside), first, other) != inside) < 20


@pytest.mark.parametrize(("order", "flips"), ORIENTATIONS[1::4])
def test_pieces_are_the_same_on_an_oblique_grid_with_thicker_slices(order, flips):
    def on_grid(array):
        """Two slices in one, turned in the world, with other axes in memory."""
        thick = array[:-1].reshape(-1, 2, *array.shape[1:]).mean(axis=1)
        matrix = np.diag([1.0, 1.0, 2.0, 1.0])
        matrix[:3, 3] = -HALF, -HALF, 0.5 - HALF
        return reordered(Image(thick, motion(35.0, (1.0, 2.0, 3.0)) @ matrix), order, flips)

    inside = BALL & ~TUMOUR
    image = on_grid(image_of(inside).array)
    regions = [region_from_mask(image, on_grid(mask.astype(float)).array > 0.5) for mask in (BALL, inside)]
    found = with_pieces(image, *regions, find_star(image, np.zeros(3)))
    assert dice_coefficient(found, regions[0]) < 0.995
    assert dice_coefficient(found, regions[1]) > 0.999


def test_a_piece_without_any_edge_adds_no_boundary():
    image = image_of(np.zeros_like(BALL))
    star = find_star(image_of(BALL), np.zeros(3))
    whole, part = (region_from_mask(image, mask) for mask in (BALL, BALL | BAY))
    assert with_pieces(image, whole, part, star) is whole


def test_a_large_part_is_no_piece():
    """Whole regions are compared where one of them has missed so much."""
    inside = BALL & ~LARGE
    np.testing.assert_array_equal(decided(image_of(inside), BALL, inside), BALL)


def test_a_slight_difference_is_no_piece():
    slight = BALL & ~lobe([0.0, 0.0, 19.0], 2.5)
    np.testing.assert_array_equal(decided(image_of(slight), BALL, slight), BALL)


def test_tumours_of_a_real_bladder_are_no_part_of_its_lumen(shared_data):
    """With them the Dice coefficient is 0.963."""
    bladder = load_bladder("crop_IM1523", shared_data / "bladder_mri")
    assert dice_coefficient(separate(bladder.image, bladder.seed), bladder.lumen) > 0.967
