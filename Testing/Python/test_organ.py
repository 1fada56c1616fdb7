"""The organ recipe on a small painted organ: every option, every kind of start, and honest results."""

from __future__ import annotations

import numpy as np
import pytest
from small_phantom import CENTER, ellipsoid

from VICRegistrationLib.analysis.distances import deviation, points_on
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.region import region_from_mask
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_organ, fit_region
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate

SEED = CENTER[None]
STAGES = ["global scaling", "region", "grey levels, coarse", "grey levels, fine"]
FINER = [f"{name}, 17x11" for name in STAGES[1:]]


@pytest.fixture(scope="module")
def image(small_image):
    return small_image


@pytest.fixture(scope="module")
def fit(small_fit):
    return small_fit


@pytest.fixture(scope="module")
def dark(image):
    """The same with the organ darker than its surroundings."""
    return Image((1000 - image.array).astype(np.int16), image.ijk_to_ras)


@pytest.fixture(scope="module")
def dark_fit(dark):
    return fitted(dark)


def fitted(image, seeds=SEED, **options):
    return finish(fit_organ(image, seeds, FitOptions(**options)))


def apart(surface, other):
    """Largest distance of one surface from another, whatever their control nets, mm."""
    return np.abs(closest_points(other, points_on(surface, 300)).distances).max()


# ------------------------------------------------------------------ accuracy


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"net": (12, 9), "closure": "paper"},
        {"solver": "gradient-descent"},
        {"levels": "organ"},
        {"levels": "given", "inside": 800.0, "outside": 100.0},
        {"tau": 1.8},
        {"threshold": (500.0, 2000.0), "erosion": 3.0},
        {"smoothness": 1e-4},
    ],
    ids=str,
)
def test_the_organ_is_found_with_every_option(image, fit, options):
    found = fitted(image, **options) if options else fit
    measured = deviation(found.surface, ellipsoid(), n_points=2000)
    # Measured: 0.05 to 0.11 mm, in pixels of 1.2 mm and slices of 3 mm; most where tau is narrower than the blur.
    assert measured.mean <= 0.15
    assert abs(measured.mean_signed) <= 0.12
    assert found.converged
    assert found.problems == ()
    # The seam and the poles hold to the last bits.
    net = found.surface.control_net
    assert found.surface.closed
    assert closed_organ(found.surface, closure=found.options.closure).surface is found.surface
    np.testing.assert_allclose(net[0], net[-1], atol=1e-9)
    assert np.ptp(net[:, [0, -1]], axis=0).max() < 1e-9


def test_an_organ_darker_than_its_surroundings_is_found_as_well(dark_fit):
    assert deviation(dark_fit.surface, ellipsoid(), n_points=2000).mean <= 0.15
    assert dark_fit.converged
    assert dark_fit.problems == ()


def test_more_seeds_do_no_harm(image, fit):
    found = fitted(image, CENTER + np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 15.0]]))
    # The suggested threshold and with it the region differ a little; anywhere at most a fifth of a pixel.
    assert apart(found.surface, fit.surface) < 0.24


def test_a_segmentation_may_take_the_place_of_the_seeds(image, fit):
    region = fit.region
    mask = np.zeros(image.array.shape, dtype=bool)
    mask[tuple(slice(start, start + n) for start, n in zip(region.offset, region.mask.shape))] = region.mask
    found = finish(fit_region(image, region_from_mask(image, mask)))
    assert found.options.threshold is None
    # The same voxels, the same surface; only the moments may round differently.
    assert apart(found.surface, fit.surface) < 0.02


def test_the_region_of_a_leak_is_not_taken_for_the_organ(image):
    # A bridge as wide as the organ into tissue as bright: what the seed sees tells how large the organ is.
    leaky = image.array.copy()
    leaky[:, :6, :] = 800
    region = separate(Image(leaky, image.ijk_to_ras), CENTER)
    assert region.volume_ml == pytest.approx(ellipsoid().volume() / 1000.0, rel=0.1)


def test_a_rough_segmentation_is_drawn_to_the_edge(image, fit):
    region = fit.region
    mask = np.zeros(image.array.shape, dtype=bool)
    box = tuple(slice(start, start + n) for start, n in zip(region.offset, region.mask.shape))
    mask[box] = region.mask & np.roll(region.mask, 1, axis=2) & np.roll(region.mask, 1, axis=1)
    rough = region_from_mask(image, mask)
    found = finish(fit_region(image, rough))
    last_on_region = [step for step in found.history if step.stage == "region"][-1].surface
    before = deviation(last_on_region, ellipsoid(), n_points=1000).mean
    after = deviation(found.surface, ellipsoid(), n_points=1000).mean
    assert before > 0.4
    assert after < 0.5 * before


def test_the_dilation_may_differ_from_the_erosion(image):
    def volume(**options):
        return fitted(image, net=(9, 7), max_iterations=1, erosion=2.4, **options).region.volume_ml

    assert volume(dilation=0.0) < 0.8 * volume()
    assert volume(dilation=2.4) == volume()
    with pytest.raises(ValueError, match="The dilation is -1.0; it must be a number from 0 to 20 mm"):
        fitted(image, dilation=-1.0)


def test_the_published_profile_shifts_the_contour_inward_by_about_half_the_ramp(image):
    tau = 3.6
    centred, published = (
        deviation(fitted(image, net=(9, 7), tau=tau, profile=profile).surface, ellipsoid(), n_points=1000)
        for profile in ("centered", "paper")
    )
    # The edge of the image is blurred more than the ramp is wide across slices, which adds a little.
    assert -0.65 * tau < published.mean_signed - centred.mean_signed < -0.45 * tau


@pytest.mark.parametrize(("factor", "offset"), [(0.01, -300.0), (-3.0, 5000.0)])
def test_the_surface_does_not_depend_on_the_scale_of_the_grey_levels(image, fit, factor, offset):
    found = finish(fit_region(Image(factor * image.array + offset, image.ijk_to_ras), fit.region))
    # Only rounding differs.
    assert np.abs(found.surface.control_net - fit.surface.control_net).max() < 1e-6
    assert found.cost_final == pytest.approx(fit.cost_final, rel=1e-6)


@pytest.mark.long
def test_a_large_net_fits_too(image):
    # One iteration for each stage: going on to the end takes several times as long and changes 0.003 mm.
    found = fitted(image, net=(49, 37), max_iterations=1)
    assert found.surface.control_net.shape == (51, 37, 3)
    assert deviation(found.surface, ellipsoid(), n_points=1000).mean <= 0.25
    assert found.problems == ()


# ------------------------------------------------------------------ what is returned


def test_the_history_is_complete(image):
    seen = []
    found = finish(fit_organ(image, SEED), on_step=seen.append)
    assert list(found.history) == seen
    assert found.iterations == len(seen)
    # The organ is an ellipsoid: the coarser net fits it as well.
    names = [*STAGES, *FINER, "coarser net kept"]
    assert list(dict.fromkeys(step.stage for step in seen)) == names
    for name in names:
        steps = [step for step in seen if step.stage == name]
        assert [step.iteration for step in steps] == list(range(1, len(steps) + 1))
        assert [step.converged for step in steps] == [False] * (len(steps) - 1) + [True]
    assert found.surface is seen[-1].surface
    assert found.converged
    assert found.seconds > 0.0


def test_every_step_is_in_the_world(fit):
    # The ellipsoid's centre is 25 mm away from the origin, where the organ's own frame has it.
    for step in fit.history:
        points = step.surface.grid(np.linspace(0.0, 1.0, 24), np.linspace(0.0, 1.0, 16)).reshape(-1, 3)
        np.testing.assert_allclose((points.min(axis=0) + points.max(axis=0)) / 2.0, CENTER, atol=1.0)
        np.testing.assert_allclose(np.ptp(points, axis=0) / 2.0, [14.0, 18.0, 22.0], atol=1.5)
        assert step.surface.closed
        assert step.surface.volume() > 0.0


def test_both_costs_are_seen_as_the_last_stage_sees_them(fit):
    last = [step for step in fit.history if step.stage == STAGES[-1]]
    assert fit.cost_final < fit.cost_initial
    # Levels are brought up to date once more at the end.
    assert fit.cost_final == pytest.approx(last[-1].cost, rel=0.1)


def test_automatic_choices_are_filled_in(image, fit):
    assert 2.0 * 1.2 <= fit.options.tau <= 3.0 * 1.2
    assert fit.options.smoothness > 0.0
    assert fit.options.threshold == fit.region.threshold
    assert fit.options.max_iterations == 50
    assert fitted(image, tau=3.3, max_iterations=4).options.tau == 3.3


def test_the_iterations_are_bounded(image):
    found = fitted(image, max_iterations=1)
    assert {step.iteration for step in found.history} == {1}
    assert [step.stage for step in found.history][: len(STAGES)] == STAGES
    assert found.problems == ()


# ------------------------------------------------------------------ leaving and resuming


def test_a_fit_can_be_left_between_any_two_steps(image, fit):
    # What nets share is kept between fits; fits that were left must not have changed it: the last one goes to its end.
    for count in (0, 4, fit.iterations - 1, fit.iterations):
        steps = fit_organ(image, SEED)
        for expected in fit.history[:count]:
            np.testing.assert_array_equal(next(steps).surface.control_net, expected.surface.control_net)
        steps.close()


def test_two_fits_may_take_turns(image, fit, dark, dark_fit):
    one, two = fit_organ(image, SEED), fit_organ(dark, SEED)
    for first, second in zip(fit.history, dark_fit.history):
        np.testing.assert_array_equal(next(one).surface.control_net, first.surface.control_net)
        np.testing.assert_array_equal(next(two).surface.control_net, second.surface.control_net)


def test_nothing_happens_before_the_first_step(image):
    # A generator: a bad seed is told when the first step is asked for, and not before.
    steps = fit_organ(image, np.array([[500.0, 0.0, 0.0]]))
    with pytest.raises(ValueError, match="outside"):
        next(steps)


# ------------------------------------------------------------------ an organ cut by the volume


@pytest.mark.parametrize(
    ("start", "stop", "faces"),
    [
        ((0, 0, 0), (11, 56, 52), {"k+"}),
        ((6, 20, 20), (22, 56, 52), {"k-", "j-", "i-"}),
    ],
)
def test_an_organ_cut_by_the_volume_closes_near_its_border(image, start, stop, faces):
    volume = image.crop(start, stop)
    seed = volume.to_ras(np.clip(volume.to_ijk(SEED), 2, volume.size - 3))
    found = fitted(volume, seed)
    assert set(found.region.touches_border) == faces
    ijk = volume.to_ijk(points_on(found.surface, 2000))
    beyond = np.maximum(np.maximum(-0.5 - ijk, ijk - (volume.size - 0.5)), 0.0) * volume.spacing
    # Nothing is known there; within half a slice of 3 mm.
    assert beyond.max() <= 1.5
    assert found.problems == ()
    assert found.surface.volume() / 1000.0 == pytest.approx(found.region.volume_ml, rel=0.1)
    # Away from the border it is the same organ.
    within = (np.minimum(ijk + 0.5, volume.size - 0.5 - ijk) * volume.spacing).min(axis=1) > 8.0
    assert within.sum() > 200
    distances = closest_points(ellipsoid(), points_on(found.surface, 2000)[within]).distances
    assert np.abs(distances).mean() < 0.5


def test_a_region_without_surroundings_is_refused(image):
    everything = region_from_mask(image, np.ones(image.array.shape))
    with pytest.raises(
        ValueError, match="The region fills the volume up to its border; the image must show what lies around"
    ):
        finish(fit_region(image, everything))


# ------------------------------------------------------------------ bad options


def test_a_net_that_is_too_small_is_refused_at_the_first_step(image):
    message = "A net of 5x5 was asked for; degrees 3 and 3 with the paper closure need at least 6x5"
    with pytest.raises(ValueError, match=message):
        next(fit_organ(image, SEED, FitOptions(net=(5, 5), closure="paper")))


def test_a_region_of_another_image_is_refused(image, fit):
    moved = Image(image.array, image.ijk_to_ras + np.eye(4, k=3) * 5.0)
    with pytest.raises(ValueError, match="does not lie on the image's grid; separate the organ in this image"):
        next(fit_region(moved, fit.region))


def test_a_region_thinner_than_the_edge_is_refused(image):
    mask = np.zeros(image.array.shape, dtype=bool)
    mask[8:12, 20, 20:30] = True
    with pytest.raises(ValueError, match=r"The region is about .* mm thick; an edge of 3 mm is sought on each side"):
        next(fit_region(image, region_from_mask(image, mask)))


def test_a_fit_that_has_ended_cannot_be_finished_again(image):
    steps = fit_organ(image, SEED, FitOptions(net=(9, 7), max_iterations=1))
    finish(steps)
    with pytest.raises(ValueError, match="had come to its end before; start a new one"):
        finish(steps)
