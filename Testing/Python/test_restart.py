"""Boundary points that a failed start contradicts: the organ is separated again through them."""

from __future__ import annotations

import numpy as np
import pytest
from boundaries import off
from small_phantom import CENTER, ellipsoid
from tubes import RADIUS_MM, bent_tube

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.region import dice_coefficient, region_from_mask
from VICRegistrationLib.registration.boundary_points import boundary_deviations
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.restart import separated_through
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.shaped_region import shaped_region


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


@pytest.fixture(scope="module")
def fit(small_coarse_fit):
    return small_coarse_fit


def through(image, surface, points, **options):
    """Correct a surface, and return the fit and whether the organ was separated again."""
    found = finish(refit(image, surface, FitOptions(**options), boundary_points=points))
    codes = [] if found.region is None else [diagnostic.code for diagnostic in found.region.diagnostics]
    return found, "start_contradicted" in codes


def moved(surface, scale, offset):
    """Scale a surface about the phantom's centre, and move it, mm."""
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = CENTER + offset - scale * CENTER
    return surface.transformed(matrix)


def test_one_point_is_enough_where_a_fragment_was_fitted(image, fit):
    fragment = moved(fit.surface, 0.15, [0.0, 0.0, -16.0])
    wall = points_on(ellipsoid(), 400)
    away = np.abs(closest_points(fragment, wall).distances)
    # Farther than any point by which a surface alone is corrected.
    assert away.max() > 30.0
    found, again = through(image, fragment, wall[away.argmax()][None], threshold=(790.0, 830.0))
    assert again
    assert found.problems == ()
    assert deviation(found.surface, ellipsoid(), n_points=500).mean < 0.3
    assert np.abs(boundary_deviations(found.surface, found.boundary_points)).max() < 0.5
    # The threshold that the point contradicts is not used again, and the point can still be removed.
    assert found.options.threshold[0] < 700.0
    np.testing.assert_array_equal(found.uncorrected.control_net, fragment.control_net)
    stages = [step.stage for step in found.history]
    assert stages[0] == "through the points, global scaling"
    assert stages[-1] == "boundary points"


def test_one_point_is_enough_where_most_of_the_surface_is_outside_of_the_organ(image, fit):
    beside = moved(fit.surface, 1.0, [0.0, 16.0, 0.0])
    wall = points_on(ellipsoid(), 400)
    assert (closest_points(fit.surface, beside.points(*beside.midpoints(16, 16))).distances > 2.0).mean() > 0.5
    found, again = through(image, beside, wall[np.abs(closest_points(beside, wall).distances).argmax()][None])
    assert again
    assert deviation(found.surface, ellipsoid(), n_points=500).mean < 0.3


def test_points_that_are_a_little_off_do_not_change_the_region(image, fit):
    """The region of the surface through them has a lobe or a dent at each."""
    fragment = moved(fit.surface, 0.15, [0.0, 0.0, -16.0])
    points = off(fit.surface, [(0.0, 0.3), (0.5, 0.5), (0.2, 0.8)], [6.0, -6.0, 6.0])
    restart = separated_through(image, fragment, points, np.abs(closest_points(fragment, points).distances))
    automatic = separate(image, CENTER)
    assert dice_coefficient(restart.region, automatic) > 0.999
    assert dice_coefficient(shaped_region(image, restart.through, CENTER), automatic) < 0.99


def test_the_region_is_that_of_a_surface_through_the_points_if_they_contradict_the_automatic_one(image, fit):
    fragment = moved(fit.surface, 0.15, [0.0, 0.0, -16.0])
    point = off(fit.surface, [(0.0, 0.3)], [15.0])
    restart = separated_through(image, fragment, point, np.abs(closest_points(fragment, point).distances))
    assert dice_coefficient(restart.region, separate(image, CENTER)) < 0.99


def test_one_point_is_enough_where_half_of_a_bent_organ_was_fitted():
    """No star-shaped surface passes a point around the bend."""
    tube = bent_tube(140.0)
    half = tube.mask.copy()
    half[:, :, : half.shape[2] // 2] = False
    part = finish(fit_region(tube.image, region_from_mask(tube.image, half), FitOptions(net=(9, 7)))).surface
    outward = tube.axis[0] - tube.axis[5]
    tip = tube.axis[0] + RADIUS_MM * outward / np.linalg.norm(outward)
    assert np.abs(closest_points(part, tip[None]).distances[0]) > 30.0
    found, again = through(tube.image, part, tip[None])
    assert again
    assert found.problems == ()
    assert tube.errors(found.surface).mean() < 0.3
    assert np.abs(boundary_deviations(found.surface, tip[None])).max() < 0.5


def test_a_point_off_a_right_surface_corrects_that_alone(image, fit):
    point = off(fit.surface, [(0.3, 0.45)], [12.0])
    found, again = through(image, fit.surface, point)
    assert not again
    assert found.problems == ()
    assert abs(boundary_deviations(found.surface, point)[0]) < 0.3


def test_another_organ_is_not_meant(pelvis, pelvis_fit):
    # The star-shaped surface through a point of the bladder's wall is the bladder, which holds nothing of the vagina.
    vagina = pelvis_fit("vagina")
    point = off(vagina.surface, [(0.0, 0.5)], [35.0])
    with pytest.raises(ValueError, match="Boundary point 1 .* is 35 mm from the surface"):
        through(pelvis.image, vagina.surface, point)


def test_a_surface_as_far_from_the_points_is_not_taken(pelvis, pelvis_fit):
    rectum = pelvis_fit("rectum")
    _, again = through(pelvis.image, rectum.surface, off(rectum.surface, [(0.61, 0.2)], [-12.0]))
    assert not again
