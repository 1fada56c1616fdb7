"""Boundary points that a failed start contradicts: the organ is separated again through them."""

from __future__ import annotations

import numpy as np
import pytest
from boundaries import off
from small_phantom import CENTER, ellipsoid
from tubes import RADIUS_MM, bent_tube

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import dice_coefficient, region_from_mask
from VICRegistrationLib.registration.boundary_points import boundary_deviations
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.restart import Restart, separated_through
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate
from VICRegistrationLib.segmentation.shaped_region import shaped_region
from VICRegistrationLib.segmentation.star_surface import find_star


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


def image_of_balls(*balls):
    """Image of bright balls, each with its centre and radius, mm, and its level, in tissue of a level of 50."""
    places = 2.0 * np.stack(np.meshgrid(*map(np.arange, (30, 30, 50)), indexing="ij"), axis=-1)[..., ::-1]
    levels = np.full(places.shape[:3], 50.0)
    for center, radius, level in balls:
        levels[np.linalg.norm(places - center, axis=-1) < radius] = level
    noise = np.random.default_rng(0).normal(0.0, 3.0, levels.shape)
    return Image(levels + noise, np.diag([2.0, 2.0, 2.0, 1.0]))


def test_another_organ_is_not_meant():
    # No surface around the first ball passes the far wall of the second one.
    first, second = np.array([25.0, 29.0, 29.0]), np.array([65.0, 29.0, 29.0])
    image = image_of_balls((first, 12.0, 200.0), (second, 12.0, 200.0))
    surface = finish(fit_organ(image, first, FitOptions(net=(9, 7)))).surface
    with pytest.raises(ValueError, match="Boundary point 1 .* is 40 mm from the surface"):
        through(image, surface, second[None] + [12.0, 0.0, 0.0])


def test_a_surface_with_faint_edges_does_not_replace_one_with_clear_edges():
    # A bright clot in the urine: a point on its boundary is far from the organ's wall.
    center = np.array([49.0, 29.0, 29.0])
    image = image_of_balls((center, 24.0, 200.0), (center, 12.0, 230.0))
    wall, clot = (closed_organ(axes=radius * np.eye(3), center=center) for radius in (24.0, 12.0))
    star = find_star(image, center)
    restart = Restart(shaped_region(image, star, center), star)
    on_wall, on_clot = (center[None] + [radius, 0.0, 0.0] for radius in (24.0, 12.0))
    assert restart.replaces(image, wall, clot, on_wall, np.array([12.0]))
    assert not restart.replaces(image, clot, wall, on_clot, np.array([12.0]))
    assert not restart.replaces(image, wall, clot, on_clot, np.array([12.0]))
