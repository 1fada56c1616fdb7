"""Minimisation of an objective: Gauss-Newton with Levenberg-Marquardt damping, and gradient descent.

Both are generators of iterates, so that a caller can show progress and cancel between any two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from .banded_matrix import BandedMatrix
from .cost import Objective, Samples
from .sample_grid import Frame


@dataclass(frozen=True, eq=False)
class Iterate:
    """State after one iteration.

    Parameters
    ----------
    q : (n_dof,) ndarray
        Degrees of freedom.
    cost : float
        Mean squared residual in units of the contrast, without the energies.
    decrease : float
        Relative decrease of the objective, cost and energies, in this iteration.
    expected : float
        Predicted relative decrease of the first step that was tried; if `decrease` is far smaller, the solver has not
        found a better point.
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


def gauss_newton(objective: Objective, q: np.ndarray, *, largest_step: float) -> Iterator[Iterate]:
    """Gauss-Newton iterations with Levenberg-Marquardt damping, without a stop rule.

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
        One for every iteration. If no better point was found, it is the last point with a displacement of 0.

    Notes
    -----
    The damping is adapted to the ratio of the real to the predicted decrease (Nielsen, IMM-REP-1999-05). It also grows
    if the damped matrix is not positive definite.
    """
    damping = _Damping()
    while True:
        objective.refresh(q)
        samples = objective.sample(q)
        value = objective.value(q, samples)
        gradient = objective.gradient(q, samples)
        hessian = objective.hessian(samples)
        solve = _damped(hessian)
        step, trial, decrease, moved, expected = np.zeros_like(q), samples, 0.0, 0.0, None
        for _ in range(8):
            found = solve(gradient, damping.value)
            if found is not None:
                reached = objective.displacement(found)
                scale = min(1.0, largest_step / max(reached, 1e-300))
                found, reached = scale * found, scale * reached
                there = objective.sample(q + found)
                gained = value - objective.value(q + found, there)
                predicted = -float(found @ (2.0 * gradient + hessian @ found))
                expected = predicted if expected is None else expected
                if gained > 0.0 and _keeps_orientation(samples, there):
                    damping.succeeded(gained / predicted if predicted > 0.0 else 0.0)
                    step, trial, decrease, moved = found, there, gained, reached
                    break
            damping.failed()
        q = q + step
        cost = sum(part.cost for part in trial)
        shares = _share(decrease, value), _share(expected or 0.0, value)
        yield Iterate(q, cost, *shares, float(np.abs(step).max()), moved)


class _Damping:
    """Levenberg-Marquardt damping, adapted to the ratio of the real to the predicted decrease (Nielsen)."""

    def __init__(self) -> None:
        self.value, self._growth = 1e-3, 4.0

    def succeeded(self, gain: float) -> None:
        """Adapt the damping to the ratio `gain` of real to predicted decrease: less for a ratio near 1 or above."""
        self.value = max(self.value * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 1e-4)
        self._growth = 4.0

    def failed(self) -> None:
        """Damp more; the factor doubles with each failure."""
        self.value, self._growth = min(self.value * self._growth, 1e6), 2.0 * self._growth


def gradient_descent(objective: Objective, q: np.ndarray, *, largest_step: float) -> Iterator[Iterate]:
    """Steepest descent with a line search, without a stop rule: the optimiser of the paper.

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
    Degrees of freedom are normalised by the displacement that they cause (the paper's parameter normalisation for free
    translations). The step length doubles after each iteration and halves until the cost falls.
    """
    normalisation = 1.0 / np.maximum(objective.scales(), 1e-12) ** 2
    length = None
    while True:
        objective.refresh(q)
        samples = objective.sample(q)
        value = objective.value(q, samples)
        gradient = objective.gradient(q, samples)
        direction = -normalisation * gradient
        slope = 2.0 * float(gradient @ direction)
        reach = max(objective.displacement(direction), 1e-300)
        length = min(largest_step / reach, 2.0 * length if length else 0.5 * largest_step / reach)
        for _ in range(30):
            step = length * direction
            trial = objective.sample(q + step)
            decrease = value - objective.value(q + step, trial)
            if decrease >= -1e-4 * length * slope and _keeps_orientation(samples, trial):
                break
            length /= 2.0
        else:
            step, trial, decrease = np.zeros_like(q), samples, 0.0
        q = q + step
        # Gradient descent predicts no decrease, so the real one is taken as the expected one.
        share = _share(decrease, value)
        yield Iterate(
            q, sum(part.cost for part in trial), share, share, float(np.abs(step).max()), objective.displacement(step)
        )


SOLVERS = {"gauss-newton": gauss_newton, "gradient-descent": gradient_descent}


def _share(decrease: float, value: float) -> float:
    """Relative decrease; 0 if the value is zero, as for a surface outside of the volume."""
    return decrease / value if value > 0.0 else 0.0


def _keeps_orientation(before: Sequence[Samples], after: Sequence[Samples]) -> bool:
    """Whether a step mirrors no surface (det R > 0)."""
    return all(_signed_volume(one.frame) * _signed_volume(other.frame) > 0.0 for one, other in zip(before, after))


def _signed_volume(frame: Frame) -> float:
    """Signed volume between the surface and its centre, up to a factor; an affine map multiplies it by det R."""
    return float(np.vdot(frame.points - frame.points.mean(axis=0), frame.cross))


def _damped(hessian) -> Callable[[np.ndarray, float], np.ndarray | None]:
    """Make a function that solves (H + damping diag H) step = -gradient; None if that is not positive definite."""
    banded = BandedMatrix(hessian) if sparse.issparse(hessian) else None
    diagonal = hessian.diagonal()

    def solve(gradient: np.ndarray, damping: float) -> np.ndarray | None:
        # The mean is added for degrees of freedom with a zero on the diagonal, so that the matrix is regular.
        lift = damping * (diagonal + diagonal.mean()) + 1e-9 * diagonal.mean() + 1e-300
        try:
            if banded is not None:
                return -banded.solve(gradient, lift=lift)
            factor = linalg.cho_factor(hessian + np.diag(lift), check_finite=False)
            return -linalg.cho_solve(factor, gradient, check_finite=False)
        except linalg.LinAlgError:
            return None

    return solve
