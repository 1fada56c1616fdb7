"""Boundary points that a failed start contradicts: the organ is separated again through them."""

from __future__ import annotations

import numpy as np
import pytest
from boundaries import off
from small_phantom import CENTER, ellipsoid
from tubes import RADIUS_MM, bent_tube

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration.boundary_points import boundary_deviations
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.steps import finish


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


def test_one_point_is_enough_where_a_fragment_was_fitted(image, fit):
    matrix = np.diag([0.15, 0.15, 0.15, 1.0])
    matrix[:3, 3] = CENTER + [0.0, 0.0, -16.0] - matrix[:3, :3] @ CENTER
    fragment = fit.surface.transformed(matrix)
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


def test_a_surface_that_is_like_the_one_before_away_from_the_points_is_needed(pelvis, pelvis_fit):
    # Nearer to the point because both ends of the bent organ are cut.
    rectum = pelvis_fit("rectum")
    _, again = through(pelvis.image, rectum.surface, off(rectum.surface, [(0.61, 0.2)], [-12.0]))
    assert not again
