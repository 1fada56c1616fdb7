"""Boundary points: the surface goes to where a doctor says the wall is, and stays where it was elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from boundaries import HEIGHT_MM, PLACES, moved, off, pull
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry.models import bell, closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.meshing.sizes import curvatures
from VICRegistrationLib.registration.boundary_points import (
    LARGEST_LEFT_MM,
    boundary_deviations,
    checked_boundary_points,
)
from VICRegistrationLib.registration.correction import correct
from VICRegistrationLib.registration.nets import closure_of, net_of, refined
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.refit import refit
from VICRegistrationLib.registration.steps import finish

SEED = CENTER[None]


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


@pytest.fixture(scope="module")
def fit(small_coarse_fit):
    return small_coarse_fit


@pytest.fixture(scope="module")
def bladder(pelvis):
    """The demo's bladder, 9x7 net, 132 ml."""
    return finish(fit_organ(pelvis.image, pelvis.seeds["bladder"], FitOptions(net=(9, 7))))


def corrected(image, fit, points, **options):
    return finish(refit(image, fit.surface, replace(fit.options, **options), boundary_points=points))


@pytest.fixture(scope="module")
def raised(fit):
    """A point 5 mm outside of the fitted surface."""
    return off(fit.surface, [(0.3, 0.45)], [5.0])


@pytest.fixture(scope="module")
def pulled(image, fit, raised):
    """The fit, corrected to go through that point."""
    return corrected(image, fit, raised)


@pytest.fixture(scope="module")
def pull_bladder(pelvis, bladder):
    """Function that corrects the demo's bladder with one point over a place of its surface, each once."""
    return cache(lambda place, height: pull(pelvis.image, bladder, place, height))


# ------------------------------------------------------------------ what is asked for


@pytest.mark.parametrize(("place", "height"), [(PLACES[0], -HEIGHT_MM), *((place, HEIGHT_MM) for place in PLACES[::2])])
def test_a_point_5_mm_off_the_edge_is_met_without_ringing(pull_bladder, place, height):
    result = pull_bladder(place, height)
    # Asked for: 0.5 mm. The benchmark's case `boundary` prints at most 0.09 mm for 62 points.
    assert result.left < 0.2
    # Asked for: less than 10 % of 5 mm to the other side. At most 0.16 mm, where the grey levels ask for it.
    assert result.opposite < 0.4
    # Asked for: 0.25 mm beyond half the radius of the organ, 15.8 mm. At most 0.16 mm.
    assert result.far < 0.25
    assert not result.elsewhere
    assert result.found.converged
    assert result.found.problems == ()


def test_a_point_5_mm_outside_makes_a_blunt_bulge(pelvis, pelvis_fit):
    point = np.array([[-2.5, 61.0, 19.5]])
    surface = corrected(pelvis.image, pelvis_fit("bladder"), point).surface
    foot = closest_points(surface, point).parameters.T
    # Asked for: a wall bends with radii of 5 mm and more. Measured: 4.98 mm; with half the bending energy 4.5 mm.
    assert 1.0 / np.abs(curvatures(surface, *foot)).max() > 4.9


def test_in_a_thin_organ_a_point_corrects_the_wall_that_is_nearest(pelvis, pelvis_fit):
    vagina = pelvis_fit("vagina")
    # At its rim: the wall in front or behind is nearer to a point 5 mm inside.
    result = pull(pelvis.image, vagina, (0.61, 0.2), -HEIGHT_MM)
    assert result.elsewhere
    assert result.left < 0.2
    assert result.opposite < 0.4
    assert result.far < 0.25
    assert result.found.problems == ()


def test_beyond_the_points_surroundings_nothing_moves(bladder, pull_bladder):
    found = pull_bladder(PLACES[0], HEIGHT_MM).found
    points, heights = moved(bladder.surface, found.surface)
    far = np.linalg.norm(points - off(bladder.surface, PLACES[:1], [0.0]), axis=1) > 40.0
    assert far.sum() > 1000
    # Space is deformed within 31 mm; what is held beyond stays.
    assert np.abs(heights[far]).max() < 0.05


def test_points_on_the_true_wall_bring_the_surface_nearer_to_it(pelvis, bladder):
    truth = pelvis.surfaces["bladder"]
    wall = points_on(truth, 40)
    found = corrected(pelvis.image, bladder, wall)
    assert np.abs(boundary_deviations(found.surface, wall)).max() < 0.1
    before, after = (deviation(fit.surface, truth, n_points=1500).mean for fit in (bladder, found))
    # Measured: 0.15 to 0.09 mm. What is left lies between the points.
    assert after < 0.75 * before


@pytest.mark.parametrize(
    "options", [{"closure": "paper", "net": (17, 13)}, {"profile": "paper", "levels": "organ", "net": (9, 7)}]
)
def test_points_are_met_with_every_option(image, options):
    fit = finish(fit_organ(image, SEED, FitOptions(**options)))
    points = off(fit.surface, PLACES[::2], [3.0, -3.0, 3.0])
    found = corrected(image, fit, points)
    assert np.abs(boundary_deviations(found.surface, points)).max() < 0.3
    assert found.options.closure == fit.options.closure
    assert found.problems == ()


# ------------------------------------------------------------------ several points


def test_points_on_opposite_walls_do_not_disturb_each_other(image, fit):
    points = off(fit.surface, [(0.25, 0.5), (0.75, 0.5)], [5.0, -5.0])
    found = corrected(image, fit, points)
    assert np.abs(boundary_deviations(found.surface, points)).max() < 0.2
    assert found.problems == ()


def test_a_row_of_points_is_met_by_one_smooth_bulge(image, fit):
    places = [(0.25, v) for v in (0.35, 0.43, 0.5, 0.57, 0.65)]
    points = off(fit.surface, places, [2.0, 3.5, 4.0, 3.5, 2.0])
    found = corrected(image, fit, points)
    assert np.abs(boundary_deviations(found.surface, points)).max() < 0.3
    v = np.linspace(0.35, 0.65, 17)
    u = np.full(len(v), 0.25)
    heights = np.einsum("nk,nk->n", found.surface.points(u, v) - fit.surface.points(u, v), fit.surface.normals(u, v))
    # Up and down once, without a dent between any two points.
    assert np.count_nonzero(np.diff(np.sign(np.diff(heights)))) == 1


def test_between_points_that_contradict_each_other_it_goes_through_the_middle(image, fit):
    points = off(fit.surface, [(0.25, 0.5), (0.252, 0.503)], [4.0, 0.0])
    found = corrected(image, fit, points)
    _, heights = moved(fit.surface, found.surface)
    assert heights.max() == pytest.approx(2.0, abs=0.2)
    assert heights.min() > -0.3
    assert found.problems == ()


def test_a_step_of_the_wall_is_met_on_both_sides(image, fit):
    # 2.1 mm apart, and 8 mm in height: steeper than 3 to 1, but on normals of their own.
    points = off(fit.surface, [(0.25, 0.485), (0.25, 0.515)], [4.0, -4.0])
    found = corrected(image, fit, points)
    # Measured: 0.23 mm; 4 mm where they are replaced by their mean.
    assert np.abs(boundary_deviations(found.surface, points)).max() < LARGEST_LEFT_MM
    assert found.problems == ()


def test_points_that_a_net_cannot_follow_are_met_by_a_finer_one(image, fit, pulled):
    points = off(fit.surface, [(0.25, v) for v in (0.45, 0.48, 0.51, 0.54)], [4.0, -4.0, 4.0, -4.0])
    found = corrected(image, fit, points)
    # Measured: 0.02 mm; 1.6 mm with the net for one point.
    assert np.abs(boundary_deviations(found.surface, points)).max() < 0.1
    assert min(found.options.net) > min(pulled.options.net)
    assert found.problems == ()


def test_points_that_only_a_folded_surface_passes_are_left_off(image, fit):
    points = off(fit.surface, [(0.25, v) for v in (0.44, 0.47, 0.5, 0.53)], [10.0, -10.0, 10.0, -10.0])
    found = finish(correct(image, fit.surface, points, fit.options))
    assert check_surface(found) == ()
    # Measured: 1.6 mm with the stiff bending energy. With the soft one 0.03 mm, and the surface passes through itself.
    assert np.abs(boundary_deviations(found, points)).max() < 2.0


def test_a_repeated_point_is_one_point(image, fit):
    point = off(fit.surface, [(0.3, 0.45)], [3.0])
    once, thrice = (corrected(image, fit, np.repeat(point, n, axis=0)) for n in (1, 3))
    assert np.abs(moved(once.surface, thrice.surface)[1]).max() < 0.1


def test_many_points_are_no_burden(image, fit):
    wall = points_on(ellipsoid(), 600)
    found = corrected(image, fit, wall)
    assert np.abs(boundary_deviations(found.surface, wall)).max() < 0.1


def test_a_wall_far_off_is_moved_as_a_whole_and_does_not_fold(image):
    # A shape squeezed to two thirds along one axis: its walls are missed by up to 6 mm.
    start = closed_organ((17, 11), axes=np.diag([0.65 * 14.0, 18.0, 22.0]), center=CENTER)
    truth, points = points_on(ellipsoid(), 400), np.empty((0, 3))
    on_the_right = truth[:, 0] > CENTER[0]
    before = distances = np.abs(closest_points(start, truth).distances)
    for _ in range(5):
        farthest = [np.where(side, distances, 0.0).argmax() for side in (on_the_right, ~on_the_right)]
        points = np.vstack([points, truth[farthest]])
        found = finish(refit(image, start, FitOptions(), boundary_points=points))
        assert found.problems == ()
        assert np.abs(boundary_deviations(found.surface, points)).max() < 0.5
        distances = np.abs(closest_points(found.surface, truth).distances)
    # Measured: 0.42 of it, and 0.61 where the surface is not deformed through the points before the fit.
    assert distances.mean() < 0.45 * before.mean()


# ------------------------------------------------------------------ points that change nothing, or little


def test_a_point_in_agreement_moves_nothing(image, fit):
    found = corrected(image, fit, off(fit.surface, PLACES, np.zeros(len(PLACES))))
    np.testing.assert_array_equal(found.surface.control_net, fit.surface.control_net)
    assert found.options.net == fit.options.net
    assert found.converged


def test_a_point_nearly_in_agreement_moves_hardly_more_than_that(image, fit):
    found = corrected(image, fit, off(fit.surface, [(0.3, 0.45)], [0.1]))
    assert np.abs(moved(fit.surface, found.surface)[1]).max() < 0.12


def test_a_point_that_was_met_stays_met(image, fit, raised, pulled):
    more = np.concatenate([raised, off(fit.surface, [(0.8, 0.5)], [-4.0])])
    twice = finish(refit(image, pulled.surface, fit.options, boundary_points=more))
    assert np.abs(boundary_deviations(twice.surface, more)).max() < 0.2
    points, heights = moved(pulled.surface, twice.surface)
    near = np.linalg.norm(points - off(fit.surface, [(0.3, 0.45)], [0.0]), axis=1) < 8.0
    # Beside the point itself the wall goes to the edge again, between it and the other one.
    assert np.abs(heights[near]).max() < 0.2


def test_with_weight_0_points_have_no_effect(image, fit, raised):
    without = finish(fit_organ(image, SEED, FitOptions(net=(9, 7), boundary_weight=0.0), boundary_points=raised))
    np.testing.assert_array_equal(without.surface.control_net, fit.surface.control_net)
    assert len(without.boundary_points) == 0
    expected, found = (
        finish(refit(image, fit.surface, FitOptions(boundary_weight=0.0), boundary_points=given))
        for given in (None, raised)
    )
    np.testing.assert_array_equal(found.surface.control_net, expected.surface.control_net)


@pytest.mark.parametrize("points", [None, [], np.zeros((0, 3))])
def test_no_points_are_no_points(points):
    assert checked_boundary_points(points).shape == (0, 3)


def test_a_fit_without_points_ends_at_the_grey_levels(image, fit):
    found = finish(fit_organ(image, SEED, FitOptions(net=(9, 7)), boundary_points=[]))
    np.testing.assert_array_equal(found.surface.control_net, fit.surface.control_net)
    assert found.history[-1].stage.startswith("grey levels, fine")
    assert found.uncorrected is found.surface
    assert boundary_deviations(found.surface, []).shape == (0,)


def test_the_weight_shows_how_near_the_surface_comes(image, fit, raised, pulled):
    assert pulled.options.boundary_weight == 1.0
    lower, low, high = (corrected(image, fit, raised, boundary_weight=weight) for weight in (0.01, 0.1, 10.0))
    distances = [boundary_deviations(found.surface, raised)[0] for found in (lower, low, pulled, high)]
    assert distances == sorted(distances, reverse=True)
    # The documented ones; with a weight that small the grey levels win.
    assert distances[0] > 1.2
    assert distances[1] == pytest.approx(0.6, abs=0.3)
    assert distances[2] == pytest.approx(0.1, abs=0.05)
    assert distances[3] < 0.03


# ------------------------------------------------------------------ with the whole fit


def test_a_fit_with_points_is_the_fit_without_and_then_their_pull(image, fit, raised, pulled):
    steps = []
    found = finish(fit_region(image, fit.region, FitOptions(net=(9, 7)), boundary_points=raised), on_step=steps.append)
    np.testing.assert_array_equal(found.uncorrected.control_net, fit.surface.control_net)
    np.testing.assert_allclose(found.surface.control_net, pulled.surface.control_net, atol=1e-9)
    assert list(found.history) == steps
    assert [step.stage for step in steps[: len(fit.history)]] == [step.stage for step in fit.history]
    assert {step.stage for step in steps[len(fit.history) :]} == {"boundary points"}
    np.testing.assert_array_equal(found.boundary_points, raised)
    assert found.cost_initial == pytest.approx(fit.cost_initial)
    # The surface has left the edge in one place, and its cost tells that.
    assert found.cost_final > fit.cost_final


def test_the_finer_net_is_told(pulled):
    rows, columns = pulled.options.net
    assert rows > 9
    assert columns > 7
    assert pulled.surface.control_net.shape == (rows + 2, columns, 3)
    assert closure_of(pulled.surface) == "smooth"


def test_a_point_is_taken_back_by_starting_from_the_uncorrected_surface(image, fit, raised, pulled):
    both = np.concatenate([raised, off(fit.surface, [(0.8, 0.5)], [4.0])])
    found = corrected(image, fit, both)
    left = finish(refit(image, found.uncorrected, fit.options, boundary_points=raised))
    np.testing.assert_array_equal(left.surface.control_net, pulled.surface.control_net)


# ------------------------------------------------------------------ fitting again without points


@pytest.mark.parametrize("options", [{}, {"closure": "paper", "net": (12, 9)}])
def test_a_surface_beside_the_edge_is_brought_to_it(image, options):
    fit = finish(fit_organ(image, SEED, FitOptions(**options)))
    matrix = np.eye(4)
    matrix[:3, 3] = [1.0, -1.0, 0.7]
    found = finish(refit(image, fit.surface.transformed(matrix), FitOptions()))
    assert deviation(found.surface, ellipsoid(), n_points=1000).mean < 0.2
    assert found.options.net == fit.options.net
    assert found.options.closure == fit.options.closure
    assert list(dict.fromkeys(step.stage for step in found.history)) == [
        "grey levels, first look",
        "grey levels, coarse",
        "grey levels, fine",
    ]
    assert found.cost_initial > 1.5 * found.cost_final
    assert found.converged


def test_a_surface_at_the_edge_stays(image, fit):
    found = finish(refit(image, fit.surface, fit.options))
    distances = np.abs(closest_points(fit.surface, points_on(found.surface, 500)).distances)
    # Fits of the small phantom in voxels of 3 mm; the benchmark prints 0.02 to 0.05 mm for organs.
    assert distances.mean() < 0.07
    assert distances.max() < 0.3
    # It is held where it lies, not where a stage has brought it before.
    assert list(dict.fromkeys(step.stage for step in found.history)) == ["grey levels, first look", "grey levels, fine"]
    assert {choice.option for choice in found.choices} == {"tau", "smoothness"}


def test_the_region_is_handed_on(image, fit):
    assert finish(refit(image, fit.surface)).region is None
    found = finish(refit(image, fit.surface, region=fit.region))
    assert found.region is fit.region
    assert found.options.threshold == fit.region.threshold


def test_a_refit_can_be_left_between_any_two_steps(image, fit, raised, pulled):
    for count in (0, 1, len(pulled.history) - 1):
        steps = refit(image, fit.surface, fit.options, boundary_points=raised)
        for expected in pulled.history[:count]:
            np.testing.assert_array_equal(next(steps).surface.control_net, expected.surface.control_net)
        steps.close()


# ------------------------------------------------------------------ deviations


def test_deviations_are_positive_outside():
    outside, inside, on = CENTER + [[17.0, 0, 0], [0, 12.0, 0], [0, 0, 22.0]]
    # The generic model is within 0.1 mm of the ellipsoid.
    found = boundary_deviations(ellipsoid(), [outside, inside, on])
    np.testing.assert_allclose(found, [3.0, -6.0, 0.0], atol=0.1)


# ------------------------------------------------------------------ what cannot be used


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([1.0, 2.0, 3.0], r"Boundary points of shape \(3,\) were given; \(n, 3\) RAS coordinates in mm are needed"),
        (np.zeros((2, 2)), r"Boundary points of shape \(2, 2\) were given"),
        (np.zeros((1, 2, 3)), r"Boundary points of shape \(1, 2, 3\) were given"),
        (
            [[0.0, 0.0, 0.0], [1.0, np.nan, 0.0]],
            r"Boundary point 2 is \[1.0, nan, 0.0\]; RAS coordinates of a patient, mm, are",
        ),
        ([[np.inf, 0.0, 0.0]], "Boundary point 1 is"),
        ([[0.0, -1e308, 0.0]], r"Boundary point 1 is \[0.0, -1e\+308, 0.0\]"),
        ([["a", "b", "c"]], "The boundary points .* are not .* numbers; give RAS coordinates in mm"),
        ([[0.0, 0.0], [0.0, 0.0, 0.0]], "The boundary points .* are not .* numbers"),
    ],
)
def test_points_that_are_none_are_refused_at_the_first_step(image, fit, points, message):
    for steps in (
        fit_organ(image, SEED, FitOptions(net=(9, 7)), boundary_points=points),
        fit_region(image, fit.region, boundary_points=points),
        refit(image, fit.surface, boundary_points=points),
    ):
        with pytest.raises(ValueError, match=message):
            next(steps)
    with pytest.raises(ValueError, match=message):
        boundary_deviations(fit.surface, points)


def test_a_point_far_away_is_refused(image, fit):
    points = np.concatenate([off(fit.surface, [(0.3, 0.45)], [2.0]), [CENTER + [60.0, 0.0, 0.0]]])
    message = r"Boundary point 2 at \(48.0, 8.0, -20.0\) mm is 46 mm from the surface; those within 30 mm correct it"
    with pytest.raises(ValueError, match=message):
        finish(refit(image, fit.surface, boundary_points=points))


def test_a_surface_that_is_no_closed_organ_is_refused(image):
    with pytest.raises(ValueError, match="a closed organ needs both"):
        next(refit(image, bell(30.0, center=CENTER)))


def test_a_surface_outside_of_the_volume_is_refused(image, fit):
    matrix = np.eye(4)
    matrix[:3, 3] = 500.0
    with pytest.raises(ValueError, match="outside of the volume; choose the volume that it was fitted in"):
        next(refit(image, fit.surface.transformed(matrix)))


# ------------------------------------------------------------------ nets


@pytest.mark.parametrize("closure", ["smooth", "paper"])
def test_a_finer_net_is_the_same_surface_and_the_same_closure(closure):
    coarse = closed_organ((9, 7), closure=closure, axes=np.diag([14.0, 18.0, 22.0]))
    fine = refined(coarse, 4.0, closure=closure)
    u, v = (part.ravel() for part in np.meshgrid(np.linspace(0, 1, 23), np.linspace(0, 1, 17)))
    np.testing.assert_allclose(fine.points(u, v), coarse.points(u, v), atol=1e-12)
    assert closure_of(fine) == closure_of(coarse) == closure
    assert net_of(coarse, closure) == (9, 7)
    assert min(net_of(fine, closure)) > 16
    assert refined(fine, 4.0, closure=closure) is fine
    assert max(net_of(refined(coarse, 1e-3, closure=closure), closure)) <= 65
