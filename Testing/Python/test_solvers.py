"""Gauss-Newton and gradient descent: the same minimum, no reflections, steps that only ever improve."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import sparse

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import affine, affine_matrix, closed_organ
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.registration.cost import Correlation, Objective
from VICRegistrationLib.registration.sample_grid import SampledSurface, SampleGrid
from VICRegistrationLib.registration.solvers import SOLVERS
from VICRegistrationLib.registration.virtual_image import IntensityProfile, VirtualImage

RADIUS = 20.0
PROFILE = IntensityProfile(1.0, 0.0, 20.0)


def ball_image(*, level=1.0, around=0.0, ramp=20.0):
    """A ball of 20 mm about the origin with the profile's own ramp, in voxels of 2 mm."""
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = -49.0
    k, j, i = np.indices((50, 50, 50)) * 2.0 - 49.0
    distance = np.sqrt(i**2 + j**2 + k**2) - RADIUS
    return Image(IntensityProfile(level, around, ramp).value(distance), matrix)


@pytest.fixture(scope="module")
def bright_ball():
    return Sampler(ball_image())


@pytest.fixture(params=list(SOLVERS))
def solver(request):
    return SOLVERS[request.param]


def objective_of(sampler, parametrization, *, stiffness=None, reference=None):
    surface = SampledSurface(parametrization, SampleGrid.on(parametrization.surface, (24, 16)))
    virtual = VirtualImage(PROFILE, mode="given")
    correlation = Correlation(sampler, virtual, surface, depths=PROFILE.depths(0.5, 9))
    return Objective([correlation], stiffness=stiffness, reference=reference)


def moved_ellipsoid():
    return models.closed_organ(axes=np.diag([26.0, 17.0, 22.0]), center=(3.0, -2.0, 4.0))


def run(solver, objective, count, *, largest_step=10.0):
    start = np.zeros(objective.n_dof)
    return list(itertools.islice(solver(objective, start, largest_step=largest_step), count))


# ------------------------------------------------------------------ the minimum


@pytest.mark.parametrize("make", [affine, closed_organ])
def test_the_ball_is_found_from_a_displaced_ellipsoid(bright_ball, solver, make):
    objective = objective_of(bright_ball, make(moved_ellipsoid()))
    last = run(solver, objective, 150)[-1]
    surface = objective.costs[0].parametrization.deform(last.q)
    u, v = np.linspace(0.0, 1.0, 40), np.linspace(0.02, 0.98, 30)
    radii = np.linalg.norm(surface.grid(u, v), axis=2)
    # Trilinear interpolation in voxels of 2 mm of a ramp of 20 mm moves the edge of the ball by 0.05 mm.
    np.testing.assert_allclose(radii, RADIUS, atol=0.15)
    # The ramp itself is reproduced, but for that interpolation.
    assert last.cost < 2e-4


def test_both_solvers_end_at_the_same_surface(bright_ball):
    surfaces = []
    for solver in SOLVERS.values():
        parametrization = affine(moved_ellipsoid())
        surfaces.append(parametrization.deform(run(solver, objective_of(bright_ball, parametrization), 150)[-1].q))
    difference = np.abs(surfaces[0].control_net - surfaces[1].control_net).max()
    # Measured in hundredths of a millimetre: turning the ball about its centre costs nothing, so it is not compared.
    u, v = np.linspace(0.0, 1.0, 30), np.linspace(0.02, 0.98, 20)
    radii = [np.linalg.norm(surface.grid(u, v), axis=2) for surface in surfaces]
    np.testing.assert_allclose(radii[0], radii[1], atol=0.02)
    assert difference < 5.0


def test_gauss_newton_needs_far_fewer_iterations(bright_ball):
    reached = {}
    for name, solver in SOLVERS.items():
        objective = objective_of(bright_ball, closed_organ(moved_ellipsoid()))
        costs = [iterate.cost for iterate in run(solver, objective, 60)]
        reached[name] = next((n for n, cost in enumerate(costs) if cost < 2e-5), 60)
    assert reached["gauss-newton"] < 15
    assert reached["gradient-descent"] > 2 * reached["gauss-newton"]


# ------------------------------------------------------------------ each iteration


def test_no_iteration_makes_it_worse(bright_ball, solver):
    objective = objective_of(bright_ball, closed_organ(moved_ellipsoid()))
    iterates = run(solver, objective, 30)
    assert all(iterate.decrease >= 0.0 for iterate in iterates)
    costs = np.array([iterate.cost for iterate in iterates])
    # The area weights follow the surface between iterations, which may lift the cost by a little of itself.
    assert (np.diff(costs) <= 0.01 * costs[:-1]).all()


def test_no_step_is_longer_than_allowed(bright_ball, solver):
    objective = objective_of(bright_ball, closed_organ(moved_ellipsoid()))
    moved = [iterate.displacement for iterate in run(solver, objective, 10, largest_step=0.7)]
    assert max(moved) <= 0.7 * (1.0 + 1e-12)
    assert moved[0] > 0.1


def test_an_iterate_shows_how_far_it_went(bright_ball, solver):
    objective = objective_of(bright_ball, closed_organ(moved_ellipsoid()))
    parametrization = objective.costs[0].parametrization
    before = np.zeros(parametrization.n_dof)
    for iterate in run(solver, objective, 4):
        moved = parametrization.control_net(iterate.q) - parametrization.control_net(before)
        assert iterate.displacement == pytest.approx(np.linalg.norm(moved, axis=2).max(), rel=1e-9)
        assert iterate.change == pytest.approx(np.abs(iterate.q - before).max(), rel=1e-12)
        before = iterate.q


def test_iterates_can_be_kept_while_the_solver_goes_on(bright_ball, solver):
    objective = objective_of(bright_ball, closed_organ(moved_ellipsoid()))
    iterates = solver(objective, np.zeros(objective.n_dof), largest_step=10.0)
    first = next(iterates)
    kept = first.q.copy()
    next(iterates)
    iterates.close()
    np.testing.assert_array_equal(first.q, kept)


def test_a_stiff_regularisation_holds_the_reference(bright_ball, solver):
    parametrization = affine(moved_ellipsoid(), free="translation")
    reference = np.array([1.0, 2.0, -1.0])
    objective = objective_of(bright_ball, parametrization, stiffness=1e4 * np.eye(3), reference=reference)
    np.testing.assert_allclose(run(solver, objective, 40)[-1].q, reference, atol=1e-4)


def test_the_gradient_of_the_objective_is_half_the_derivative_of_its_value(bright_ball):
    parametrization = affine(moved_ellipsoid(), free="scaling")
    objective = objective_of(bright_ball, parametrization, stiffness=np.diag([1.0, 2.0, 3.0]))
    q = np.array([0.02, -0.03, 0.01])
    objective.refresh(q)

    def value(place):
        return objective.value(place, objective.sample(place))

    numeric = [(value(q + step) - value(q - step)) / 4e-6 for step in 1e-6 * np.eye(3)]
    # The step of 1e-6 leaves eight digits; trilinear interpolation has kinks that a few of the samples cross.
    np.testing.assert_allclose(objective.gradient(q, objective.sample(q)), numeric, rtol=1e-4)


@pytest.mark.parametrize("net", [(9, 7), (21, 21)])
def test_a_matrix_that_is_not_positive_definite_is_damped_until_it_is(bright_ball, net):
    parametrization = closed_organ(models.closed_organ(net, axes=np.diag([26.0, 17.0, 22.0])))
    free = objective_of(bright_ball, parametrization)
    mean = free.hessian(free.sample(np.zeros(free.n_dof))).diagonal().mean()
    # Sliding within the surface costs nothing, so that this makes it a way downhill.
    identity = sparse.identity(free.n_dof) if free.costs[0].surface.sparse else np.eye(free.n_dof)
    objective = objective_of(bright_ball, parametrization, stiffness=-0.3 * mean * identity)
    hessian = objective.hessian(objective.sample(np.zeros(free.n_dof)))
    assert np.linalg.eigvalsh(hessian.toarray() if sparse.issparse(hessian) else hessian).min() < 0.0
    (first,) = run(SOLVERS["gauss-newton"], objective, 1)
    assert first.displacement > 0.0
    assert first.decrease > 0.0


# ------------------------------------------------------------------ nothing to gain


def test_a_constant_image_moves_nothing(solver):
    flat = Image(np.ones((50, 50, 50)), ball_image().ijk_to_ras)
    objective = objective_of(Sampler(flat), closed_organ(moved_ellipsoid()))
    for iterate in run(solver, objective, 3):
        assert iterate.displacement == 0.0
        assert iterate.decrease == 0.0
        assert np.isfinite(iterate.cost)


def test_a_surface_out_of_the_volume_stays_where_it_is(bright_ball, solver):
    away = models.closed_organ(axes=10.0 * np.eye(3), center=(500.0, 0.0, 0.0))
    for iterate in run(solver, objective_of(bright_ball, closed_organ(away)), 3):
        assert iterate.displacement == 0.0
        assert iterate.cost == 0.0


# ------------------------------------------------------------------ reflections


def test_a_nearly_mirrored_start_comes_back_unmirrored(bright_ball, solver):
    start = models.closed_organ(axes=np.diag([0.05 * RADIUS, RADIUS, RADIUS]))
    objective = objective_of(bright_ball, affine(start, free="linear", center=np.zeros(3)))
    for iterate in run(solver, objective, 60, largest_step=60.0):
        assert np.linalg.det(affine_matrix(iterate.q, free="linear")[:3, :3]) > 0.0
    assert objective.costs[0].parametrization.deform(iterate.q).volume() == pytest.approx(
        4.0 / 3.0 * np.pi * RADIUS**3, rel=0.03
    )


@pytest.mark.parametrize(("squeezed", "free"), [(0.05, ("R00",)), (0.5, "linear")])
def test_even_an_image_that_asks_for_a_reflection_does_not_get_it(solver, squeezed, free):
    # Dark ball, bright virtual image: only the ball turned inside out would fit.
    sampler = Sampler(ball_image(level=0.0, around=1.0))
    start = models.closed_organ(axes=np.diag([squeezed * RADIUS, RADIUS, RADIUS]))
    objective = objective_of(sampler, affine(start, free=free, center=np.zeros(3)))
    iterates = run(solver, objective, 30, largest_step=60.0)
    # It is pressed flat, until rounding alone tells on which side; every stage stops long before that.
    for iterate in itertools.takewhile(lambda iterate: iterate.displacement > 0.001, iterates):
        assert np.linalg.det(affine_matrix(iterate.q, free=free)[:3, :3]) > 0.0
    assert iterates[-1].cost > 0.2
