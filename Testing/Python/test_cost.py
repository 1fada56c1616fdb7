"""The cost: residuals, weights and losses, and derivatives against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hippocampus import ellipsoid_in_box
from scipy import sparse
from test_confidence import RADIUS, ball

from VICRegistrationLib.geometry import bspline, models
from VICRegistrationLib.geometry.parametrization import affine, closed_organ
from VICRegistrationLib.imaging.image import Image
from VICRegistrationLib.imaging.sampling import Sampler
from VICRegistrationLib.registration.cost import Correlation, Objective, huber_shares
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.sample_grid import SampledSurface, SampleGrid
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.registration.virtual_image import IntensityProfile, VirtualImage, cosine_ramp

AXES = np.array([[15.0, 2.0, 0.0], [-1.5, 11.0, 1.0], [0.0, 2.5, 20.0]])
DEPTHS = np.linspace(-0.5, 0.5, 5)


def organ(closure="smooth", net=(9, 7)):
    return models.closed_organ(net, closure=closure, axes=AXES, center=(3.0, -4.0, 5.0))


PARAMETRIZATIONS = {
    "affine": lambda: affine(organ()),
    "translation": lambda: affine(organ(), free="translation"),
    "four of the twelve": lambda: affine(organ(), free=("T2", "R01", "R11", "R20")),
    "affine bell": lambda: affine(models.bell(30.0)),
    "smooth organ": lambda: closed_organ(organ()),
    "paper's organ": lambda: closed_organ(organ("paper"), closure="paper"),
}


class Waves:
    """Slow waves in a box, in place of a sampled image: with continuous second derivatives everywhere."""

    def __init__(self, sign=1.0):
        self.sign = sign

    def values_and_gradients(self, points):
        x, y, z = np.moveaxis(points, -1, 0)
        first, second, third = 0.11 * x + 0.05 * y, 0.09 * y - 0.07 * z, 0.1 * z + 0.04 * x
        values = 300.0 + 100.0 * np.sin(first) + 80.0 * np.cos(second) + 60.0 * np.sin(third)
        slopes = np.stack([100.0 * np.cos(first), -80.0 * np.sin(second), 60.0 * np.cos(third)], axis=-1)
        gradients = slopes @ [[0.11, 0.05, 0.0], [0.0, 0.09, -0.07], [0.04, 0.0, 0.1]]
        inside = (np.abs(points - [2.0, -3.0, 4.0]) <= 50.0).all(axis=-1)
        scale = self.sign * inside
        return scale * values, scale[..., None] * gradients, inside

    def values(self, points):
        values, _, inside = self.values_and_gradients(points)
        return values, inside


@pytest.fixture(scope="module")
def smooth_image():
    return Waves()


def virtual(inside, outside, width, **options):
    return VirtualImage(IntensityProfile(inside, outside, width), **options)


def make(sampler, parametrization, *, shape=(12, 8), image=None, depths=DEPTHS, use_sparse=None):
    image = image or virtual(400.0, 200.0, 6.0, mode="given")
    surface = SampledSurface(parametrization, SampleGrid.on(parametrization.surface, shape), use_sparse=use_sparse)
    return Correlation(sampler, image, surface, depths=image.profile.width * depths)


def reach(parametrization):
    """Largest displacement of a control point by one unit of each degree of freedom, (n_dof,) mm."""
    largest = np.zeros(parametrization.n_dof)
    for matrix, index in zip(parametrization.matrices, parametrization.indices):
        largest[index] = np.maximum(largest[index], abs(matrix).max(axis=0).toarray().ravel())
    return largest


def away_from_start(parametrization, size_mm=0.5):
    """Degrees of freedom that each move control points by so much at most."""
    random = np.random.default_rng(7)
    return size_mm * random.uniform(-1.0, 1.0, parametrization.n_dof) / reach(parametrization)


def differences(correlation, q):
    """Central differences of all residuals, (n * m, n_dof), with the levels held."""
    # Steps of 1e-3 mm: waves of 0.15 radian per mm give (1e-3 * 0.15)^2 / 6 = 4e-9, rounding some 1e-12.
    steps = 1e-3 / reach(correlation.parametrization)
    columns = [
        (correlation.sample(q + step).residuals - correlation.sample(q - step).residuals).ravel() / (2.0 * size)
        for size, step in zip(steps, np.diag(steps))
    ]
    return np.column_stack(columns)


def jacobian(correlation, samples, *, turning=True):
    """Differentiate all residuals, (n * m, n_dof); without the turning normal what is left is grad I . dS."""
    parametrization, bases = correlation.parametrization, correlation.surface.grid.bases
    n, m = samples.residuals.shape
    lever = correlation.depths[:, None] * samples.gradients
    result = np.zeros((n, m, parametrization.n_dof))
    for depth in range(m):
        parts = [samples.gradients[:, depth], *(samples.frame.normal_terms(lever[:, depth]) if turning else ())]
        for basis, part in zip(bases, parts):
            for k, (matrix, index) in enumerate(zip(parametrization.matrices, parametrization.indices)):
                result[:, depth, index] += part[:, k, None] * (basis @ matrix).toarray()
    return result.reshape(n * m, -1)


def relative(found, expected):
    """Largest error of the columns in units of each column's size."""
    return (np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0)).max()


@pytest.fixture(params=list(PARAMETRIZATIONS))
def parametrization(request):
    return PARAMETRIZATIONS[request.param]()


# ------------------------------------------------------------------ derivatives


def test_the_jacobian_agrees_with_finite_differences(smooth_image, parametrization):
    correlation = make(smooth_image, parametrization)
    q = away_from_start(parametrization)
    correlation.refresh(q)
    samples = correlation.sample(q)
    assert (samples.weights > 0.0).all()
    assert relative(jacobian(correlation, samples), differences(correlation, q)) < 1e-6


@pytest.mark.parametrize("mode", ["local", "organ", "given"])
def test_the_jacobian_holds_with_levels_and_edges_that_depend_on_the_place(smooth_image, mode):
    parametrization = closed_organ(organ())
    image = virtual(400.0, 200.0, 6.0, mode=mode, voxel=np.diag([2.0, 2.0, 5.0]))
    correlation = make(smooth_image, parametrization, image=image)
    q = away_from_start(parametrization)
    correlation.refresh(q)
    assert relative(jacobian(correlation, correlation.sample(q)), differences(correlation, q)) < 1e-6


def test_the_turning_normal_matters(smooth_image, parametrization):
    correlation = make(smooth_image, parametrization)
    q = away_from_start(parametrization)
    correlation.refresh(q)
    without = relative(jacobian(correlation, correlation.sample(q), turning=False), differences(correlation, q))
    # A translation turns no normal; for everything else the term is far above the 1e-6 of the whole.
    if all(name.startswith("T") for name in _names(parametrization)):
        assert without < 1e-6
    else:
        assert without > 1e-2


def _names(parametrization):
    return ("T",) if parametrization.n_dof == 3 and np.allclose(parametrization.scales(), 1.0) else ("R",)


def test_on_the_surface_itself_the_normal_has_no_lever(smooth_image):
    correlation = make(smooth_image, closed_organ(organ()), depths=np.zeros(1))
    q = away_from_start(correlation.parametrization)
    samples = correlation.sample(q)
    np.testing.assert_allclose(
        jacobian(correlation, samples), jacobian(correlation, samples, turning=False), rtol=0.0, atol=1e-12
    )


def test_the_gradient_is_the_jacobian_times_the_weighted_residuals(smooth_image, parametrization):
    correlation = make(smooth_image, parametrization)
    samples = correlation.sample(away_from_start(parametrization))
    expected = jacobian(correlation, samples).T @ (samples.weights * samples.residuals).ravel()
    found = correlation.gradient(samples)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_the_hessian_is_that_of_the_direct_term(smooth_image, parametrization):
    correlation = make(smooth_image, parametrization)
    samples = correlation.sample(away_from_start(parametrization))
    direct = jacobian(correlation, samples, turning=False)
    expected = direct.T @ (samples.weights.ravel()[:, None] * direct)
    np.testing.assert_allclose(correlation.hessian(samples), expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_sparse_matrices_give_the_same_numbers_as_dense_ones(smooth_image):
    parametrization = closed_organ(organ(net=(21, 21)))
    q = away_from_start(parametrization, 0.2)
    large, dense = (make(smooth_image, parametrization, shape=(24, 20), use_sparse=choice) for choice in (None, False))
    assert large.surface.sparse
    assert not dense.surface.sparse
    ours, theirs = large.sample(q), dense.sample(q)
    np.testing.assert_allclose(ours.residuals, theirs.residuals, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(large.gradient(ours), dense.gradient(theirs), rtol=0.0, atol=1e-14)
    hessian = large.hessian(ours)
    assert sparse.issparse(hessian)
    scale = np.abs(dense.hessian(theirs)).max()
    np.testing.assert_allclose(hessian.toarray(), dense.hessian(theirs), rtol=0.0, atol=1e-12 * scale)
    energies = [each.energies(bending=1e-3, sliding=0.3, anchor=2.0) for each in (large, dense)]
    np.testing.assert_allclose(energies[0].toarray(), energies[1], rtol=0.0, atol=1e-12)


def test_an_objective_is_the_sum_over_its_images(smooth_image):
    parametrization = closed_organ(organ())
    darker = Waves(-1.0)
    one = make(smooth_image, parametrization)
    other = Correlation(darker, virtual(-300.0, -200.0, 4.0), one.surface, depths=4.0 * DEPTHS)
    both = Objective([one, other])
    q = away_from_start(parametrization)
    both.refresh(q)
    parts = [Objective([each]) for each in (one, other)]
    values = [part.value(q, part.sample(q)) for part in parts]
    assert min(values) > 0.0
    assert both.value(q, both.sample(q)) == pytest.approx(sum(values))
    gradients = [part.gradient(q, part.sample(q)) for part in parts]
    np.testing.assert_allclose(both.gradient(q, both.sample(q)), sum(gradients), atol=1e-15)
    np.testing.assert_allclose(both.hessian(both.sample(q)), sum(p.hessian(p.sample(q)) for p in parts), atol=1e-15)
    assert both.displacement(q) == parts[0].displacement(q)
    np.testing.assert_allclose(both.scales(), parametrization.scales())


# ------------------------------------------------------------------ residuals and weights


def test_the_residual_is_real_minus_virtual_image_in_units_of_the_contrast(smooth_image):
    parametrization = closed_organ(organ())
    correlation = make(smooth_image, parametrization)
    q = away_from_start(parametrization)
    samples = correlation.sample(q)
    surface = parametrization.deform(q)
    u, v = (part.ravel() for part in np.meshgrid((np.arange(12) + 0.5) / 12, (np.arange(8) + 0.5) / 8, indexing="ij"))
    for depth, distance in enumerate(DEPTHS * 6.0):
        grey, _ = smooth_image.values(surface.points(u, v) + distance * surface.normals(u, v))
        virtual = 200.0 + 200.0 * cosine_ramp(distance / 6.0)
        np.testing.assert_allclose(samples.residuals[:, depth], (grey - virtual) / 200.0, atol=1e-12)


def test_samples_weigh_by_the_area_they_stand_for(smooth_image):
    correlation = make(smooth_image, closed_organ(organ()), shape=(64, 48))
    samples = correlation.sample(np.zeros(correlation.parametrization.n_dof))
    assert samples.weights.sum() == pytest.approx(1.0, rel=1e-12)
    share = samples.weights.sum(axis=1)
    below = samples.frame.points[:, 2] < 5.0
    # The organ is symmetric about its centre at S = 5, though its samples crowd at the poles.
    assert share[below].sum() == pytest.approx(0.5, abs=0.01)
    polar = share.reshape(64, 48)[:, 0].sum()
    assert polar < 0.25 / 48


def test_samples_outside_of_the_volume_carry_no_weight():
    k, j, i = np.indices((30, 30, 30))
    matrix = np.eye(4)
    matrix[:3, 3] = [-14.5, -14.5, -29.5]
    sampler = Sampler(Image((i + 2.0 * j + 3.0 * k).astype(float), matrix))
    lower = models.closed_organ(axes=10.0 * np.eye(3))
    # The volume ends at S = 0: it holds the lower half of the ball.
    correlation = make(sampler, closed_organ(lower), shape=(48, 40), depths=np.linspace(-0.5, 0.5, 3))
    samples = correlation.sample(np.zeros(correlation.parametrization.n_dof))
    positions = samples.frame.along_normals(correlation.depths)
    outside = positions[..., 2] > 0.0
    assert (samples.weights[outside] == 0.0).all()
    assert (samples.residuals[outside] == 0.0).all()
    assert (samples.weights[~outside] > 0.0).all()
    area = np.repeat(samples.frame.length[:, None], 3, axis=1)
    assert samples.weights.sum() == pytest.approx(area[~outside].sum() / area.sum(), rel=1e-12)
    assert samples.weights.sum() == pytest.approx(0.5, abs=0.02)
    assert np.isfinite(correlation.gradient(samples)).all()


def test_levels_are_held_until_they_are_refreshed(smooth_image):
    parametrization = closed_organ(organ())
    q = away_from_start(parametrization, 2.0)
    start = np.zeros(parametrization.n_dof)
    held, fresh = (make(smooth_image, parametrization, image=virtual(400.0, 200.0, 6.0)) for _ in range(2))
    held.refresh(start)
    before = held.sample(q).cost
    held.refresh(q)
    fresh.refresh(q)
    assert held.sample(q).cost == pytest.approx(fresh.sample(q).cost, rel=1e-12)
    assert held.sample(q).cost != pytest.approx(before, rel=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_organ_may_be_brighter_or_darker(smooth_image, sign):
    parametrization = closed_organ(organ())
    inverted = Waves(sign)
    image = virtual(sign * 400.0, sign * 200.0, 6.0, mode="given")
    reference = make(smooth_image, parametrization).sample(np.zeros(parametrization.n_dof))
    found = make(inverted, parametrization, image=image).sample(np.zeros(parametrization.n_dof))
    np.testing.assert_allclose(found.residuals, sign * reference.residuals, atol=1e-12)


@pytest.fixture(scope="module")
def uneven():
    """A ball of 15 mm and level 400 in 200; to the right in 330, above in 400. The volume ends 12 mm below its centre.

    Its surface, whose levels are found in the image, as a function of the mode.
    """
    matrix = np.diag([1.0, 1.0, 1.0, 1.0])
    matrix[:3, 3] = [-25.0, -25.0, -12.0]
    z, y, x = np.indices((38, 51, 51)) + np.array([-12.0, -25.0, -25.0])[:, None, None, None]
    around = np.where(z > 6.0, 400.0, np.where(x > 0.0, 330.0, 200.0))
    inside = np.clip(15.5 - np.sqrt(x**2 + y**2 + z**2), 0.0, 1.0)
    sampler, voxel = Sampler(Image(around + inside * (400.0 - around), matrix)), np.diag([1.0, 1.0, 2.0])
    space = closed_organ(models.closed_organ((17, 13), axes=15.0 * np.eye(3)))
    return lambda mode: make(sampler, space, shape=(32, 24), image=virtual(400.0, 200.0, 2.0, mode=mode, voxel=voxel))


def on_side(correlation):
    """Which lines look to the left, to the right and up, well off the places where the surroundings change."""
    x, _, z = correlation.surface.frame(np.zeros(correlation.surface.n_dof)).points.T
    low, level = z < -13.0, np.abs(z) < 4.0
    return level & (x < -7.0), level & (x > 7.0), z > 10.0, low


def test_a_line_counts_as_far_as_it_shows_the_step_between_the_levels(uneven):
    correlation = uneven("organ")
    samples = correlation.sample(np.zeros(correlation.surface.n_dof))
    share = samples.weights.sum(axis=1) / samples.frame.area
    left, right, above, below = on_side(correlation)
    np.testing.assert_allclose(share[left], 1.0)
    # A step of 70 beside one of 200 to the left and of none above: two thirds of the mean one.
    np.testing.assert_allclose(share[right], 0.655, atol=0.02)
    assert (share[above] < 0.05).all()
    assert (share[below] == 0.0).all()


def test_the_anchor_is_stronger_where_the_edge_is_weak_and_at_the_end_of_the_volume(uneven):
    correlation = uneven("local")
    factors = correlation.anchor_factors()
    left, right, above, below = on_side(correlation)
    assert (factors[left] == 1.0).all()
    # By the fourth power of the step, whose mean over neighbours falls from the left to the right.
    assert (factors[right] > 1.1).all()
    assert 6.0 < factors[right].max() < 10.0
    assert (factors[above] == 20.0).all()
    assert (factors[below] == 20.0).all()
    energies = [correlation.displacement_energy(tangential=0.0, normal=each) for each in (0.0, 1.0)]
    larger = models.closed_organ((17, 13), axes=16.0 * np.eye(3))
    frame = correlation.sample(np.zeros(correlation.surface.n_dof)).frame
    lift, blur = correlation.parametrization.fit(larger.control_net), correlation.virtual.blur(frame.normals)
    # One millimetre outward everywhere. Where voxels are long across the surface, it is held less.
    assert lift @ energies[0] @ lift == 0.0
    assert lift @ energies[1] @ lift == pytest.approx(np.average(factors / blur**2, weights=frame.area), rel=0.02)


def test_a_wave_from_pole_to_pole_costs_the_bending_times_its_mean_square_in_widths(smooth_image):
    parametrization = closed_organ(organ(net=(9, 21)))
    correlation, surface = make(smooth_image, parametrization), parametrization.surface
    at = bspline.greville_abscissae(surface.degrees[1], surface.knots_v)
    basis = bspline.collocation(surface.degrees[1], surface.knots_v, at).toarray()
    wave = np.linalg.solve(basis, np.cos(2.0 * np.pi * at))
    q = parametrization.fit(surface.control_net + 3.0 * wave[:, None] * [0.6, 0.0, 0.8])
    # A height of 3 mm on a ramp of 6 mm; the mean square of a cosine is a half.
    energy = q @ correlation.energies(bending=0.2, sliding=0.0, anchor=0.0) @ q
    assert energy == pytest.approx(0.2 * (3.0 / 6.0) ** 2 / 2.0, rel=0.03)


# ------------------------------------------------------------------ losses


def test_huber_takes_from_the_large_ones():
    residuals = np.array([0.1, -0.1, 0.1, -0.1, 0.1, 1.0, -2.0])[:, None]
    shares = huber_shares(residuals, np.ones_like(residuals))[:, 0]
    np.testing.assert_array_equal(shares[:5], 1.0)
    # Twice the scaled median, over the size.
    assert shares[5] == pytest.approx(2.0 * 1.4826 * 0.1)
    assert shares[6] == pytest.approx(shares[5] / 2.0)


def test_samples_without_weight_do_not_set_the_scale():
    residuals, weights = np.array([[0.1, 0.1, 5.0, 5.0, 5.0]]), np.array([[1.0, 1.0, 0.0, 0.0, 0.0]])
    assert huber_shares(residuals, weights)[0, 0] == 1.0
    assert huber_shares(residuals, weights)[0, 2] < 0.1
    assert np.isfinite(huber_shares(residuals, np.zeros_like(weights))).all()


def test_small_clots_at_the_wall_dent_the_surface_less():
    image = ball()
    k, j, i = np.indices(image.array.shape)
    points = image.to_ras(np.stack([i, j, k], axis=-1))
    array = image.array.copy()
    for turn in np.arange(6) * np.pi / 3.0:
        array[np.linalg.norm(points - [18.0 * np.cos(turn), 18.0 * np.sin(turn), 0.0], axis=-1) < 2.5] = 60.0
    clotted = Image(array, image.ijk_to_ras)
    region = ellipsoid_in_box(clotted, [[-RADIUS] * 3, [RADIUS] * 3])
    means = {}
    for loss in ("squares", "huber"):
        fit = finish(fit_region(clotted, region, FitOptions(loss=loss)))
        assert fit.problems == ()
        means[loss] = np.abs(np.linalg.norm(fit.confidence.points, axis=2) - RADIUS).mean()
    # Measured: 0.12 and 0.08 mm.
    assert means["huber"] < 0.85 * means["squares"]
