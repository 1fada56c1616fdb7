"""The same organ however the volume lies in memory and in the world."""

from __future__ import annotations

import numpy as np
import pytest
from reorientation import ORIENTATIONS, motion, reordered
from small_phantom import CENTER
from stack_phantom import dented, stack_of

from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ
from VICRegistrationLib.registration.steps import finish

# Asked for: 1e-3 mm for axes in another order and 0.02 mm for rotations. Measured: 1e-11 mm, because everything happens
# in the frame of the organ's own axes; the bound leaves room for other orders of summation.
CLOSE_MM = 1e-6
SEEDS = CENTER[None]
# Cheaper than the finer net that this organ gets by default.
NET = FitOptions(net=(9, 7))
# Axes of the world and axes between them, and a shift far away.
TURNS = [motion(93.7, (0, 0, 1), (0, 50, 0)), motion(137.0, (3, -1, 2), (500, -800, 1200))]


@pytest.fixture(scope="module")
def image():
    """A small organ without symmetry, in thick slices and noise; in its voxels no distance is a round number of mm."""
    return stack_of(dented(), "sagittal", spacing=(1.17, 1.17, 3.9))


@pytest.fixture(scope="module")
def surface(image):
    """Its surface in the volume as it is."""
    return finish(fit_organ(image, SEEDS, NET)).surface


def moved(image, seeds, matrix, way):
    """The image and its seeds elsewhere in the world and with other axes in memory."""
    turned = Image(image.array, matrix @ image.ijk_to_ras)
    return reordered(turned, *way), seeds @ matrix[:3, :3].T + matrix[:3, 3]


def difference(found, expected):
    return np.abs(found.control_net - expected.control_net).max()


# In test_separation other orders of axes in memory give the same voxels.
@pytest.mark.parametrize(("matrix", "way"), list(zip(TURNS, ORIENTATIONS[8::3])))
def test_a_volume_turned_in_the_world_and_in_memory_gives_the_turned_surface(image, surface, matrix, way):
    found = finish(fit_organ(*moved(image, SEEDS, matrix, way), NET)).surface
    expected = surface.transformed(matrix)
    assert difference(found, expected) < CLOSE_MM
    # The shape itself, whatever its control net.
    assert np.abs(closest_points(expected, points_on(found, 300)).distances).max() < 0.02


def test_an_organ_of_the_demo_elsewhere_has_the_same_surface_by_default(pelvis, pelvis_fit):
    image, seeds = moved(pelvis.image, pelvis.seeds["rectum"], TURNS[1], ORIENTATIONS[8])
    found = finish(fit_organ(image, seeds)).surface
    assert difference(found, pelvis_fit("rectum").surface.transformed(TURNS[1])) < CLOSE_MM


@pytest.mark.parametrize(
    "options", [FitOptions(solver="gradient-descent", net=(9, 7)), FitOptions(closure="paper", net=(12, 9))]
)
def test_other_options_keep_the_invariance(image, options):
    matrix = motion(71.0, (1, 1, 1), (-30, 20, 5))
    expected = finish(fit_organ(image, SEEDS, options)).surface.transformed(matrix)
    turned, seeds = moved(image, SEEDS, matrix, ((2, 0, 1), (True, False, False)))
    assert difference(finish(fit_organ(turned, seeds, options)).surface, expected) < 1e-3
