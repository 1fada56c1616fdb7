"""Losses: how much a sample counts whose grey level is far from the virtual image's."""

from __future__ import annotations

import numpy as np

LOSSES = ("squares", "huber")
# Residuals beyond so many scales count by their size, not by its square.
_HUBER = 2.0
# Scaled median absolute deviation of a normal distribution.
_MAD = 1.4826
_SMALLEST_SCALE = 0.02


def sample_shares(loss: str, residuals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Tell what each sample keeps of its weight.

    Parameters
    ----------
    loss : {"squares", "huber"}
        "squares": all of it, as published (equations 4 and 7). "huber": less where the residual is large, as for
        samples that lie on another structure.
    residuals, weights : (n, m) ndarray
        In units of the contrast.

    Returns
    -------
    (n, m) ndarray
        From 0 to 1.

    Notes
    -----
    Iteratively reweighted least squares (Huber, 1981): with the weights held, a step is one of least squares.
    """
    size = np.abs(residuals)
    if loss == "squares":
        return np.ones_like(size)
    return np.minimum(1.0, _HUBER * _scale(size, weights) / np.maximum(size, 1e-12))


def _scale(size: np.ndarray, weights: np.ndarray) -> float:
    """Robust standard deviation of residuals by their sizes."""
    order = np.argsort(size, axis=None)
    passed = np.cumsum(weights.ravel()[order])
    if not passed[-1] > 0.0:
        return _SMALLEST_SCALE
    median = size.ravel()[order[np.searchsorted(passed, passed[-1] / 2.0)]]
    return max(_MAD * float(median), _SMALLEST_SCALE)
