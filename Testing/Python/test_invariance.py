"""The same organ however the volume lies in memory and in the world."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from reorientation import ORIENTATIONS, motion, reordered

from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish

ORGANS = ("bladder", "vagina", "rectum")
# Asked for: 1e-3 mm for axes in another order and 0.02 mm for rotations. Measured: 1e-11 mm, because everything happens
# in the frame of the organ's own axes; the bound leaves room for other orders of summation.
CLOSE_MM = 1e-6
# Cheaper than the finer net that these organs get by default.
NET = FitOptions(net=(9, 7))


@pytest.fixture(scope="module")
def slab(pelvis):
    """The part of the demo's volume around its organs: thick slices, noise, oblique to the world."""
    return pelvis.image.crop((0, 130, 130), (28, 380, 390))


@pytest.fixture(scope="module")
def surfaces(slab, pelvis):
    """Fitted surfaces in the volume as it is."""
    return {name: finish(fit_organ(slab, pelvis.seeds[name])).surface for name in ORGANS}


def test_both_hands_and_all_orders_are_tried(slab):
    hands = [np.sign(np.linalg.det(reordered(slab, *way).ijk_to_ras[:3, :3])) for way in ORIENTATIONS]
    assert set(hands) == {-1.0, 1.0}
    assert {flips for _, flips in ORIENTATIONS} == set(itertools.product((False, True), repeat=3))


@pytest.mark.parametrize("organ", ORGANS)
def test_axes_permuted_and_flipped_give_the_same_surface(slab, pelvis, surfaces, organ):
    expected = finish(fit_organ(slab, pelvis.seeds[organ], NET)).surface
    # Each organ in a third of the ways; the first with the net that is chosen.
    for number, (order, flips) in enumerate(ORIENTATIONS[ORGANS.index(organ) :: 3]):
        chosen = number == 0
        found = finish(fit_organ(reordered(slab, order, flips), pelvis.seeds[organ], None if chosen else NET)).surface
        difference = np.abs(found.control_net - (surfaces[organ] if chosen else expected).control_net).max()
        assert difference < CLOSE_MM, (order, flips)


def in_turn(ways):
    """Each way with each organ; all organs but one are left to the long tests, another one each time."""
    return [
        pytest.param(organ, *way, marks=() if (number - place) % len(ORGANS) == 0 else pytest.mark.long)
        for number, way in enumerate(ways)
        for place, organ in enumerate(ORGANS)
    ]


@pytest.mark.parametrize(
    ("organ", "degrees", "axis", "shift"),
    in_turn(
        [
            (5.0, (1, 0, 0), (0, 0, 0)),
            (40.0, (1, 2, -1), (10, 0, 0)),
            (45.0, (0, 1, 0), (0, 0, 0)),
            (93.7, (0, 0, 1), (0, 50, 0)),
            (137.0, (3, -1, 2), (500, -800, 1200)),
            (180.0, (1, 1, 0), (0, 0, 0)),
        ]
    ),
)
def test_a_volume_turned_in_the_world_gives_the_turned_surface(slab, pelvis, surfaces, organ, degrees, axis, shift):
    matrix = motion(degrees, axis, shift)
    image = Image(slab.array, matrix @ slab.ijk_to_ras)
    seeds = pelvis.seeds[organ] @ matrix[:3, :3].T + matrix[:3, 3]
    found = finish(fit_organ(image, seeds)).surface
    expected = surfaces[organ].transformed(matrix)
    assert np.abs(found.control_net - expected.control_net).max() < CLOSE_MM
    # The shape itself, whatever its control net.
    distances = closest_points(expected, points_on(found, 300)).distances
    assert np.abs(distances).max() < 0.02


@pytest.mark.parametrize(
    "options", [FitOptions(solver="gradient-descent", net=(9, 7)), FitOptions(closure="paper", net=(12, 9))]
)
def test_other_options_keep_the_invariance(slab, pelvis, options):
    matrix = motion(71.0, (1, 1, 1), (-30, 20, 5))
    turned = Image(slab.array, matrix @ slab.ijk_to_ras)
    turned = reordered(turned, (2, 0, 1), (True, False, False))
    seeds = pelvis.seeds["vagina"] @ matrix[:3, :3].T + matrix[:3, 3]
    expected = finish(fit_organ(slab, pelvis.seeds["vagina"], options)).surface.transformed(matrix)
    found = finish(fit_organ(turned, seeds, options)).surface
    assert np.abs(found.control_net - expected.control_net).max() < 1e-3
