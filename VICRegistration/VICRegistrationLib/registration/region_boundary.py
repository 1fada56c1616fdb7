"""The boundary of the separated region as points, each of which is to lie on the surface.

The distance image tells how far the surface is from the region's boundary, but not how far the boundary is from the
surface: where the surface bridges a narrow dent, the nearest boundary is beside it, not below it. So both are measured.
Without the points, a bladder that an expert draws without two tumours has an error of 1.10 in place of 0.96 mm, and of
four tubes bent by 140 degrees and more that start from an ellipsoid two are off by 0.4 and 1.1 in place of 0.1 mm.
Half and twice of their weight change the first figure by 0.04 mm, and the mean distances of six other bladders by
0.008 mm at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..geometry.parametrization import Parametrization
from .sample_grid import Frame, SampledSurface


@dataclass(frozen=True, eq=False)
class BoundarySamples:
    """Distances of boundary points from the surface, along the normals of its samples.

    Parameters
    ----------
    frame : Frame
        The surface.
    offsets : (m,) ndarray
        Signed distance of each point, mm.
    cost : float
        Mean squared distance, in squared units of the cost.
    """

    frame: Frame
    offsets: np.ndarray
    cost: float


class BoundaryCost:
    """Mean squared distance of a region's boundary from the surface, a cost as :class:`.cost.Correlation` is.

    Parameters
    ----------
    points : (m, 3) ndarray
        Of the boundary, evenly spread over its area, in the frame of the surface.
    surface : SampledSurface
        The surface with its degrees of freedom.
    unit : float
        Unit of length of the cost, mm.

    Notes
    -----
    The distance of a point is that from the tangent plane at the nearest sample of the surface, as in registration of
    points to planes (Chen and Medioni, Image and Vision Computing 1992). Samples and normals are fixed between two
    calls of :meth:`refresh`.
    """

    def __init__(self, points: np.ndarray, surface: SampledSurface, unit: float):
        self.points = points
        self.surface = surface
        self._weight = 1.0 / (len(points) * unit**2)
        self._nearest = self._normals = None

    @property
    def parametrization(self) -> Parametrization:
        """How the surface deforms."""
        return self.surface.parametrization

    def refresh(self, q: np.ndarray) -> None:
        """Find the sample nearest to each point, and the normal there, for q (n_dof,)."""
        frame = self.surface.frame(q)
        _, self._nearest = cKDTree(frame.points).query(self.points)
        self._normals = frame.normals

    def sample(self, q: np.ndarray) -> BoundarySamples:
        """Measure the distances at q, (n_dof,)."""
        frame = self.surface.frame(q)
        away = self.points - frame.points[self._nearest]
        offsets = np.einsum("nk,nk->n", away, self._normals[self._nearest])
        return BoundarySamples(frame, offsets, self._weight * float(offsets @ offsets))

    def gradient(self, samples: BoundarySamples) -> np.ndarray:
        """Half the derivative of the cost by the degrees of freedom, (n_dof,)."""
        summed = self._per_sample(samples.offsets)[:, None] * self._normals
        return self.surface.gradient(samples.frame, -summed, np.zeros_like(summed))

    def hessian(self, samples: BoundarySamples):
        """Half the second derivative of the cost, (n_dof, n_dof)."""
        weights = self._per_sample(np.ones_like(samples.offsets))
        return self.surface.quadratic_form(weights[:, None, None] * self._normals[:, :, None] * self._normals[:, None])

    def _per_sample(self, values: np.ndarray) -> np.ndarray:
        """Sum up the weighted values of the points at each sample of the surface."""
        return self._weight * np.bincount(self._nearest, values, minlength=len(self._normals))
