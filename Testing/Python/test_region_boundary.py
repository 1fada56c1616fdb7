"""The boundary of a region as points that are to lie on the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_region_image import ball_region, frame

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.moments import moments
from VICRegistrationLib.imaging.region import Region, region_from_mask
from VICRegistrationLib.registration.nets import sampled
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.region_boundary import BoundaryCost
from VICRegistrationLib.registration.region_image import region_image
from VICRegistrationLib.registration.schedule import Schedule
from VICRegistrationLib.registration.stages import Step, last_step
from VICRegistrationLib.registration.steps import finish

SPACING_MM = 1.5
RADIUS_MM = 25.0
# A rod of this radius goes from the surface of the ball to its centre.
ROD_MM = 6.0
# Voxel coordinate of the ball's centre along each axis.
MIDDLE = 24.5


def ball_with_dent() -> tuple[Image, Region]:
    """Voxels of a ball that a rod enters, as a papillary tumour does, which makes a dent that is deeper than wide."""
    image = Image(np.zeros((50, 50, 50)), np.diag([SPACING_MM] * 3 + [1.0]))
    k, j, i = SPACING_MM * (np.indices((50, 50, 50)) - MIDDLE)
    inside = (i**2 + j**2 + k**2 < RADIUS_MM**2) & ~((i**2 + j**2 < ROD_MM**2) & (k > 0.0))
    return Image(np.where(inside, 100.0, 0.0), image.ijk_to_ras), region_from_mask(image, inside)


def on_region(*, boundary: bool) -> tuple[Step, np.ndarray, np.ndarray]:
    """Fit to the region alone with 17x11 control points.

    Returns the last step, points of the region's boundary, and those of them on the floor of the dent.
    """
    image, region = ball_with_dent()
    pose = moments(region)
    schedule = Schedule.of_region(image, region, pose, FitOptions(net=(17, 11)))
    points, _ = schedule.region.boundary
    stage = schedule.on_region if boundary else replace(schedule.on_region, boundary=None)
    ball = sampled(closed_organ((17, 11), axes=np.eye(3) * RADIUS_MM), "smooth")
    center = (SPACING_MM * np.full(3, MIDDLE) - pose.center) @ pose.axes.T
    floor = points[np.linalg.norm(points - center, axis=1) < 0.5 * ROD_MM]
    return finish(last_step(stage, ball)), points, floor


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.6, 0.6, 3.0)])
def test_boundary_points_lie_on_the_boundary_evenly(spacing):
    image = region_image(ball_region(spacing), frame(), margin=8.0)
    (points, areas), step = image.boundary, image.distance.spacing[0]
    assert areas @ np.linalg.norm(points, axis=1) / areas.sum() == pytest.approx(15.0, abs=0.15 * step)
    assert step**2 * areas.sum() == pytest.approx(4.0 * np.pi * 15.0**2, rel=0.12)
    np.testing.assert_allclose(areas @ points / areas.sum(), 0.0, atol=0.1 * step + 0.05 * max(spacing))
    # The same area in each direction.
    spread = (areas * (points / 15.0).T ** 2).sum(axis=1) / areas.sum()
    np.testing.assert_allclose(spread, 1.0 / 3.0, atol=0.03)


def test_the_derivatives_are_those_of_the_cost():
    organ = sampled(closed_organ((9, 7), axes=np.diag([15.0, 11.0, 20.0])), "smooth")
    rng = np.random.default_rng(3)
    points = rng.normal(size=(300, 3)) * [15.0, 11.0, 20.0] / 1.5
    cost = BoundaryCost(points, rng.uniform(0.5, 1.0, 300), organ, unit=40.0, accuracy=1.0)
    q = 0.5 * rng.normal(size=organ.n_dof)
    cost.refresh(q)
    samples, direction = cost.sample(q), rng.normal(size=organ.n_dof)
    there, back = (cost.sample(q + step * direction).cost for step in (1e-3, -1e-3))
    assert 2.0 * cost.gradient(samples) @ direction == pytest.approx((there - back) / 2e-3, rel=1e-6)
    # The cost is a quadratic function until it is refreshed.
    curvature = (there - 2.0 * samples.cost + back) / 1e-6
    assert 2.0 * direction @ (cost.hessian(samples) @ direction) == pytest.approx(curvature, rel=1e-3)


def test_the_cost_is_the_mean_squared_distance():
    ball = sampled(closed_organ((9, 7), axes=np.eye(3) * 20.0), "smooth")
    directions = np.random.default_rng(1).normal(size=(200, 3))
    points = 23.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    cost = BoundaryCost(points, np.ones(200), ball, unit=2.0, accuracy=1e-3)
    q = np.zeros(ball.n_dof)
    cost.refresh(q)
    assert cost.sample(q).cost == pytest.approx((3.0 / 2.0) ** 2, rel=0.1)


def test_the_surface_follows_a_dent_that_is_deeper_than_wide():
    with_boundary, points, floor = on_region(boundary=True)
    without, _, _ = on_region(boundary=False)
    assert len(floor)
    away = [np.abs(closest_points(step.surface, points).distances).mean() for step in (with_boundary, without)]
    assert away[0] < 0.6 * away[1]
    # Without the points the surface bridges the dent, which is 25 mm deep.
    below = [np.abs(closest_points(step.surface, floor).distances).mean() for step in (with_boundary, without)]
    assert below[0] < 1.0
    assert below[1] > 20.0
