"""Minimisation of the correlation's cost: Gauss-Newton with Levenberg-Marquardt damping, and gradient descent.

Both are generators of iterates, so that a caller can show progress and cancel between any two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from .correlation import Correlation, Frame, Samples

# A step that turns the surface's normals further than this mean cosine would fold it.
_MINIMUM_COSINE = 0.5


@dataclass(frozen=True, eq=False)
class Iterate:
    """State after one iteration.

    Parameters
    ----------
    q : (n_dof,) ndarray
        Degrees of freedom.
    cost : float
        Mean squared residual in units of the contrast, without the regularisation.
    decrease : float
        Relative decrease of the cost and its regularisation in this iteration.
    expected : float
        Relative decrease that the first step tried was expected to bring; far more than `decrease` where the solver is
        stuck.
    change : float
        Largest change of a degree of freedom in this iteration.
    displacement : float
        Largest displacement of a control point in this iteration, mm.
    """

    q: np.ndarray
    cost: float
    decrease: float
    expected: float
    change: float
    displacement: float


class Objective:
    """Cost of a correlation plus a quadratic regularisation about a reference.

    Parameters
    ----------
    correlation : Correlation
    stiffness : (n_dof, n_dof) ndarray or sparse matrix, optional
        K of the added term (q - q_ref)' K (q - q_ref), dimensionless; none if not given.
    reference : (n_dof,) ndarray, optional
        q_ref, zero if not given.
    """

    def __init__(self, correlation: Correlation, *, stiffness=None, reference: np.ndarray | None = None):
        self.correlation = correlation
        self.stiffness = stiffness
        n_dof = correlation.parametrization.n_dof
        self.reference = np.zeros(n_dof) if reference is None else reference

    def value(self, q: np.ndarray, samples: Samples) -> float:
        """Cost plus regularisation."""
        if self.stiffness is None:
            return samples.cost
        offset = q - self.reference
        return samples.cost + float(offset @ (self.stiffness @ offset))

    def gradient(self, q: np.ndarray, samples: Samples) -> np.ndarray:
        """Half the derivative of the value, (n_dof,)."""
        gradient = self.correlation.gradient(samples)
        if self.stiffness is not None:
            gradient += self.stiffness @ (q - self.reference)
        return gradient

    def hessian(self, samples: Samples):
        """Half the Gauss-Newton second derivative of the value."""
        hessian = self.correlation.hessian(samples)
        return hessian if self.stiffness is None else hessian + self.stiffness

    def displacement(self, step: np.ndarray) -> float:
        """Largest displacement of a control point by a step of the degrees of freedom, mm."""
        parametrization = self.correlation.parametrization
        moved = [m @ step[index] for m, index in zip(parametrization.matrices, parametrization.indices)]
        return float(np.sqrt(sum(part**2 for part in moved)).max())


def gauss_newton(objective: Objective, q: np.ndarray, *, largest_step: float) -> Iterator[Iterate]:
    """Gauss-Newton iterations with Levenberg-Marquardt damping, without end.

    Parameters
    ----------
    objective : Objective
    q : (n_dof,) ndarray
        Start.
    largest_step : float
        Largest displacement of a control point in one iteration, mm; longer steps are shortened.

    Yields
    ------
    Iterate
        One for every iteration. An iteration that finds no better point yields the old one with no displacement.

    Notes
    -----
    The damping follows the ratio of the real to the predicted decrease (Nielsen, IMM-REP-1999-05).
    """
    damping, growth = 1e-3, 4.0
    while True:
        objective.correlation.refresh(q)
        samples = objective.correlation.sample(q)
        value = objective.value(q, samples)
        gradient = objective.gradient(q, samples)
        hessian = objective.hessian(samples)
        expected = None
        for _ in range(8):
            step = _damped_solution(hessian, gradient, damping)
            moved = objective.displacement(step)
            scale = min(1.0, largest_step / max(moved, 1e-300))
            step, moved = scale * step, scale * moved
            trial = objective.correlation.sample(q + step)
            decrease = value - objective.value(q + step, trial)
            predicted = -float(step @ (2.0 * gradient + hessian @ step))
            expected = predicted if expected is None else expected
            if decrease > 0.0 and _keeps_orientation(samples, trial):
                gain = decrease / predicted if predicted > 0.0 else 0.0
                damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-4)
                growth = 4.0
                break
            damping, growth = min(damping * growth, 1e6), 2.0 * growth
        else:
            step, trial, decrease, moved = np.zeros_like(q), samples, 0.0, 0.0
        q = q + step
        shares = _share(decrease, value), _share(expected, value)
        yield Iterate(q, trial.cost, *shares, float(np.abs(step).max()), moved)


def gradient_descent(objective: Objective, q: np.ndarray, *, largest_step: float) -> Iterator[Iterate]:
    """Steepest descent with a line search, without end: the optimiser of the paper.

    Parameters
    ----------
    objective, q, largest_step
        As in :func:`gauss_newton`.

    Yields
    ------
    Iterate
        One for every iteration.

    Notes
    -----
    Degrees of freedom are normalised by the displacement they cause (the parameter normalisation that the paper asks
    for when translations are free too). The step length doubles after a success and halves until the cost falls.
    """
    normalisation = 1.0 / np.maximum(objective.correlation.parametrization.scales(), 1e-12) ** 2
    length = None
    while True:
        objective.correlation.refresh(q)
        samples = objective.correlation.sample(q)
        value = objective.value(q, samples)
        gradient = objective.gradient(q, samples)
        direction = -normalisation * gradient
        slope = 2.0 * float(gradient @ direction)
        reach = max(objective.displacement(direction), 1e-300)
        length = min(largest_step / reach, 2.0 * length if length else 0.5 * largest_step / reach)
        for _ in range(30):
            step = length * direction
            trial = objective.correlation.sample(q + step)
            decrease = value - objective.value(q + step, trial)
            if decrease >= -1e-4 * length * slope and _keeps_orientation(samples, trial):
                break
            length /= 2.0
        else:
            step, trial, decrease = np.zeros_like(q), samples, 0.0
        q = q + step
        # The slope alone promises nothing that could be compared: descent is expected to bring what it brings.
        share = _share(decrease, value)
        yield Iterate(q, trial.cost, share, share, float(np.abs(step).max()), objective.displacement(step))


SOLVERS = {"gauss-newton": gauss_newton, "gradient-descent": gradient_descent}


def _share(decrease: float, value: float) -> float:
    """Relative decrease; nothing can be gained where the value is zero, as for a surface out of the volume."""
    return decrease / value if value > 0.0 else 0.0


def _keeps_orientation(before: Samples, after: Samples) -> bool:
    """Whether a step leaves the surface neither mirrored (det R > 0) nor turned inside out."""
    cosine = np.einsum("nk,nk->n", before.frame.normals, after.frame.normals)
    # A flattened organ can come out mirrored without its normals turning far, so that they are not enough.
    return bool(cosine.mean() > _MINIMUM_COSINE and _content(before.frame) * _content(after.frame) > 0.0)


def _content(frame: Frame) -> float:
    """Signed volume between the surface and its centre, up to a factor: an affine map multiplies it by det R."""
    return float(np.vdot(frame.points - frame.points.mean(axis=0), frame.cross))


def _damped_solution(hessian, gradient: np.ndarray, damping: float) -> np.ndarray:
    """Solution of (H + damping diag H) step = -gradient."""
    diagonal = hessian.diagonal()
    # Directions without any support get the mean support, so that the matrix stays regular.
    lift = damping * (diagonal + diagonal.mean()) + 1e-9 * diagonal.mean() + 1e-300
    if sparse.issparse(hessian):
        matrix = (hessian + sparse.diags(lift)).tocsc()
        # The ordering and the pivoting for symmetric positive definite matrices: several times faster.
        factors = sparse_linalg.splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        return -factors.solve(gradient)
    factor = linalg.cho_factor(hessian + np.diag(lift), check_finite=False)
    return -linalg.cho_solve(factor, gradient, check_finite=False)
