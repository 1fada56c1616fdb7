"""Surfaces corrected at boundary points, through the logic: on real nodes, in the world."""

from __future__ import annotations

import mrml_scenes
import numpy as np
import pytest
from mrml_scenes import slicer
from reorientation import motion
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.registration.options import FitOptions

pytestmark = pytest.mark.usefixtures("cached_fits", "grown_regions")

# Asked for: a point 5 mm off the edge pulls the surface to within 0.5 mm of it.
PULLED_MM = 0.5
# The phantom's end of the first half axis, 14 mm to the right of the centre, and a point 5 mm outside of it.
RIGHT = CENTER + [14.0, 0.0, 0.0]
OUTSIDE = CENTER + [19.0, 0.0, 0.0]


@pytest.fixture
def fitted(logic):
    volume = mrml_scenes.add_volume()
    return logic.fit(volume, [CENTER], name="bladder"), volume


def distance(surface, point):
    """Signed distance of a point from a surface, mm."""
    return float(closest_points(surface, np.atleast_2d(point)).distances[0])


def test_three_lines_fit_an_organ_and_correct_it(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], name="bladder")
    assert distance(logic.surface(organ), OUTSIDE) > 4.5
    (deviation,) = logic.refit(organ, [OUTSIDE])
    assert abs(deviation) < PULLED_MM
    assert deviation == pytest.approx(distance(logic.surface(organ), OUTSIDE), abs=1e-6)


def test_far_from_the_point_the_surface_stays(logic, fitted):
    organ, _volume = fitted
    before = logic.surface(organ)
    logic.refit(organ, [OUTSIDE])
    after = logic.surface(organ)
    u, v = (np.linspace(*limits, 40) for limits in after.domain)
    points = after.grid(u, v).reshape(-1, 3)
    moved = np.abs(closest_points(before, points).distances)
    assert moved.max() > 4.0
    # What is away from the point is held where it was; space is deformed within the organ's radius.
    assert moved[np.linalg.norm(points - OUTSIDE, axis=1) > 20.0].max() < 0.15


def test_every_step_of_a_refit_is_told(logic, fitted):
    organ, _volume = fitted
    steps = []
    logic.refit(organ, [OUTSIDE], onStep=steps.append)
    assert organ.convergence.GetTable().GetNumberOfRows() == len(steps) > 0
    assert organ.state.value in ("fitted", "unsettled")


def test_a_fit_goes_through_the_boundary_points_it_is_given(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], boundaryPoints=[OUTSIDE])
    assert abs(distance(logic.surface(organ), OUTSIDE)) < PULLED_MM
    assert organ.boundaryPoints.GetNumberOfControlPoints() == 1


def test_removing_the_point_and_fitting_again_undoes_it(logic, fitted):
    organ, _volume = fitted
    before = logic.surface(organ)
    logic.refit(organ, [OUTSIDE])
    organ.boundaryPoints.RemoveAllControlPoints()
    assert len(logic.refit(organ)) == 0
    assert distance(logic.surface(organ), RIGHT) == pytest.approx(distance(before, RIGHT), abs=0.2)


def test_without_weight_points_pull_nothing(logic, fitted):
    organ, _volume = fitted
    organ.boundaryWeight = 0.0
    (deviation,) = logic.refit(organ, [OUTSIDE])
    assert deviation == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
def test_boundary_points_are_in_the_world(logic, kind):
    matrix, spline = motion(75, (1, 2, -1), (30, -60, 12)), mrml_scenes.thin_plate_spline()
    if kind == "linear":
        under = mrml_scenes.add_linear_transform(matrix)
        to_world = lambda points: np.atleast_2d(points) @ matrix[:3, :3].T + matrix[:3, 3]  # noqa: E731
    else:
        under = mrml_scenes.add_nonlinear_transform(spline)
        to_world = lambda points: mrml_scenes.through(spline, points)  # noqa: E731
    organ = logic.fit(mrml_scenes.add_volume(under=under), to_world(CENTER))
    (deviation,) = logic.refit(organ, to_world(OUTSIDE))
    assert abs(deviation) < PULLED_MM
    shown = mrml_scenes.hardened_points(organ.surface)
    assert np.linalg.norm(shown - to_world(OUTSIDE), axis=1).min() < 1.5
    assert abs(distance(logic.surface(organ), OUTSIDE)) < PULLED_MM


def test_deviations_are_positive_outside_and_stand_beside_the_points(logic, fitted):
    from VICRegistrationLib.mrml.fitting import boundaryDeviations

    organ, volume = fitted
    for point in (OUTSIDE, CENTER + [9.0, 0.0, 0.0]):
        organ.boundaryPoints.AddControlPointWorld(*point)
    outside, inside = boundaryDeviations(organ, volume)
    assert outside == pytest.approx(5.0, abs=0.5)
    assert inside == pytest.approx(-5.0, abs=0.5)
    labels = [organ.boundaryPoints.GetNthControlPointLabel(index) for index in range(2)]
    assert labels == [f"{outside:+.2f} mm", f"{inside:+.2f} mm"]


def test_points_of_a_list_are_boundary_points_too(logic, fitted, scene):
    organ, _volume = fitted
    markups = scene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", "mine")
    markups.AddControlPointWorld(*OUTSIDE)
    (deviation,) = logic.refit(organ, markups)
    assert abs(deviation) < PULLED_MM


def test_a_surface_of_another_program_is_a_start(logic):
    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER])
    shifted = ellipsoid().transformed(motion(0, (1, 0, 0), (1.5, -1.0, 1.0)))
    logic.setSurface(organ, shifted)
    np.testing.assert_array_equal(logic.surface(organ).control_net, shifted.control_net)
    logic.refit(organ)
    points = slicer.util.arrayFromModelPoints(organ.surface)
    # It has moved from where it was put to the edge.
    assert np.abs(closest_points(ellipsoid(), points[::5]).distances).mean() < 0.3
    assert organ.surface.GetName() == "organ surface"


def test_a_refit_without_a_surface_is_refused(logic):
    organ = logic.addOrgan(mrml_scenes.add_volume(), [CENTER], name="bladder")
    with pytest.raises(ValueError, match="bladder has no surface yet.*Fit it first"):
        logic.refit(organ)
    assert organ.surface is None


def test_boundary_points_of_another_organ_are_refused_and_change_nothing(logic, fitted):
    organ, _volume = fitted
    net = logic.surface(organ).control_net
    with pytest.raises(ValueError, match="mm"):
        logic.refit(organ, [CENTER + 200.0])
    np.testing.assert_array_equal(logic.surface(organ).control_net, net)


def test_an_organ_is_corrected_in_the_volume_it_was_separated_in(logic, fitted):
    organ, volume = fitted
    empty = mrml_scenes.add_volume(name="empty")
    slicer.util.arrayFromVolume(empty)[:] = 0
    logic.getParameterNode().volume = empty
    (deviation,) = logic.refit(organ, [OUTSIDE])
    assert abs(deviation) < PULLED_MM
    assert organ.regions.GetNodeReference("referenceImageGeometryRef") is volume


def test_a_surface_fitted_as_published_can_be_corrected(logic):
    organ = logic.fit(mrml_scenes.add_volume(), [CENTER], options=FitOptions.as_published())
    (deviation,) = logic.refit(organ, [OUTSIDE])
    assert abs(deviation) < PULLED_MM
