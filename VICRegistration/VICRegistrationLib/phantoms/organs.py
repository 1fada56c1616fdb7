"""True surfaces of pelvic organs: tubes around centrelines, as closed smooth B-spline surfaces.

The control net of a unit sphere is bent into each organ. It is finer than the nets of fits and has other knots, so that
no fit can reproduce an organ exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from ..geometry import models, parametrization
from ..geometry.surface import BSplineSurface
from ..geometry.triangulation import triangulate_volume

TRUE_NET = (17, 13)


@dataclass(frozen=True)
class Press:
    """A smooth local displacement of an organ's surface: a dent, a fold, a bulge.

    Parameters
    ----------
    place : (R, A, S)
        Its centre, RAS mm.
    push : (R, A, S)
        Displacement at the centre, mm.
    reach : float
        Standard deviation of the Gaussian by which it falls off, mm.
    """

    place: tuple
    push: tuple
    reach: float

    def displacements(self, points: np.ndarray) -> np.ndarray:
        """Return the displacements of points (..., 3), mm."""
        squared = np.square(points - np.array(self.place)).sum(axis=-1, keepdims=True)
        return np.exp(squared / (-2.0 * self.reach**2)) * np.array(self.push)


@dataclass(frozen=True)
class Tube:
    """Shape of a closed tube that runs from z = -1 to z = 1; all polynomials are in z, lowest power first.

    Parameters
    ----------
    axis : tuple of (R, A, S)
        Coefficients of the centreline, RAS mm.
    lateral, sagittal : tuple of float
        Coefficients of the half widths to the right and to the front, mm. Towards its ends the tube narrows like an
        ellipsoid with these half widths.
    presses : tuple of Press
        Local displacements.
    """

    axis: tuple
    lateral: tuple
    sagittal: tuple
    presses: tuple = ()

    def bend(self, points: np.ndarray) -> np.ndarray:
        """Map points of the unit ball, (..., 3), to points of the organ, (..., 3) RAS mm."""
        x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
        along = np.moveaxis(polyval(z, polyder(np.array(self.axis))), 0, -1)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        right = np.array([1.0, 0.0, 0.0]) - along[..., :1] * along
        right /= np.linalg.norm(right, axis=-1, keepdims=True)
        front = np.cross(along, right)
        bent = np.moveaxis(polyval(z, np.array(self.axis)), 0, -1)
        bent = bent + (x * polyval(z, self.lateral))[..., None] * right
        bent = bent + (y * polyval(z, self.sagittal))[..., None] * front
        return bent + sum(press.displacements(bent) for press in self.presses)


# An ellipsoid narrows by sqrt(1 - z^2), which a half width of about 1 + z^2 / 2 compensates: such a tube is a cylinder
# with round ends.
ORGANS = {
    "bladder": Tube(
        axis=((2.0, 25.0, 22.0), (2.5, 6.5, 28.5), (1.0, 0.0, -4.0)),
        lateral=(36.0, 4.0, -2.0),
        sagittal=(32.0, 3.5, -1.5),
        presses=(
            # The uterus rests on the dome; the pubic bone holds the front; the side walls bulge unevenly.
            Press((-4.0, 12.0, 47.0), (0.0, 2.5, -9.0), 11.0),
            Press((4.0, 50.0, 5.0), (0.0, -5.0, 2.0), 9.0),
            Press((-31.0, 26.0, 30.0), (-5.0, 0.0, 1.5), 8.0),
            Press((34.0, 20.0, 12.0), (3.5, -1.0, -1.0), 8.0),
        ),
    ),
    "vagina": Tube(
        axis=((-1.0, -7.0, -13.0), (1.0, -12.5, 38.5), (1.0, 3.0, -1.0), (0.0, -1.0, 0.0)),
        lateral=(13.5, 1.0, 6.0),
        sagittal=(6.5, 0.4, 3.4),
        presses=(
            # The cervix stands against the upper front wall; the urethra against the lower one.
            Press((-1.0, -6.0, 15.0), (0.0, -2.6, -0.7), 6.0),
            Press((1.0, 6.0, -26.0), (0.0, -1.8, 0.0), 6.5),
            Press((-14.0, -8.0, -8.0), (2.6, 0.0, 0.0), 6.0),
        ),
    ),
    "rectum": Tube(
        axis=((2.0, -35.0, -4.0), (-2.0, -9.0, 45.0), (-3.0, 9.0, 2.0)),
        lateral=(14.6, -2.2, 5.5),
        sagittal=(12.8, -2.0, 5.0),
        presses=(
            # The three transverse folds come from the left, the right and the left.
            Press((-12.0, -38.0, 18.0), (4.8, 0.0, 0.0), 5.0),
            Press((16.0, -36.0, 2.0), (-4.8, 0.0, 0.0), 5.5),
            Press((-13.0, -32.0, -16.0), (3.9, 0.0, 0.0), 5.0),
            Press((2.0, -46.0, -6.0), (0.0, -3.0, 0.0), 7.5),
        ),
    ),
}


# Structures around the organs, so that the image looks like a pelvis; nothing is measured against them.
UTERUS = Tube(
    axis=((0.0, 4.0, 58.0), (0.0, 27.0, 5.0), (0.0, -3.0, -7.0)),
    lateral=(9.0, 4.0, 0.0),
    sagittal=(3.0, 2.0, 0.0),
)
SYMPHYSIS = Tube(
    axis=((0.0, 67.0, -26.0), (0.0, 7.0, 19.0)),
    lateral=(22.0,),
    sagittal=(8.0, 0.0, 2.0),
)
SACRUM = Tube(
    axis=((0.0, -72.0, 22.0), (0.0, 12.0, 72.0), (0.0, 20.0, 4.0)),
    lateral=(26.0, 14.0, 6.0),
    sagittal=(8.0, 4.0, 3.0),
)


def organ_surface(tube: Tube, *, net: tuple[int, int] = TRUE_NET) -> BSplineSurface:
    """Make the closed surface of a tube.

    Parameters
    ----------
    tube : Tube
    net : (rows, columns)
        Size of the control net, as the paper counts it.

    Returns
    -------
    BSplineSurface
        Cubic, C2 across its seam, with a tangent plane at each pole; RAS mm, normals outward.
    """
    sphere = models.closed_organ(net)
    smooth = parametrization.closed_organ(sphere)
    return smooth.deform(smooth.fit(tube.bend(sphere.control_net)))


def pelvic_organs() -> dict[str, BSplineSurface]:
    """Return the lumens of a filled bladder, and of a vagina and a rectum with gel, RAS mm, by name.

    The bladder is in front and flattened from above, the vagina behind it, the rectum behind that.
    """
    return {name: organ_surface(tube) for name, tube in ORGANS.items()}


def shell(surface: BSplineSurface, thickness: float = 0.0, *, chord_error: float = 0.02):
    """Make a closed mesh at a distance outside of a surface.

    At the distance 0 it encloses the volume of the surface.

    Parameters
    ----------
    surface : BSplineSurface
        Closed, normals outward.
    thickness : float
        Distance along the normal, mm; 0 is the surface itself.
    chord_error : float
        See :func:`.triangulation.triangulate_volume`, mm.

    Returns
    -------
    points : (n, 3) ndarray
        RAS mm.
    triangles : (m, 3) ndarray of int
    """
    mesh = triangulate_volume(surface, chord_error=chord_error)
    return mesh.points + thickness * mesh.normals, mesh.triangles


def seeds_inside(surface: BSplineSurface) -> np.ndarray:
    """Return three points on the centreline of an organ, (3, 3) RAS mm, away from its ends."""
    (u_low, u_high), (v_low, v_high) = surface.domain
    u = np.linspace(u_low, u_high, 64, endpoint=False)
    v = v_low + (v_high - v_low) * np.array([0.25, 0.5, 0.75])
    return surface.grid(u, v).mean(axis=0)
