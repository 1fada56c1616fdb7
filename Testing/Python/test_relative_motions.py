"""Stacks are aligned with each other, whatever the surface between them was fitted to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from small_phantom import CENTER
from stack_phantom import GRID, MOTION, dented, motion_about, stack_of

from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.registration.alignment import SAMPLES, Alignment, measured, surroundings
from VICRegistrationLib.registration.joint_stacks import voxel_weight_of
from VICRegistrationLib.registration.partial_volumes import PartialVolumes
from VICRegistrationLib.registration.relative_motions import relative_motions
from VICRegistrationLib.registration.stacks import rotation_degrees


@pytest.fixture(scope="module")
def truth():
    return dented()


@pytest.fixture(scope="module")
def sagittal(truth):
    return stack_of(truth, "sagittal", **GRID)


def seen(image, surface, motion):
    """What an image shows of a surface that is moved."""
    sampler = surroundings(image, surface.transformed(motion))
    return measured(sampler, surface, motion, volumes=PartialVolumes(sampler.image))


def aligned(images, surface, motions, *, turns=3):
    """Motions of further images, found from others on; those of the last turn."""
    own = seen(images[0], surface, np.eye(4))
    for _ in range(turns):
        found = [seen(image, surface, motion) for image, motion in zip(images[1:], motions)]
        voxel_weights = [1.0, *(voxel_weight_of(each, own) for each in found)]
        relative = relative_motions(surface, [own, *found], voxel_weights)
        motions = relative.motions
    return relative


def off(found, motion, surface):
    """Mean distance between where two motions take a surface, mm."""
    points = surface.control_net.reshape(-1, 3)
    return np.linalg.norm(points @ (found - motion)[:3, :3].T + (found - motion)[:3, 3], axis=1).mean()


def made(motion, offsets):
    """What a stack would show of edges at these offsets, all of them sharp."""
    ones = np.ones(len(offsets))
    view = SimpleNamespace(voxel=np.eye(3), tau=3.0)
    return Alignment(motion, view, 1.0, 1.0, 1.0, 0.0, offsets=offsets, weights=ones, blur=ones)


def test_a_step_is_taken_before_the_motion_so_far(truth):
    turned, step = motion_about(CENTER, (0.0, 0.0, 0.0), (0.0, 0.0, 90.0)), np.eye(4)
    step[:3, 3] = (0.3, 0.0, -0.1)
    offsets = truth.normals(*truth.midpoints(*SAMPLES)) @ step[:3, 3]
    found = relative_motions(truth, [made(np.eye(4), 0.0 * offsets), made(turned, offsets)], [1.0, 1.0])
    assert off(found.motions[0], turned @ step, truth) < 0.02
    assert found.moved == pytest.approx(np.linalg.norm(step[:3, 3]), abs=0.02)


def test_a_turn_that_no_edge_shows_is_none():
    ball = closed_organ((17, 13), axes=20.0 * np.eye(3), center=CENTER)
    nothing = np.zeros(np.prod(SAMPLES))
    turned = motion_about(CENTER, (0.0, 0.0, 0.0), (3.0, 4.0, 0.0))
    found = relative_motions(ball, [made(np.eye(4), nothing), made(turned, nothing)], [1.0, 1.0])
    assert rotation_degrees(turned) > 4.0
    assert rotation_degrees(found.motions[0]) < 0.5


def test_a_surface_that_lies_at_the_edge_of_the_further_stack_does_not_hold_its_motion(sagittal, truth):
    # What a wrong motion has brought about: the surface lies where the axial stack is then, off the sagittal one.
    axial = stack_of(truth, "axial", motion=MOTION, seed=2, **GRID)
    wrong = motion_about(CENTER, (0.5, 0.4, -0.3), (0.8, -0.8, 0.8))
    surface, start = truth.transformed(np.linalg.inv(wrong)), MOTION @ wrong
    assert off(start, MOTION, surface) > 0.7
    relative = aligned([sagittal, axial], surface, [start])
    assert off(relative.motions[0], MOTION, surface) < 0.2
    assert relative.moved < 0.1


def test_two_further_stacks_are_aligned_at_once(sagittal, truth):
    other = motion_about(CENTER, (-1.0, 2.0, 0.5), (-1.0, 0.5, 1.0))
    images = [
        stack_of(truth, way, motion=motion, seed=3, **GRID) for way, motion in (("axial", MOTION), ("coronal", other))
    ]
    starts = [motion @ motion_about(CENTER, (0.4, -0.4, 0.3), (0.5, 0.5, -0.5)) for motion in (MOTION, other)]
    found = aligned([sagittal, *images], truth, starts).motions
    assert [off(one, motion, truth) < 0.2 for one, motion in zip(found, (MOTION, other))] == [True, True]


def test_how_sure_a_motion_is_follows_from_what_the_stack_shows(sagittal, truth):
    whole = stack_of(truth, "axial", motion=MOTION, seed=2, **GRID)
    half = whole.crop((0, 0, 0), (9, *whole.array.shape[1:]))
    noisy = stack_of(truth, "axial", motion=MOTION, seed=2, noise=100.0, **GRID)
    found = [aligned([sagittal, image], truth, [MOTION]) for image in (whole, half, noisy)]
    turns, shifts = np.array([relative.deviations[0] for relative in found]).T
    # Measured: 0.16, 0.47 and 0.62 degrees; 0.013, 0.035 and 0.048 mm, where they are off by 0.008, 0.037 and 0.021 mm.
    assert turns[1:].min() > 2.0 * turns[0]
    assert shifts[1:].min() > 2.0 * shifts[0]
    center = np.append(CENTER, 1.0)
    errors = np.array([np.linalg.norm((relative.motions[0] - MOTION) @ center) for relative in found])
    assert (errors < 3.0 * shifts).all()
    assert shifts.max() < 0.1


def test_an_organ_that_is_fuller_is_not_turned(sagittal, truth):
    fuller = truth.with_control_net(CENTER + 1.04 * (truth.control_net - CENTER))
    axial = stack_of(fuller, "axial", seed=2, **GRID)
    (found,) = aligned([sagittal, axial], truth, [np.eye(4)]).motions
    # It is turned by 10 degrees and more where both edges are thought to be one.
    assert rotation_degrees(found) < 2.0


def test_stacks_disagree_by_what_one_of_them_shows_larger(sagittal, truth):
    fuller = truth.with_control_net(CENTER + 1.04 * (truth.control_net - CENTER))
    own, same, other = (
        seen(image, truth, np.eye(4))
        for image in (sagittal, *(stack_of(shape, "axial", seed=2, **GRID) for shape in (truth, fuller)))
    )
    thicker = 0.04 * 3.0 * truth.volume() / truth.area()
    # Offsets are of first order: 0.54 mm of 0.67 mm, where partial volumes leave 0.02 mm between stacks of one shape.
    assert other.disagreement(own)[1] == pytest.approx(thicker, rel=0.22)
    assert own.disagreement(other)[1] == pytest.approx(-thicker, rel=0.22)
    assert other.disagreement(own)[0] == pytest.approx(thicker, rel=0.25)
    assert np.abs(same.disagreement(own)) == pytest.approx([0.0, 0.0], abs=0.05)
