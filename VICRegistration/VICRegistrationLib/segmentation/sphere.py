"""Directions on a sphere and pairs of neighbours, interpolation between them, and radii of least cost along them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

# Most rounds of message passing, and the change of a message below which it ends, where the largest edge strength is 1.
# 16 hard surfaces, of costs of -40 to -200, end 0.4 above the least cost in the mean after 50 rounds, 0.1 after 100.
_ROUNDS, _CONVERGED = 100, 1e-2
# Share of the last message that is kept. With 0.2 to 0.5 the surfaces are the same; with 0.1 and less, messages
# oscillate.
_DAMPING = 0.3
# So many pairs stay in the processor's cache: the messages of 1632 pairs with 81 radii take 1.2 ms with 256 at once,
# 1.6 ms with 128, 1.8 ms with 512, and 2.1 ms with all.
_PAIRS_AT_ONCE = 256
# Values are interpolated between so many of the nearest directions.
_NEAREST = 4


@dataclass(frozen=True, eq=False)
class Sphere:
    """Directions on a sphere and the pairs of neighbours among them.

    Attributes
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors along small whole numbers: symmetric under any permutation and flip of the axes.
    first, second : ndarray of int, shape (m,)
        Indices of the two directions of each pair; every pair is listed in both orders.
    back : ndarray of int, shape (m,)
        Index of the same pair in the other order.
    angles : ndarray, shape (m,)
        Angle between the two directions, radians.
    """

    directions: np.ndarray
    first: np.ndarray
    second: np.ndarray
    back: np.ndarray
    angles: np.ndarray


def small_whole_numbers(largest: int) -> np.ndarray:
    """Return all vectors of whole numbers up to a largest one that have no common divisor, (n, 3)."""
    numbers = range(-largest, largest + 1)
    return np.array([v for v in itertools.product(numbers, repeat=3) if np.gcd.reduce(v) == 1], dtype=float)


@lru_cache(maxsize=2)
def sphere(longest: int = 3) -> Sphere:
    """Spread directions over a sphere; neighbours are those of the Gabriel graph [1]_, with no other between them.

    Parameters
    ----------
    longest : int
        Largest of the whole numbers: 3 for 290 directions, 5 for 1154.

    Returns
    -------
    Sphere

    References
    ----------
    .. [1] K. R. Gabriel, R. R. Sokal, "A new statistical approach to geographic variation analysis", Systematic Zoology
       18(3), 1969.
    """
    whole = small_whole_numbers(longest)
    directions = whole / np.linalg.norm(whole, axis=1, keepdims=True)
    # Neighbours are at most as far apart as an axis is from those next to it, about 1 / longest; with a margin.
    tree, widest = cKDTree(directions), 2.0 / longest
    pairs = tree.query_pairs(widest, output_type="ndarray")
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((second, first))
    first, second = first[order], second[order]
    middle = directions[first] + directions[second]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    own = np.linalg.norm(middle - directions[first], axis=1)
    other_between = tree.query(middle)[0] < own - 1e-6
    first, second = first[~other_between], second[~other_between]
    cosines = np.einsum("mk,mk->m", directions[first], directions[second])
    # Pairs are sorted by the first index, then by the second.
    back = np.lexsort((first, second))
    return Sphere(directions, first, second, back, np.arccos(np.clip(cosines, -1.0, 1.0)))


def between(directions: np.ndarray, values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Interpolate values at directions to other directions: means of the nearest few, weighted by inverse squares.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors.
    values : ndarray, shape (n,)
    others : ndarray, shape (m, 3)
        Unit vectors.

    Returns
    -------
    ndarray, shape (m,)
    """
    gaps, near = cKDTree(directions).query(others, k=_NEAREST)
    # The constant keeps the weight finite at a direction itself.
    weights = 1.0 / (gaps**2 + 1e-4)
    return np.einsum("nd,nd->n", values[near], weights) / weights.sum(axis=1)


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


def cheapest_radii(
    ball: Sphere,
    costs: np.ndarray,
    slopes: np.ndarray,
    *,
    smoothness: float,
    most_apart: int,
    shape: np.ndarray | None = None,
) -> np.ndarray:
    """Choose a radius along each direction so that the sum of their costs and of those of slopes is least.

    Parameters
    ----------
    ball : Sphere
    costs : ndarray, shape (n, n_radii)
        Cost of each radius along each direction.
    slopes : ndarray, shape (m,)
        Slope of the surface between two neighbours whose radii are one sample apart.
    smoothness : float
        Cost of a slope of 45 degrees between two neighbours; other slopes cost in proportion to their square.
    most_apart : int
        Largest difference between the radii of neighbours, in samples.
    shape : ndarray, shape (n,), optional
        Radii of a smooth surface, in samples, not rounded. Slopes are measured from those of this surface; by default
        from those of a sphere.

    Returns
    -------
    ndarray of int, shape (n,)
        Index of the radius along each direction.

    Notes
    -----
    Tree-reweighted message passing [1]_ on the graph of neighbours. Its surface is the one that the graph cut of
    optimal surface detection [2]_ finds, or costs hardly more, in a tenth of the time. Plain message passing [3]_ ends
    at surfaces that cost up to a tenth more, and rounding errors decide which of them it finds.

    References
    ----------
    .. [1] M. Wainwright, T. Jaakkola, A. Willsky, "MAP estimation via agreement on trees: message-passing and linear
       programming", IEEE Trans. Information Theory 51(11), 2005.
    .. [2] K. Li, X. Wu, D. Chen, M. Sonka, "Optimal surface segmentation in volumetric images", IEEE Trans. PAMI 28(1),
       2006.
    .. [3] P. Felzenszwalb, D. Huttenlocher, "Efficient belief propagation for early vision", Int. J. Computer Vision
       70(1), 2006.
    """
    count, costs = len(ball.first), costs.astype(np.float32)
    # Probability that a pair belongs to a random spanning tree of the graph, the same for all pairs.
    share = np.float32(2.0 * (len(costs) - 1) / count)
    gather = sparse.csr_matrix((np.full(count, share), (ball.second, np.arange(count))), shape=(len(costs), count))
    rises = np.arange(-most_apart, most_apart + 1)
    shape = np.zeros(len(costs)) if shape is None else shape
    own_rises = np.clip(shape[ball.second] - shape[ball.first], -most_apart, most_apart)
    slope_costs = (smoothness / share * ((rises - own_rises[:, None]) * slopes[:, None]) ** 2).astype(np.float32)
    messages, totals = np.zeros((count, costs.shape[1]), dtype=np.float32), costs
    for _ in range(_ROUNDS):
        cheapest = _messages(totals[ball.first] - messages[ball.back], slope_costs)
        change = np.abs(cheapest - messages).max()
        messages = _DAMPING * messages + (1.0 - _DAMPING) * cheapest
        totals = costs + gather @ messages
        if change < _CONVERGED:
            break
    return totals.argmin(axis=1)


def _messages(sums: np.ndarray, slope_costs: np.ndarray) -> np.ndarray:
    """Message of each pair: least cost of the first direction's radius and the slope, for each radius of the second.

    Slope costs, (m, 2 * most_apart + 1), are those of each rise from the first radius to the second.
    """
    messages, level = np.empty_like(sums), slope_costs.shape[1] // 2
    for start in range(0, len(sums), _PAIRS_AT_ONCE):
        pairs = slice(start, start + _PAIRS_AT_ONCE)
        # The pairs of a radius lie next to each other in memory: numpy is fastest along its last axis.
        costs, by_rise = sums[pairs].T.copy(), slope_costs[pairs].T.copy()
        cheapest, raised = costs + by_rise[level], np.empty_like(costs)
        for rise in range(1, level + 1):
            up = np.add(costs[:-rise], by_rise[level + rise], out=raised[rise:])
            np.minimum(cheapest[rise:], up, out=cheapest[rise:])
            down = np.add(costs[rise:], by_rise[level - rise], out=raised[:-rise])
            np.minimum(cheapest[:-rise], down, out=cheapest[:-rise])
        messages[pairs] = (cheapest - cheapest.min(axis=0)).T
    return messages
