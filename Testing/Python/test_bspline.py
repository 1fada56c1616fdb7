"""B-spline bases in one variable: values, derivatives, exact knot insertion, exact integrals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import interpolate

from VICRegistrationLib.geometry import bspline

# Degree and knots.
SPLINES = {
    "linear": (1, [0, 0, 0.4, 1, 1]),
    "quadratic": (2, [0, 0, 0, 0.2, 0.7, 1, 1, 1]),
    "cubic": (3, [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]),
    "non-uniform": (3, [-2, -2, -2, -2, -1.9, 0.3, 0.31, 4, 4, 4, 4]),
    "unclamped": (3, [0, 0.1, 0.3, 0.6, 1.0, 1.5, 2.1, 2.8, 3.6]),
    "half clamped": (2, [0, 0, 0, 1, 2, 3.5, 4]),
    "multiple knots": (3, [0, 0, 0, 0, 0.3, 0.3, 0.6, 0.6, 0.6, 1, 1, 1, 1]),
    "discontinuous": (2, [0, 0, 0, 0.5, 0.5, 0.5, 1, 1, 1]),
    "quintic": (5, [0, 0, 0, 0, 0, 0, 0.1, 0.5, 0.5, 0.9, 1, 1, 1, 1, 1, 1]),
}


@pytest.fixture(params=SPLINES, ids=lambda name: name.replace(" ", "-"))
def spline(request):
    degree, knots = SPLINES[request.param]
    return degree, np.array(knots, dtype=float)


def samples(degree, knots, number=101):
    """Parameters over the whole domain, both ends and all knots included."""
    low, high = bspline.domain(degree, knots)
    return np.unique(np.concatenate([np.linspace(low, high, number), bspline.span_limits(degree, knots)]))


def between_knots(degree, knots, margin=1e-3):
    """Parameters away from knots, where every derivative exists."""
    limits = bspline.span_limits(degree, knots)
    fractions = np.linspace(margin, 1.0 - margin, 9)
    return (limits[:-1, None] + np.diff(limits)[:, None] * fractions).ravel()


def test_basis_functions_sum_to_one_and_are_not_negative(spline):
    degree, knots = spline
    matrix = bspline.collocation(degree, knots, samples(degree, knots)).toarray()
    # A sum of degree + 1 terms, each right to a few rounding errors.
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-14)
    assert matrix.min() >= -1e-16


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_basis_and_derivatives_are_those_of_scipy(spline, derivative):
    degree, knots = spline
    x = between_knots(degree, knots)
    matrix = bspline.collocation(degree, knots, x, derivative).toarray()
    expected = np.zeros_like(matrix)
    if derivative <= degree:
        expected = interpolate.BSpline(knots, np.eye(matrix.shape[1]), degree)(x, nu=derivative)
    # Relative to the largest entry: narrow spans make large derivatives.
    np.testing.assert_allclose(matrix, expected, atol=1e-12 * np.abs(expected).max())


def test_derivatives_beyond_the_degree_vanish():
    assert bspline.collocation(1, np.array([0.0, 0, 1, 1]), [0.0, 0.3, 1.0], 2).toarray().max() == 0.0


def test_a_clamped_spline_starts_and_ends_in_its_control_points():
    knots = bspline.uniform_clamped_knots(3, 7)
    ends = bspline.collocation(3, knots, [0.0, 1.0]).toarray()
    np.testing.assert_array_equal(ends, np.eye(7)[[0, -1]])


def test_greville_abscissae_reproduce_the_parameter(spline):
    degree, knots = spline
    x = samples(degree, knots)
    control = bspline.greville_abscissae(degree, knots)
    # Linear precision: the control values at the Greville abscissae give the line itself.
    np.testing.assert_allclose(bspline.collocation(degree, knots, x) @ control, x, atol=1e-14 * np.ptp(knots) * 10)


def test_knot_insertion_does_not_change_the_curve(spline):
    degree, knots = spline
    low, high = bspline.domain(degree, knots)
    control = np.random.default_rng(0).normal(size=(len(knots) - degree - 1, 3))
    new = low + (high - low) * np.array([0.11, 0.5001, 0.5001, 0.83])
    refined, matrix = bspline.knot_insertion(degree, knots, new)
    x = samples(degree, knots)
    before = bspline.collocation(degree, knots, x) @ control
    after = bspline.collocation(degree, refined, x) @ (matrix @ control)
    assert len(refined) == len(knots) + 4
    np.testing.assert_array_equal(refined, np.sort(np.concatenate([knots, new])))
    # At a jump the value depends on the side, and insertion keeps the side.
    np.testing.assert_allclose(after, before, atol=1e-13)


def test_existing_knots_can_be_inserted_up_to_a_break():
    degree, knots = 3, bspline.uniform_clamped_knots(3, 6)
    inner = knots[4]
    refined, matrix = bspline.knot_insertion(degree, knots, [inner] * 3)
    control = np.random.default_rng(1).normal(size=(6, 2))
    x = np.linspace(0.0, 1.0, 50)
    after = bspline.collocation(degree, refined, x) @ (matrix @ control)
    np.testing.assert_allclose(after, bspline.collocation(degree, knots, x) @ control, atol=1e-13)
    with pytest.raises(ValueError, match="multiplicity 4 already"):
        bspline.knot_insertion(degree, knots, [inner] * 4)


def test_insertion_outside_the_domain_is_refused():
    with pytest.raises(ValueError, match="outside the domain 0 to 1; insert knots inside it"):
        bspline.knot_insertion(3, bspline.uniform_clamped_knots(3, 6), [1.2])


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_a_periodic_spline_is_smooth_and_closed_to_the_last_bit_in_clamped_form(degree):
    breaks = np.array([0.0, 0.1, 0.25, 0.4, 0.5, 0.7, 0.85, 0.9, 1.0])
    knots, matrix = bspline.periodic_to_clamped(degree, breaks)
    distinct = np.random.default_rng(degree).normal(size=(len(breaks) - 1, 3))
    control = matrix @ distinct
    assert matrix.shape == (len(breaks) - 1 + degree, len(breaks) - 1)
    np.testing.assert_array_equal(control[0], control[-1])
    for derivative in range(degree):
        ends = bspline.collocation(degree, knots, [0.0, 1.0], derivative) @ control
        # Each order divides by the narrowest span, 0.05, once more.
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-13 * 20.0**derivative * 10)


def test_a_periodic_spline_in_clamped_form_is_the_periodic_spline():
    breaks = np.linspace(0.0, 1.0, 9)
    knots, matrix = bspline.periodic_to_clamped(3, breaks)
    distinct = np.random.default_rng(5).normal(size=8)
    unclamped = np.concatenate([breaks[-4:-1] - 1.0, breaks, breaks[1:4] + 1.0])
    x = np.linspace(0.0, 1.0, 40)
    expected = interpolate.BSpline(unclamped, distinct[np.arange(11) % 8], 3)(x)
    np.testing.assert_allclose(bspline.collocation(3, knots, x) @ (matrix @ distinct), expected, atol=1e-14)


def test_a_closed_spline_needs_enough_spans():
    with pytest.raises(ValueError, match="3 spans were given; a closed spline of degree 3 needs at least 4"):
        bspline.periodic_to_clamped(3, np.linspace(0.0, 1.0, 4))


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_gram_matrices_are_the_integrals_of_products(spline, derivative):
    degree, knots = spline
    limits = bspline.span_limits(degree, knots)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    expected = 0.0
    for low, high in zip(limits[:-1], limits[1:]):
        x = (low + high) / 2.0 + (high - low) / 2.0 * nodes
        basis = np.nan_to_num(interpolate.BSpline(knots, np.eye(len(knots) - degree - 1), degree)(x))
        if derivative:
            basis = bspline.collocation(degree, knots, x, derivative).toarray()
        expected = expected + basis.T @ (basis * (weights * (high - low) / 2.0)[:, None])
    matrix = bspline.gram(degree, knots, derivative).toarray()
    np.testing.assert_allclose(matrix, expected, atol=1e-12 * max(np.abs(expected).max(), 1e-300))
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-15 * np.abs(matrix).max())


def test_gauss_points_integrate_polynomials_exactly():
    x, weights = bspline.gauss_points(3, np.array([0.0, 0, 0, 0, 0.3, 1, 1, 1, 1]), 4)
    # Four points integrate up to degree 7 exactly.
    assert weights @ x**7 == pytest.approx(1.0 / 8.0, rel=1e-14)


@pytest.mark.parametrize(
    ("degree", "knots", "message"),
    [
        (0, [0, 1], "Degree 0 was given; a whole number of at least 1"),
        (1.5, [0, 0, 1, 1], "Degree 1.5 was given"),
        (3, [0, 0, 0, 1, 1, 1], "6 knots were given; degree 3 needs at least 8"),
        (1, [[0, 0, 1, 1]], "needs at least 4 in one row"),
        (1, [0, 0.5, 0.2, 1], "decrease somewhere or are not finite"),
        (1, [0, 0, np.nan, 1], "decrease somewhere or are not finite"),
        (1, [0, 0, 1, np.inf], "decrease somewhere or are not finite"),
        (1, [0, 1, 1, 2], "span no interval for degree 1"),
    ],
)
def test_unusable_knots_are_refused_with_what_is_needed(degree, knots, message):
    with pytest.raises(ValueError, match=message):
        bspline.validated_knots(degree, np.array(knots, dtype=float))


def test_parameters_outside_the_domain_are_refused():
    with pytest.raises(ValueError, match="reach from -0.1 to 1; the surface is defined on 0 to 1"):
        bspline.collocation(3, bspline.uniform_clamped_knots(3, 5), [-0.1, 1.0])


def test_matrices_that_were_made_before_are_not_those_that_were_given_out():
    knots = bspline.uniform_clamped_knots(3, 7)
    x = np.linspace(0.0, 1.0, 9)
    for make in (
        lambda: bspline.collocation(3, knots, x),
        lambda: bspline.knot_insertion(3, knots, [0.3])[1],
    ):
        first = make()
        kept = first.toarray()
        first.data[:] = 0.0
        np.testing.assert_array_equal(make().toarray(), kept)
    bspline.knot_insertion(3, knots, [0.3])[0][:] = 0.0
    assert bspline.knot_insertion(3, knots, [0.3])[0][-1] == 1.0
