"""A closed surface with one radius along each of the rays from a centre, or from an axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .ray_graph import RayGraph, between

# Edges of a greater strength count as found.
EDGE_STRENGTH = 0.46


class RaySource(Protocol):
    """What rays start from."""

    def graph(self, *, fine: bool) -> RayGraph:
        """Return the rays and their neighbours, few or many."""

    def rays(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the origins of the rays at places (n, 3) of a graph, RAS mm, and unit vectors along them, (n, 3)."""

    def coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the places of the rays through points (m, 3), RAS mm, and the distances from their origins, mm."""


@dataclass(frozen=True, eq=False)
class RaySurface:
    """A closed surface: one radius along each ray.

    Attributes
    ----------
    source : RaySource
    graph : RayGraph
        Of the n rays.
    origins, directions : ndarray, shape (n, 3)
        Where rays start, RAS mm, and unit vectors along them.
    radii : ndarray, shape (n,)
        From the origin to the surface, mm.
    strengths : ndarray, shape (n,)
        Edge strength at the surface, from 0 to 1.
    border : ndarray, shape (n,)
        Distance from the origin to the last sample in the volume, mm.
    inner, outer : ndarray, shape (n,)
        Grey levels before and behind the surface.
    contrast : float
        Contrast of the grey levels around the origins, larger than 0; the unit of steps.
    bright : bool
        True if the organ is brighter than what borders on it.
    cost : float
        Mean cost over the rays that are not cut, without that of slopes, plus what the cut ones have crossed, divided
        by the number of all rays. The border of the volume counts neither for a surface nor against it.
    """

    source: RaySource
    graph: RayGraph
    origins: np.ndarray
    directions: np.ndarray
    radii: np.ndarray
    strengths: np.ndarray
    border: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    contrast: float
    bright: bool
    cost: float

    @property
    def points(self) -> np.ndarray:
        """Points of the surface, (n, 3) RAS mm."""
        return self.origins + self.radii[:, None] * self.directions

    @property
    def cut(self) -> np.ndarray:
        """Where the surface lies beyond the border of the volume, (n,) of bool."""
        return self.radii > self.border

    @property
    def found(self) -> np.ndarray:
        """Where an edge was found, (n,) of bool."""
        return (self.strengths > EDGE_STRENGTH) & ~self.cut

    def inward(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (m, 3), RAS mm, from the surface along their rays, (m,) mm; negative outside."""
        places, distances = self.source.coordinates(points)
        return between(self.graph.places, self.radii, places) - distances
