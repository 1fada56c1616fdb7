"""Partial volumes: the share of each voxel that lies inside a surface, blurred like the real image.

The virtual image is made like the real one, from the organ in voxels of the same grid. So both images contain the same
effects of averaging over thick slices and of interpolating between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..geometry.line_fractions import line_fractions
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import TriangleMesh, triangulate_volume
from ..imaging.image import Image
from ..imaging.sampling import Sampler
from .edge_width import WIDTH_OF_BLUR, edge_width
from .options import LEAST_TAU_PIXELS, MOST_TAU_PIXELS
from .virtual_image import Shares
from .wall_thickness import wall_thickness

# Lines through a voxel along each of its two shorter edges. Half and twice of them change no mean distance of the demo
# by more than 0.002 mm, and of real bladders by 0.008 mm.
_LINES = 2
# Chord error of the triangles, in units of the voxel's shortest edge. Half of it changes no mean distance of the demo
# by more than 0.002 mm.
_CHORD_ERROR = 1.0 / 5.0
# First guess of the point spread's standard deviation, in the same units; the image's own is found from it in one step.
# Half and twice of it end at the same distances.
_USUAL_SPREAD = 0.6
# Number of samples in u and v for the distance between two surfaces.
_SAMPLES = (24, 16)


@dataclass(frozen=True, eq=False)
class _VoxelShares:
    """Partial volumes of a surface on the grid of an image.

    If the organ has a thin wall, `with_wall` has the partial volumes of organ and wall together, and `wall` is the
    wall's thickness, mm.
    """

    surface: BSplineSurface
    inside: Sampler
    with_wall: Sampler | None = None
    wall: float | None = None


class PartialVolumes:
    """Partial volumes of surfaces in the voxels of one image.

    Computing them takes as long as several iterations. The last ones are kept, and used for a surface that has moved
    only a little: they then move along with it.

    Parameters
    ----------
    image : Image
        Gives the grid and the blur.

    Notes
    -----
    The scanner's point spread is modelled by an isotropic Gaussian. Its width is chosen so that the edge of the partial
    volumes is as wide as the edge in the image; curvature within thick slices widens both. If the wall of the organ is
    thinner than a voxel is long, see :func:`.wall_thickness`, the partial volumes of organ and wall together are
    computed too.
    """

    def __init__(self, image: Image):
        # The result must not depend on the order of the volume's axes.
        self.image = image.canonical()
        self._last: _VoxelShares | None = None

    def along(
        self,
        surface: BSplineSurface,
        axes: tuple[np.ndarray, np.ndarray],
        depths: np.ndarray,
        *,
        within: float,
    ) -> Shares:
        """Interpolate the shares of organ, wall, and what lies behind it along the normals of a surface.

        Parameters
        ----------
        surface : BSplineSurface
            Closed, in the frame of the image.
        axes : (n_u,) and (n_v,) ndarray
            Parameters of the normal lines: all pairs of them.
        depths : (m,) ndarray
            Distances from the surface, outward positive, mm.
        within : float
            The last partial volumes are used if their surface lies within this distance, root mean square, mm. It must
            have the same parameters.

        Returns
        -------
        Shares
            (n_u * n_v, m) each.
        """
        last = self._last
        if last is None or _distance(surface, last.surface) > within:
            self._last = last = self._computed(surface)
        points, normals = last.surface.grid(*axes).reshape(-1, 3), last.surface.grid_normals(*axes).reshape(-1, 3)
        places = points[:, None] + depths[:, None] * normals[:, None]
        inside = last.inside.values(places)[0]
        if last.wall is None:
            return Shares(inside)
        # Moving a concave surface outward may make it overlap itself; organ and wall are at least the organ.
        return Shares(inside, 1.0 - np.maximum(last.with_wall.values(places)[0], inside), last.wall)

    def _computed(self, surface: BSplineSurface) -> _VoxelShares:
        """Compute the partial volumes of a surface."""
        image, spacing = self.image, np.asarray(self.image.spacing)
        voxel, real_sampler = image.ijk_to_ras[:3, :3], Sampler(image)
        mesh = triangulate_volume(surface, chord_error=_CHORD_ERROR * spacing.min())
        shares = self._shares(mesh)
        usual = _USUAL_SPREAD * spacing.min()
        usually_blurred = self._blurred(shares, usual)
        virtual, real = (edge_width(sampler, surface, voxel) for sampler in (usually_blurred, real_sampler))
        if virtual is None or real is None:
            return _VoxelShares(surface, usually_blurred)
        # Limited as tau is, because what lies behind thin walls in thick slices widens the edge in the image.
        real = np.clip(real, LEAST_TAU_PIXELS * spacing.min(), MOST_TAU_PIXELS * spacing.min())
        deviation = np.sqrt(max(usual**2 + (real**2 - virtual**2) / WIDTH_OF_BLUR**2, 0.0))
        inside = self._blurred(shares, deviation)
        wall = wall_thickness(real_sampler, surface, voxel, real)
        if wall is None:
            return _VoxelShares(surface, inside)
        outside = replace(mesh, points=mesh.points + wall * mesh.normals)
        return _VoxelShares(surface, inside, self._blurred(self._shares(outside), deviation), wall)

    def _shares(self, mesh: TriangleMesh) -> np.ndarray:
        """Share of each voxel that lies inside of triangles."""
        image = self.image
        return line_fractions(mesh.points, mesh.triangles, image.array.shape, image.ijk_to_ras, lines=_LINES)

    def _blurred(self, shares: np.ndarray, deviation: float) -> Sampler:
        """Blur shares by a Gaussian of a standard deviation in mm."""
        deviations = deviation / np.asarray(self.image.spacing)[::-1]
        return Sampler(Image(ndimage.gaussian_filter(shares, deviations), self.image.ijk_to_ras))


def _distance(surface: BSplineSurface, other: BSplineSurface) -> float:
    """Root mean square distance of a surface from another with the same parameters, along the other's normals, mm."""
    u, v = other.midpoints(*_SAMPLES)
    apart = surface.points(u, v) - other.points(u, v)
    return float(np.sqrt(np.mean(np.einsum("nk,nk->n", apart, other.normals(u, v)) ** 2)))
