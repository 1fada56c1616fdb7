"""Directions on a sphere, their neighbours, and the cheapest radius along each of them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

# Messages are passed on grids of radii, so many samples wide, so often at most, until none changes by more than this
# share of the largest strength of an edge. Each grid begins with the messages of the one before: on the finest alone,
# 150 rounds end at higher costs.
_WIDTHS, _ROUNDS, _SETTLED = (8, 4, 2, 1), (60, 40, 20, 10), 1e-2
# Share of the last message that is kept: messages that run round in circles do not swing.
_DAMPING = 0.2


@dataclass(frozen=True, eq=False)
class Sphere:
    """Directions on a sphere and the pairs of neighbours among them.

    Attributes
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors along small whole numbers: symmetric under any permutation and flip of the axes.
    first, second : ndarray of int, shape (m,)
        Pairs of neighbours, both ways round.
    back : ndarray of int, shape (m,)
        Where the same pair stands the other way round.
    angles : ndarray, shape (m,)
        Between neighbours, radians.
    """

    directions: np.ndarray
    first: np.ndarray
    second: np.ndarray
    back: np.ndarray
    angles: np.ndarray


@lru_cache(maxsize=2)
def sphere(longest: int = 3) -> Sphere:
    """Spread directions over a sphere; neighbours have no other direction between them (Gabriel's graph).

    Parameters
    ----------
    longest : int
        Largest of the whole numbers: 3 for 290 directions, 5 for 1154.

    Returns
    -------
    Sphere
    """
    numbers = range(-longest, longest + 1)
    whole = np.array([v for v in itertools.product(numbers, repeat=3) if np.gcd.reduce(v) == 1], dtype=float)
    directions = whole / np.linalg.norm(whole, axis=1, keepdims=True)
    # Nothing is farther from a direction than one along an axis is from the next.
    tree, widest = cKDTree(directions), 2.0 / longest
    pairs = tree.query_pairs(widest, output_type="ndarray")
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((second, first))
    first, second = first[order], second[order]
    middle = directions[first] + directions[second]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    own = np.linalg.norm(middle - directions[first], axis=1)
    between = tree.query(middle)[0] < own - 1e-6
    first, second = first[~between], second[~between]
    cosines = np.einsum("mk,mk->m", directions[first], directions[second])
    # Pairs come in order of the first, then of the second.
    back = np.lexsort((first, second))
    return Sphere(directions, first, second, back, np.arccos(np.clip(cosines, -1.0, 1.0)))


def cheapest_radii(ball: Sphere, costs: np.ndarray, slopes: np.ndarray, *, stiffness: float, most: int) -> np.ndarray:
    """Choose a radius along each direction so that all together cost least.

    Parameters
    ----------
    ball : Sphere
    costs : ndarray, shape (n, n_radii)
        Of each radius along each direction.
    slopes : ndarray, shape (m,)
        Slope of the surface between two neighbours whose radii are one sample apart.
    stiffness : float
        Cost of a slope of 45 degrees between two neighbours. Slopes cost their square.
    most : int
        Neighbours differ by at most so many radii.

    Returns
    -------
    ndarray of int, shape (n,)

    Notes
    -----
    The min-sum algorithm on the graph of neighbours, in place of the graph cut of [1]_: costs of slopes need no hard
    limit, and it takes a tenth of the time of a maximum flow. From coarse to fine radii as in [2]_.

    References
    ----------
    .. [1] K. Li, X. Wu, D. Chen, M. Sonka, "Optimal surface segmentation in volumetric images", IEEE Trans. PAMI 28(1),
       2006.
    .. [2] P. Felzenszwalb, D. Huttenlocher, "Efficient belief propagation for early vision", Int. J. Computer Vision
       70(1), 2006.
    """
    count, costs = len(ball.first), costs.astype(np.float32)
    gather = sparse.csr_matrix(
        (np.ones(count, dtype=np.float32), (ball.second, np.arange(count))), shape=(len(costs), count)
    )
    messages, total = np.zeros((count, 1), dtype=np.float32), costs
    for width, rounds in zip(_WIDTHS, _ROUNDS):
        coarse = _coarser(costs, width)
        messages = np.repeat(messages, -(-coarse.shape[1] // messages.shape[1]), axis=1)[:, : coarse.shape[1]]
        shifts = np.arange(1, max(-(-most // width), 2) + 1)
        prices = (stiffness * (shifts * width * slopes[:, None]) ** 2).astype(np.float32)
        for _ in range(rounds):
            sums = (coarse + gather @ messages)[ball.first] - messages[ball.back]
            cheapest = _passed_on(sums, prices)
            change = np.abs(cheapest - messages).max()
            messages = _DAMPING * messages + (1.0 - _DAMPING) * cheapest
            if change < _SETTLED:
                break
        total = coarse + gather @ messages
    return total.argmin(axis=1)


def _coarser(costs: np.ndarray, width: int) -> np.ndarray:
    """Lowest costs of so many radii each."""
    missing = -costs.shape[1] % width
    padded = np.pad(costs, ((0, 0), (0, missing)), mode="edge")
    return padded.reshape(len(costs), -1, width).min(axis=2)


def _passed_on(sums: np.ndarray, prices: np.ndarray) -> np.ndarray:
    """Least cost of the first of each pair, for each radius of the second."""
    cheapest = sums.copy()
    for shift, price in enumerate(prices.T, start=1):
        for here, there in ((slice(shift, None), slice(None, -shift)), (slice(None, -shift), slice(shift, None))):
            np.minimum(cheapest[:, here], sums[:, there] + price[:, None], out=cheapest[:, here])
    return cheapest - cheapest.min(axis=1, keepdims=True)
