"""Lowest and highest grey level of an organ, from the levels before and behind its edges."""

from __future__ import annotations

import numpy as np

from .ray_edges import Edges

# If fewer than this share of the rays have an edge, the edges are taken for noise. A limit is measured if at least this
# share of the edges falls (lowest level), or rises (highest level), outward.
_FEWEST_EDGES, FEWEST_ON_SIDE = 0.1, 0.25


def threshold_between(edges: Edges) -> tuple[float, float]:
    """Find the lowest and highest grey level of an organ.

    Each edge has a mean of the levels before and behind it. The lowest level is the median of this mean over the edges
    at which the grey level falls outward, the highest level that over the edges at which it rises. If few edges fall
    (or rise), that limit is six times the spread of the organ's levels away from their median, or the median step of
    the other edges if that is more.

    Parameters
    ----------
    edges : Edges
        From :func:`.ray_edges.find_edges`.

    Returns
    -------
    low, high : float

    Raises
    ------
    ValueError
        If hardly any ray has an edge.
    """
    falling = edges.found & (edges.outer < edges.inner)
    rising = edges.found & (edges.outer > edges.inner)
    if edges.found.sum() < _FEWEST_EDGES * edges.found.size:
        msg = (
            f"No edge of an organ was found around the seeds (grey level {edges.median_level:.6g}); check that they "
            "are inside the organ, or give the threshold as its lowest and highest grey level."
        )
        raise ValueError(msg)
    least = FEWEST_ON_SIDE * edges.found.sum()
    half = (edges.inner + edges.outer) / 2
    low = np.median(half[falling]) if falling.sum() >= least else None
    high = np.median(half[rising]) if rising.sum() >= least else None
    if low is None:
        low = edges.median_level - max(6 * edges.spread, np.median((edges.outer - edges.inner)[rising]))
    if high is None:
        high = edges.median_level + max(6 * edges.spread, np.median((edges.inner - edges.outer)[falling]))
    return float(low), float(high)
