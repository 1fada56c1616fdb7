"""Partial volumes: the share of each voxel that lies inside a surface, blurred as the real image is.

The virtual image is made of them in the way in which the real one was made: an organ in the voxels of the same grid.
What averaging over thick slices does to a curved edge, and interpolating between them, is in both images then.
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
# How far triangles may be from the surface, in the shortest edges of a voxel. Half of it changes no mean distance
# of the demo by more than 0.002 mm.
_CHORD_ERROR = 1.0 / 5.0
# Standard deviation of a usual point spread, in the same: from there that of the image is found by one step. Half and
# twice of it end at the same distances.
_USUAL_SPREAD = 0.6
# Samples (u, v) at which is measured how far a surface has moved.
_MOVED_AT = (24, 16)


@dataclass(frozen=True, eq=False)
class _VoxelShares:
    """Partial volumes of a surface on the grid of an image.

    If the surface has a thin wall, `with_wall` are those of organ and wall together, and `wall` its thickness, mm.
    """

    surface: BSplineSurface
    inside: Sampler
    with_wall: Sampler | None = None
    wall: float | None = None


class PartialVolumes:
    """Partial volumes along surfaces in the voxels of one image.

    Computing them takes as long as several iterations. They are kept, and move along with a surface that has moved a
    little: what thick slices do to an edge depends on where the slices cut the surface, and on its shape.

    Parameters
    ----------
    image : Image
        Whose grid is taken, and whose blur.

    Notes
    -----
    The scanner's point spread is taken as a Gaussian that is equal in all directions, and chosen so that the edge is as
    wide as that in the image: curvature within thick slices makes both of them wider. Where the wall of the organ is
    thinner than a voxel is long, see :func:`.wall_thickness`, the partial volumes of organ and wall together are
    computed too.
    """

    def __init__(self, image: Image):
        # A surface is cut at the lines of a grid. Where they run must not depend on the order of the volume's axes.
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
        """Compute the shares of the image's blur inside, and behind a thin wall, along the normals of a surface.

        Parameters
        ----------
        surface : BSplineSurface
            Closed, in the frame of the image.
        axes : (n_u,) and (n_v,) ndarray
            Parameters of the normal lines: all pairs of them.
        depths : (m,) ndarray
            Distances from the surface, outward positive, mm.
        within : float
            Partial volumes of another surface with the same parameters are taken if this one is no farther from it,
            root mean square, mm.

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
        # Where hollows overlap, the wall is nowhere less than the organ.
        return Shares(inside, 1.0 - np.maximum(last.with_wall.values(places)[0], inside), last.wall)

    def _computed(self, surface: BSplineSurface) -> _VoxelShares:
        """Compute the partial volumes of a surface, interpolated linearly as the image is."""
        image, spacing = self.image, np.asarray(self.image.spacing)
        voxel, real_sampler = image.ijk_to_ras[:3, :3], Sampler(image)
        mesh = triangulate_volume(surface, chord_error=_CHORD_ERROR * spacing.min())
        shares = self._shares(mesh)
        usual = _USUAL_SPREAD * spacing.min()
        usually_blurred = self._blurred(shares, usual)
        virtual, real = (edge_width(sampler, surface, voxel) for sampler in (usually_blurred, real_sampler))
        if virtual is None or real is None:
            return _VoxelShares(surface, usually_blurred)
        # Held at the limits of tau: what lies behind thin walls in thick slices widens the edge in the image.
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
        """Shares on the grid of the image after a Gaussian of so many mm."""
        deviations = deviation / np.asarray(self.image.spacing)[::-1]
        return Sampler(Image(ndimage.gaussian_filter(shares, deviations), self.image.ijk_to_ras))


def _distance(surface: BSplineSurface, other: BSplineSurface) -> float:
    """How far a surface is from another one with the same parameters, along its normals, root mean square, mm."""
    u, v = other.midpoints(*_MOVED_AT)
    apart = surface.points(u, v) - other.points(u, v)
    return float(np.sqrt(np.mean(np.einsum("nk,nk->n", apart, other.normals(u, v)) ** 2)))
