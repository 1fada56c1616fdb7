"""Grey levels that separate an organ from its surroundings."""

from __future__ import annotations

import numpy as np

from .ray_edges import Edges

# Fewer edges than this share of the rays are chance; and a side of the threshold needs a share of the edges.
_FEWEST_EDGES, FEWEST_ON_SIDE = 0.1, 0.25


def threshold_between(edges: Edges) -> tuple[float, float]:
    """Find the lowest and highest grey level of an organ between the levels before and behind its edges.

    The limit towards the levels outside is half way between the levels before and behind the edges. A side with few
    edges is limited by the spread of the levels inside, but no nearer than the level outside is on the other side.

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
        If the rays found no edge.
    """
    falls = edges.found & (edges.outer < edges.inner)
    rises = edges.found & (edges.outer > edges.inner)
    if edges.found.sum() < _FEWEST_EDGES * edges.found.size:
        msg = (
            f"No edge of an organ was found around the seeds (grey level {edges.middle:.6g}); check that they are "
            "inside the organ, or give the threshold as its lowest and highest grey level."
        )
        raise ValueError(msg)
    least = FEWEST_ON_SIDE * edges.found.sum()
    half = (edges.inner + edges.outer) / 2
    low = np.median(half[falls]) if falls.sum() >= least else None
    high = np.median(half[rises]) if rises.sum() >= least else None
    if low is None:
        low = edges.middle - max(6 * edges.spread, np.median((edges.outer - edges.inner)[rises]))
    if high is None:
        high = edges.middle + max(6 * edges.spread, np.median((edges.inner - edges.outer)[falls]))
    return float(low), float(high)
