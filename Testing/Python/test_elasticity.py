"""Linear elasticity by finite elements: against exact solutions, another program's way, and itself under refinement."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install 'vicregistration[fe]'")

from fe_meshes import ball, hollow_ball

from VICRegistrationLib.meshing.tetrahedra import TetrahedralMesh
from VICRegistrationLib.simulation.elasticity import (
    COMPONENTS,
    body_load,
    mass_matrix,
    mean_strains,
    stiffness_matrix,
    traction_load,
)
from VICRegistrationLib.simulation.elements import FiniteElements
from VICRegistrationLib.simulation.problems import GRAVITY, InnerPressure, Material, SelfWeight
from VICRegistrationLib.simulation.solution import equivalent_stress, solve
from VICRegistrationLib.simulation.solver import rigid_motions, solve_elastic

INNER, OUTER, PRESSURE = 20.0, 30.0, 2.0
CENTER = np.array([105.0, -30.0, 60.0])
# Largest allowed difference where only rounding and the iteration's tolerance (1e-10) differ.
EXACT = 1e-7


def lame_displacement(radius, material):
    """Radial displacement of a thick-walled sphere under inner pressure (Timoshenko and Goodier, article 136)."""
    factor = PRESSURE * INNER**3 / (material.young * (OUTER**3 - INNER**3))
    nu = material.poisson
    return factor * ((1.0 - 2.0 * nu) * radius + (1.0 + nu) * OUTER**3 / (2.0 * radius**2))


def lame_energy(material):
    """Half of the pressure's work."""
    return 0.5 * PRESSURE * 4.0 * np.pi * INNER**2 * lame_displacement(INNER, material)


@lru_cache(maxsize=1)
def pressed_sphere(level, *, order, material):
    mesh = hollow_ball(INNER, OUTER, level=level, layers=2 ** (level - 1), order=order, center=CENTER)
    return solve(mesh, InnerPressure(PRESSURE), material)


def orders(errors):
    """Observed orders of convergence when sizes are halved."""
    errors = np.abs(errors)
    return np.log2(errors[:-1] / errors[1:])


@pytest.mark.parametrize("order", [1, 2])
def test_the_patch_test_is_passed_a_constant_stress_is_exact(order):
    mesh = ball(20.0, level=1, order=order, center=CENTER)
    # Inner nodes out of their regular places; with second order the straight inner edges bend too.
    inner = np.setdiff1d(np.arange(len(mesh.points)), mesh.triangles)
    mesh.points[inner] += np.random.default_rng(1).normal(scale=0.4, size=(len(inner), 3))
    material = Material(young=50.0, poisson=0.3)
    stress = np.array([3.0, -1.0, 2.0, 0.7, -0.4, 1.1])
    tensor = stress[np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])]
    elements = FiniteElements(mesh)
    load = traction_load(elements, elements.outside, tensor)
    solved = solve_elastic(stiffness_matrix(elements, material), load, elements.places, mass=mass_matrix(elements))
    strain = mean_strains(elements, solved.values.reshape(3, -1))
    np.testing.assert_allclose(material.stress(strain), np.tile(stress, (len(strain), 1)), atol=EXACT)


def test_an_outer_pressure_gives_a_uniform_compression():
    material = Material(young=50.0, poisson=0.3)
    mesh = ball(20.0, level=1, order=2, center=CENTER)
    found = solve(mesh, InnerPressure(PRESSURE, surface="ball_outside"), material)
    # Bulk modulus K: every normal strain is -p / 3 K.
    uniform = -PRESSURE * (1.0 - 2.0 * 0.3) / 50.0
    np.testing.assert_allclose(found.strain, np.tile([uniform] * 3 + [0.0] * 3, (len(found.strain), 1)), atol=1e-9)
    np.testing.assert_allclose(found.displacement, uniform * (mesh.points - CENTER), atol=1e-7)


@pytest.mark.parametrize(
    ("order", "levels", "least", "poisson"),
    [
        (1, (1, 2, 3), 1.7, 0.3),
        (1, (1, 2, 3), 1.7, 0.45),
        pytest.param(2, (1, 2, 3), 3.6, 0.3, marks=pytest.mark.long),
        (2, (1, 2, 3), 3.6, 0.45),
    ],
)
def test_energy_converges_at_the_element_s_order_to_lame_s_solution(order, levels, least, poisson):
    material = Material(young=100.0, poisson=poisson)
    errors = np.array([pressed_sphere(level, order=order, material=material).energy for level in levels])
    errors = errors / lame_energy(material) - 1.0
    # Energy converges at twice the element's order; linear elements get there slowly when nearly incompressible.
    assert orders(errors)[-1] > least
    assert abs(errors[-1]) < (0.06 if order == 1 else 4e-4)


def test_displacement_and_stress_are_lame_s():
    material = Material(young=100.0, poisson=0.45)
    found = pressed_sphere(3, order=2, material=material)
    offset = found.mesh.points - CENTER
    radius = np.linalg.norm(offset, axis=1)
    known = lame_displacement(radius, material)
    np.testing.assert_allclose(found.displacement, offset * (known / radius)[:, None], atol=0.005 * known.max())
    # The radial and the tangential stress differ by 3 p a^3 b^3 / (2 (b^3 - a^3) r^3).
    middles = np.linalg.norm(offset[found.mesh.tetrahedra[:, :4]].mean(axis=1), axis=1)
    difference = 1.5 * PRESSURE * INNER**3 * OUTER**3 / ((OUTER**3 - INNER**3) * middles**3)
    # Of the mean tensor of an element that spans 11 degrees, in which the radial direction turns: 3 % less.
    np.testing.assert_allclose(found.equivalent_stress, difference, rtol=0.12)
    np.testing.assert_allclose(np.median(found.equivalent_stress / difference), 0.97, atol=0.02)


@pytest.mark.parametrize(("order", "levels", "least"), [(1, (2, 3, 4), 1.6), (2, (1, 2, 3), 3.5)])
def test_energy_under_self_weight_converges_at_the_element_s_order(order, levels, least):
    energies = []
    for level in levels:
        found = solve(ball(30.0, level=level, order=order), SelfWeight(), Material(young=10.0, poisson=0.3))
        energies.append(found.energy + found.foundation_energy)
    assert orders(np.diff(energies))[-1] > least


def test_the_foundation_carries_the_whole_weight():
    mesh = ball(30.0, level=3, order=2, center=CENTER)
    material = Material(young=20.0, density=1000.0)
    found = solve(mesh, SelfWeight(direction=(0.0, 0.0, -2.0), foundation=0.5), material)
    volume = 4.0 / 3.0 * np.pi * 30.0**3
    # 1000 kg/m^3 is 1e-6 kg/mm^3, and 1 N is 1000 mN; the curved ball's volume is good to 2e-5.
    np.testing.assert_allclose(found.force, [0.0, 0.0, -1e-3 * GRAVITY * volume], rtol=1e-4, atol=1e-6)
    # A rigid ball sinks by weight / (k area).
    sunk = 1e-3 * GRAVITY * volume / (0.5 * 4.0 * np.pi * 30.0**2)
    mesh = ball(30.0, level=2, order=2, center=CENTER)
    rigid = solve(
        mesh, SelfWeight(direction=(0.0, 0.0, -1.0), foundation=0.5), dataclasses.replace(material, young=1e5)
    )
    np.testing.assert_allclose(rigid.displacement, np.tile([0.0, 0.0, -sunk], (len(mesh.points), 1)), atol=0.005 * sunk)


def test_work_of_the_load_is_twice_the_energy():
    mesh = ball(30.0, level=2, order=2)
    material, problem = Material(young=20.0), SelfWeight()
    found = solve(mesh, problem, material)
    elements = FiniteElements(mesh)
    work = body_load(elements, problem.body_force(material)) @ found.displacement[elements.nodes].T.ravel()
    assert work == pytest.approx(2.0 * (found.energy + found.foundation_energy), rel=1e-8)


def test_a_free_organ_neither_moves_nor_turns_on_average():
    mesh = hollow_ball(INNER, OUTER, level=1, layers=1, center=CENTER)
    uneven = TetrahedralMesh(
        mesh.points * [1.0, 1.3, 0.8], mesh.tetrahedra, mesh.tetrahedron_groups, mesh.triangles, mesh.triangle_groups
    )
    found = solve(uneven, InnerPressure(), Material())
    elements = FiniteElements(uneven)
    weighted = mass_matrix(elements) @ found.displacement[elements.nodes]
    motions = rigid_motions(elements.places)
    largest = np.abs(found.displacement).max() * np.abs(weighted).sum() / np.abs(found.displacement).mean()
    np.testing.assert_allclose(np.einsum("knm,nk->m", motions, weighted) / largest, 0.0, atol=EXACT)


def constant_strain_energy(mesh, material, pressure, foundation):
    """Energy by elements of constant strain, assembled by hand and solved directly; nothing of scikit-fem."""
    lame_lambda, mu = material.lame
    hooke = np.zeros((6, 6))
    hooke[:3, :3] = lame_lambda
    hooke += np.diag([2.0 * mu] * 3 + [mu] * 3)
    corners = mesh.points[mesh.tetrahedra]
    inverse = np.linalg.inv(np.concatenate([np.ones((*corners.shape[:2], 1)), corners], axis=2))
    slopes = inverse[:, 1:].transpose(0, 2, 1)
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    strains = np.zeros((len(corners), 6, 12))
    for row, (i, j) in enumerate(COMPONENTS):
        # Engineering strains: shears count twice.
        strains[:, row, i::3] += slopes[:, :, j] * (1.0 if i != j else 0.5)
        strains[:, row, j::3] += slopes[:, :, i] * (1.0 if i != j else 0.5)
    local = np.einsum("m,mra,rs,msb->mab", volumes, strains, hooke, strains)
    dofs = (3 * mesh.tetrahedra[:, :, None] + np.arange(3)).reshape(len(corners), 12)
    n = 3 * len(mesh.points)
    rows, columns = np.repeat(dofs, 12, axis=1).ravel(), np.tile(dofs, 12).ravel()
    stiffness = coo_matrix((local.ravel(), (rows, columns)), shape=(n, n)).tocsr()
    load, springs = np.zeros((len(mesh.points), 3)), np.zeros((len(mesh.points), len(mesh.points)))
    for name, sign in (("ball_inside", -pressure), ("ball_outside", None)):
        triangles = mesh.triangles[mesh.triangle_groups[name]]
        a, b, c = mesh.points[triangles].transpose(1, 0, 2)
        areas = np.cross(b - a, c - a) / 2.0
        for k in range(3):
            if sign is not None:
                np.add.at(load, triangles[:, k], sign * areas / 3.0)
            for other in range(3):
                share = np.linalg.norm(areas, axis=1) / (6.0 if k == other else 12.0)
                if sign is None:
                    np.add.at(springs, (triangles[:, k], triangles[:, other]), foundation * share)
    held = stiffness + coo_matrix(np.kron(springs, np.eye(3))).tocsr()
    values = spsolve(held.tocsc(), load.ravel())
    return values @ (stiffness @ values) / 2.0, values.reshape(-1, 3)


def test_inner_pressure_is_answered_alike_by_a_second_solver():
    mesh = hollow_ball(INNER, OUTER, level=2, layers=2, center=CENTER)
    material = Material()
    found = solve(mesh, InnerPressure(PRESSURE, foundation=0.2), material)
    energy, displacement = constant_strain_energy(mesh, material, PRESSURE, 0.2)
    # The same equations, to the iteration's tolerance.
    assert found.energy == pytest.approx(energy, rel=EXACT)
    np.testing.assert_allclose(found.displacement, displacement, atol=EXACT * np.abs(displacement).max())


def test_results_turn_with_the_organ():
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    mesh = ball(20.0, level=2)
    mesh.points[:] *= [1.0, 0.7, 1.2]
    turned = dataclasses.replace(mesh, points=mesh.points @ turn.T)
    one = solve(mesh, SelfWeight((0.0, -1.0, 0.0)), Material(young=10.0))
    other = solve(turned, SelfWeight(tuple(turn @ [0.0, -1.0, 0.0])), Material(young=10.0))
    np.testing.assert_allclose(other.displacement, one.displacement @ turn.T, atol=1e-7)
    np.testing.assert_allclose(other.equivalent_stress, one.equivalent_stress, atol=1e-6)


def test_pressure_finds_the_cavity_without_groups():
    mesh = hollow_ball(INNER, OUTER, level=1, layers=1)
    nameless = dataclasses.replace(mesh, triangle_groups={})
    named = solve(mesh, InnerPressure(surface="ball_inside"))
    assert solve(nameless, InnerPressure()).energy == pytest.approx(named.energy, rel=1e-9)
    # The outward push of a closed cavity adds up to nothing.
    np.testing.assert_allclose(named.force, 0.0, atol=1e-9)


def test_a_large_strain_is_told():
    mesh = hollow_ball(INNER, OUTER, level=1, layers=1)
    assert not solve(mesh, InnerPressure(0.1)).notes
    (note,) = solve(mesh, InnerPressure(100.0)).notes
    assert "beyond the 5 %" in note


@pytest.mark.parametrize(
    ("problem", "match"),
    [
        (InnerPressure(), "has no cavity for an inner pressure"),
        (InnerPressure(surface="wall"), "no group of triangles 'wall'; it has: ball_outside, half"),
        (InnerPressure(surface="half"), "pushes the organ away"),
    ],
)
def test_a_pressure_that_cannot_act_is_refused(problem, match):
    mesh = ball(20.0, level=1)
    groups = {**mesh.triangle_groups, "half": np.flatnonzero(mesh.points[mesh.triangles].mean(axis=1)[:, 2] > 0.0)}
    with pytest.raises(ValueError, match=match):
        solve(dataclasses.replace(mesh, triangle_groups=groups), problem)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Material(young=0.0), "Young's modulus of 0 kPa"),
        (lambda: Material(young=1e300), "diamond has 1e\\+09"),
        (lambda: Material(poisson=0.5), "Poisson's ratio of 0.5"),
        (lambda: Material(density=float("nan")), "density of nan"),
        (lambda: SelfWeight(direction=(0.0, 0.0, 0.0)), "three numbers R,A,S, not all 0"),
        (lambda: SelfWeight(foundation=0.0), "foundation of 0 kPa/mm"),
        (lambda: InnerPressure(float("inf")), "pressure of inf kPa"),
        (lambda: InnerPressure(foundation=-1.0), "foundation of -1 kPa/mm"),
    ],
)
def test_options_that_make_no_sense_are_refused(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_equivalent_stress_is_that_of_simple_states():
    stress = np.array([[3.0, 0, 0, 0, 0, 0], [2.0, 2.0, 2.0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0]])
    np.testing.assert_allclose(equivalent_stress(stress), [3.0, 0.0, np.sqrt(3.0)])
