"""A further stack in a fit: moved by its motion, with its own grey levels, width of the edge and voxels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..geometry.surface import BSplineSurface
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .options import FitOptions
from .partial_volumes import PartialVolumes
from .stages import FurtherImage
from .virtual_image import IntensityProfile, Shares, VirtualImage

# Number of samples of a surface in u and v for the share of its area that lies in an image.
_SAMPLES = (24, 16)


@dataclass(frozen=True, eq=False)
class View:
    """A further stack of the organ, in the frame of the fit.

    Parameters
    ----------
    sampler : Sampler
        The grey levels around the organ, moved to its place in the first image.
    voxel : (3, 3) ndarray
        Columns are the edges of a voxel, mm.
    inside, outside : float
        Typical grey levels on both sides of the organ's boundary; the inside may be the darker one.
    tau : float
        Width of the edge, mm.
    volumes : PartialVolumes
        In the voxels of the stack before it was moved.
    motion : (4, 4) ndarray
        Rigid: takes the frame of the fit to that of `volumes`.
    voxel_weight : float
        Weight of a voxel, relative to a voxel of the first image.
    """

    sampler: Sampler
    voxel: np.ndarray
    inside: float
    outside: float
    tau: float
    volumes: PartialVolumes
    motion: np.ndarray
    voxel_weight: float = 1.0

    def moved(self, motion: np.ndarray) -> View:
        """Move the image by a rigid motion, (4, 4)."""
        image = self.sampler.image
        moved = Sampler(Image(image.array, motion @ image.ijk_to_ras))
        voxel, to_volumes = motion[:3, :3] @ self.voxel, self.motion @ np.linalg.inv(motion)
        return replace(self, sampler=moved, voxel=voxel, motion=to_volumes)

    def seen(self, surface: BSplineSurface) -> float:
        """Share of a surface's area that lies in the image."""
        u, v = surface.midpoints(*_SAMPLES)
        area = np.linalg.norm(surface.area_vectors(u, v), axis=1)
        return float(area @ self.sampler.values(surface.points(u, v))[1] / area.sum())

    def voxels_along(self, surface: BSplineSurface) -> float:
        """Count its voxels in a band of width tau around a surface."""
        return self.seen(surface) * surface.area() * self.tau / abs(float(np.linalg.det(self.voxel)))

    def shares_along(self, surface: BSplineSurface, axes, depths, *, within: float) -> Shares:
        """Shares of the levels along the normals of a surface, see :meth:`.PartialVolumes.along`."""
        return self.volumes.along(surface.transformed(self.motion), axes, depths, within=within)

    def compared(self, options: FitOptions, *, widening: float, within: float) -> FurtherImage:
        """Make the further image of a stage.

        Parameters
        ----------
        options : FitOptions
        widening : float
            Width of the ramp, in widths of the edge.
        within : float
            Partial volumes are computed again when the surface has moved by more than this, mm.
        """
        centered = options.profile == "centered"
        profile = IntensityProfile(self.inside, self.outside, widening * self.tau, centered=centered)
        # Given levels are those of the first image.
        mode = "local" if options.levels == "given" else options.levels
        shares = partial(self.shares_along, within=within)
        return FurtherImage(self.sampler, VirtualImage(profile, mode, self.voxel, shares), self.voxel_weight)
