"""Several stacks of one patient: one surface for all of them, and the motion between them."""

from __future__ import annotations

import numpy as np
import pytest
from small_phantom import CENTER, ellipsoid
from stack_phantom import GRID, MOTION, dented, motion_about, stack_of

import VICRegistrationLib as vic
from VICRegistrationLib.analysis.comparison import distances_from
from VICRegistrationLib.analysis.distances import points_on
from VICRegistrationLib.imaging.region import Region
from VICRegistrationLib.registration.completion import completed_region
from VICRegistrationLib.registration.diagnostics import fit_diagnostics
from VICRegistrationLib.registration.organ import complete_region
from VICRegistrationLib.registration.stacks import as_stacks
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate

SEEDS = CENTER[None]


@pytest.fixture(scope="module")
def truth():
    return dented()


@pytest.fixture(scope="module")
def sagittal(truth):
    return stack_of(truth, "sagittal", **GRID)


@pytest.fixture(scope="module")
def axial(truth):
    return stack_of(truth, "axial", motion=MOTION, seed=2, **GRID)


@pytest.fixture(scope="module")
def alone(sagittal):
    return vic.fit(sagittal, SEEDS)


@pytest.fixture(scope="module")
def both(sagittal, axial):
    return vic.fit(sagittal, SEEDS, further=[axial])


def error(surface, truth) -> float:
    """Mean distance from the truth, mm."""
    return float(np.abs(distances_from(surface, points_on(truth, 2000))).mean())


def motion_error(motion, truth) -> float:
    """Mean distance of the true surface's points from where they should be after the axial stack's motion, mm."""
    off = motion - MOTION
    return float(np.linalg.norm(points_on(truth, 500) @ off[:3, :3].T + off[:3, 3], axis=1).mean())


def test_a_second_stack_that_was_moved_brings_the_surface_nearer_to_the_truth(alone, both, truth):
    # Measured: 0.016 mm, and 0.023 mm from one stack alone.
    assert error(both.surface, truth) < error(alone.surface, truth)
    assert error(both.surface, truth) < 0.02


def test_the_motion_between_stacks_is_found(both, truth):
    (stack,) = both.stacks
    assert stack.used
    assert stack.reason is None
    assert motion_error(stack.motion, truth) < 0.1
    assert np.allclose(stack.translation_mm, [2.0, -1.5, 1.5], atol=0.1)
    assert stack.rotation_degrees == pytest.approx(2.05, abs=0.3)


def test_a_stack_that_is_moved_too_far_is_left_out_and_why_is_told(sagittal, truth, alone):
    far = stack_of(truth, "axial", motion=motion_about(CENTER, (0.0, 0.0, 30.0), (0, 0, 0)), size=(56, 56, 30))
    found = vic.fit(sagittal, SEEDS, further=[far])
    (stack,) = found.stacks
    assert not stack.used
    assert "30 mm" in stack.reason.sentence()
    assert [each.code for each in fit_diagnostics(sagittal, found)] == ["stack_left_out"]
    assert np.array_equal(found.surface.control_net, alone.surface.control_net)


def test_a_stack_of_another_contrast_and_scale_is_used(sagittal, truth, alone):
    levels = (100.0, 800.0, 400.0)
    image = stack_of(truth, "coronal", motion=MOTION, levels=levels, noise=0.0, seed=3, **GRID)
    grain = np.random.default_rng(4).normal(0.0, 16.0, image.array.shape)
    found = vic.fit(sagittal, SEEDS, further=[vic.Image(0.01 * (image.array + grain), image.ijk_to_ras)])
    assert found.stacks[0].used
    assert error(found.surface, truth) < error(alone.surface, truth)


def test_a_stack_with_ten_times_the_noise_counts_less(sagittal, truth, alone):
    found = vic.fit(sagittal, SEEDS, further=[stack_of(truth, "axial", motion=MOTION, seed=2, noise=100.0, **GRID)])
    assert found.stacks[0].used
    # Measured: 0.036 mm, and 0.023 mm from one stack alone.
    assert error(found.surface, truth) < error(alone.surface, truth) + 0.02


def test_a_stack_with_another_filling_is_left_out(sagittal, truth, alone):
    larger = truth.with_control_net(CENTER + 1.04 * (truth.control_net - CENTER))
    found = vic.fit(sagittal, SEEDS, further=[stack_of(larger, "axial", seed=2, **GRID)])
    assert found.stacks[0].reason.code == "stack_shows_another_shape"
    assert np.array_equal(found.surface.control_net, alone.surface.control_net)


def test_a_slender_organ_is_told_from_one_that_is_fuller_however_few_lines_are_sharp_in_both_stacks(truth):
    slender = truth.with_control_net(CENTER + np.array([0.6, 0.6, 1.2]) * (truth.control_net - CENTER))
    larger = slender.with_control_net(CENTER + 1.04 * (slender.control_net - CENTER))
    first = stack_of(slender, "sagittal", **GRID)
    given = [("coronal", slender), ("coronal", larger), ("axial", larger)]
    used = []
    for direction, surface in given:
        (stack,) = vic.fit(first, SEEDS, further=[stack_of(surface, direction, motion=MOTION, seed=2, **GRID)]).stacks
        used.append(stack.used or stack.reason.code)
    assert used == [True, "stack_shows_another_shape", "stack_shows_another_shape"]


@pytest.mark.parametrize("kind", ["noise", "constant", "elsewhere"])
def test_a_stack_without_the_organ_is_left_out(sagittal, axial, alone, kind):
    grain = np.random.default_rng(5).normal(0.0, 100.0, axial.array.shape)
    array = {"noise": grain, "constant": np.full_like(grain, 7.0), "elsewhere": axial.array}[kind]
    matrix = axial.ijk_to_ras + (np.eye(4, k=3) * 400.0 if kind == "elsewhere" else 0.0)
    found = vic.fit(sagittal, SEEDS, further=[vic.Image(array, matrix)])
    assert not found.stacks[0].used
    assert found.stacks[0].reason.sentence()
    assert np.array_equal(found.surface.control_net, alone.surface.control_net)


def test_the_order_of_axes_of_a_stack_does_not_matter(sagittal, axial, both):
    turned = vic.fit(sagittal, SEEDS, further=[axial.canonical()])
    assert np.abs(turned.surface.control_net - both.surface.control_net).max() < 0.05


def test_a_stack_that_shows_half_of_the_organ_does_no_harm(sagittal, axial, truth, alone):
    half = axial.crop((0, 0, 0), (9, *axial.array.shape[1:]))
    found = vic.fit(sagittal, SEEDS, further=[half])
    assert 0.3 < found.stacks[0].seen < 0.8
    assert error(found.surface, truth) < error(alone.surface, truth) + 0.02


def test_an_organ_that_the_first_stack_cuts_is_completed_from_another_one(sagittal, axial, truth):
    cut = sagittal.crop((0, 0, 0), (10, *sagittal.array.shape[1:]))
    alone = vic.fit(cut, SEEDS)
    assert alone.region.touches_border == ("k+",)
    assert error(alone.surface, truth) > 0.5
    found = vic.fit(cut, SEEDS, further=[axial])
    assert error(found.surface, truth) < 0.2
    assert found.whole_region.volume_ml > 1.1 * found.region.volume_ml
    assert found.whole_region.touches_border == ()
    codes = [each.code for each in fit_diagnostics(cut, alone)]
    # Alone, the finest stage begins at its best point already: its cost is 0.0005.
    assert [code for code in codes if code != "no_further_step"] == ["reaches_border", "no_edge_at_side"]
    assert fit_diagnostics(cut, found) == []


def test_an_organ_is_completed_with_motions_that_were_found_with_the_completed_organ(sagittal, axial, truth):
    cut = sagittal.crop((0, 0, 0), (9, *sagittal.array.shape[1:]))
    _, (stack,) = finish(complete_region(cut, separate(cut, SEEDS), vic.FitOptions(), as_stacks([axial]), []))
    # Measured: 0.17 mm, and 0.47 mm with the surface of the first stack alone.
    assert motion_error(stack.motion, truth) < 0.3


def test_one_stack_alone_or_an_empty_list_take_the_same_way(sagittal, alone):
    again = vic.fit(sagittal, SEEDS, further=[])
    assert np.array_equal(again.surface.control_net, alone.surface.control_net)
    assert again.stacks == ()


def test_a_refit_begins_with_the_motion_that_was_found(sagittal, both, truth):
    again = vic.refit(sagittal, both.surface, both.options, further=[stack.stack for stack in both.stacks])
    assert again.stacks[0].used
    assert np.abs(again.stacks[0].translation_mm - both.stacks[0].translation_mm).max() < 0.15
    assert error(again.surface, truth) < error(both.surface, truth) + 0.02


def test_a_surface_that_was_moved_is_fitted_again_to_all_stacks(sagittal, both, truth):
    away = both.surface.transformed(motion_about(CENTER, (0.8, 0.0, 0.0), (0, 0, 0)))
    stacks = [stack.stack for stack in both.stacks]
    again, without = (vic.refit(sagittal, away, both.options, further=further) for further in (stacks, []))
    assert error(again.surface, truth) < 0.7 * error(without.surface, truth)


def test_a_refit_leaves_out_a_stack_with_another_filling(sagittal, truth, alone):
    larger = truth.with_control_net(CENTER + 1.04 * (truth.control_net - CENTER))
    again = vic.refit(sagittal, alone.surface, further=[stack_of(larger, "axial", seed=2, **GRID)])
    assert not again.stacks[0].used
    assert np.array_equal(again.surface.control_net, vic.refit(sagittal, alone.surface).surface.control_net)


def test_boundary_points_pull_a_surface_of_several_stacks(sagittal, axial, both):
    point = both.surface.points(np.array([0.3]), np.array([0.5])) + 3.0 * both.surface.normals(
        np.array([0.3]), np.array([0.5])
    )
    stacks = [stack.stack for stack in both.stacks]
    pulled = vic.refit(sagittal, both.surface, both.options, boundary_points=point, further=stacks)
    assert abs(pulled.surface.closest_points(point).distances[0]) < 0.3
    assert pulled.stacks[0].used
    # Around the point the surface is fitted to the grey levels of all of them.
    without = vic.refit(sagittal, both.surface, both.options, boundary_points=point)
    apart = np.linalg.norm(pulled.surface.control_net - without.surface.control_net, axis=-1).max()
    assert 0.02 < apart < 3.0


def test_a_second_stack_makes_the_surface_more_certain(alone, both):
    assert both.confidence.deviations.mean() < 0.85 * alone.confidence.deviations.mean()


@pytest.mark.parametrize("again", ["the first image", "another file of it", "a stack"])
def test_voxels_that_would_count_twice_are_refused(sagittal, axial, again):
    copy, turned = vic.Image(sagittal.array.copy(), sagittal.ijk_to_ras), sagittal.canonical()
    rounded = vic.Image(turned.array.astype(np.float32), turned.ijk_to_ras + np.eye(4, k=3) * 1e-4)
    given = {"the first image": [copy], "another file of it": [rounded], "a stack": [axial, axial]}
    further = given[again]
    with pytest.raises(ValueError, match="same voxels as the (first image|stack stack 2); give each stack once"):
        vic.fit(sagittal, SEEDS, further=further)


def test_what_is_no_stack_is_refused(sagittal):
    with pytest.raises(TypeError, match="as a list"):
        as_stacks(sagittal)
    with pytest.raises(TypeError, match="An image is needed"):
        as_stacks([np.zeros((3, 3, 3))])
    with pytest.raises(ValueError, match="not rigid"):
        as_stacks([vic.Stack(sagittal, motion=2.0 * np.eye(4))])
    assert [stack.name for stack in as_stacks([sagittal, vic.Stack(sagittal, "axial")])] == ["stack 2", "axial"]


# ------------------------------------------------------------------ completing a region that the first stack cuts


@pytest.fixture(scope="module")
def half():
    """A sagittal stack that ends 5 mm right of the organ's centre, and the organ's region in it."""
    image = stack_of(ellipsoid(), "sagittal")
    cut = image.crop((0, 0, 0), (10, *image.array.shape[1:]))
    return cut, separate(cut, CENTER[None])


def reach(region: Region, *, above: float) -> float:
    """How far a region reaches to the right of the organ's centre at a height above it, mm."""
    points = region.image.to_ras(np.argwhere(region.mask)[:, ::-1]) - CENTER
    return points[np.abs(points[:, 2] - above) < 1.0, 0].max()


def test_what_another_stack_shows_is_added(half):
    image, region = half
    whole = completed_region(image, region, [(stack_of(ellipsoid(), "axial"), np.eye(4))])
    assert whole.volume_ml == pytest.approx(ellipsoid().volume() / 1000.0, rel=0.07)
    assert whole.touches_border == ()
    assert completed_region(image, region, []) is region


def test_what_no_stack_shows_is_bridged_from_one_that_ends_below_to_the_border_of_the_first(half):
    image, region = half
    axial = stack_of(ellipsoid(), "axial")
    # It ends 4 mm above the organ's centre; there the organ reaches 14 mm to the right, and the first stack 5 mm.
    lower = axial.crop((0, 0, 0), (10, *axial.array.shape[1:]))
    whole = completed_region(image, region, [(lower, np.eye(4))])
    there, higher, highest = (reach(whole, above=height) for height in (0.0, 9.0, 20.0))
    assert there > 11.0
    assert reach(region, above=9.0) + 2.0 < higher < there
    assert highest < 7.0
