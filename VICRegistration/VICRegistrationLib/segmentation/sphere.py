"""Directions on a sphere, and smooth functions of the direction."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from .ray_graph import RayGraph, gabriel_graph


def small_whole_numbers(largest: int) -> np.ndarray:
    """Return all vectors of whole numbers up to a largest one that have no common divisor, (n, 3)."""
    numbers = range(-largest, largest + 1)
    return np.array([v for v in itertools.product(numbers, repeat=3) if np.gcd.reduce(v) == 1], dtype=float)


@lru_cache(maxsize=2)
def sphere(longest: int = 3) -> RayGraph:
    """Spread directions over a sphere: along small whole numbers, symmetric under any permutation and flip of the axes.

    Parameters
    ----------
    longest : int
        Largest of the whole numbers: 3 for 290 directions, 5 for 1154.

    Returns
    -------
    RayGraph
    """
    whole = small_whole_numbers(longest)
    # Neighbours are at most as far apart as an axis is from those next to it, about 1 / longest; with a margin.
    return gabriel_graph(whole / np.linalg.norm(whole, axis=1, keepdims=True), 2.0 / longest)


def smoothed(directions: np.ndarray, values: np.ndarray, others: np.ndarray, *, degree: int) -> np.ndarray:
    """Smooth values over a sphere: fit spherical harmonics up to a degree, by least squares.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors.
    values : ndarray, shape (n,)
    others : ndarray, shape (m, 3)
        Unit vectors.
    degree : int
        At least 1.

    Returns
    -------
    ndarray, shape (m,)
        Values at the other directions.
    """
    # On a sphere, monomials of the last two degrees span the same space as all harmonics up to the last degree.
    powers = [p for p in itertools.product(range(degree + 1), repeat=3) if sum(p) in (degree - 1, degree)]
    at, there = (np.prod(places[:, None] ** np.array(powers), axis=2) for places in (directions, others))
    return there @ np.linalg.lstsq(at, values, rcond=None)[0]
