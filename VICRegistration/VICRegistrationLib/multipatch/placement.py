"""Where a generic model lies in an image: one similarity and one affine map for all organs, in closed form.

Of each organ only its solid moments count: volume, centre and covariance, of the model's surface and of the separated
region. Between two such solids runs the optimal-transport map of Gaussians, which takes the one's moments to the
other's without turning or mirroring anything, so that axes need no names and no directions. The similarity and the
affine map are least squares over these maps of all organs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..geometry import bspline
from ..geometry.surface import BSplineSurface
from ..imaging.moments import moments
from ..imaging.region import Region

# Scales of bodies: outside of these the unit is another one (cm, or metres).
SCALES = (0.5, 2.0)
# A patient who lies otherwise is turned less than this against the model; LPS taken for RAS is half a turn.
MOST_DEGREES = 45.0
# The transport maps are made for the model as it is turned so far: repeated until the similarity changes by less than
# this, a few times for usual patients, and 50 times for one that is turned by 45 degrees.
_SETTLED = 1e-5
_MOST_ROUNDS = 100
# Begun with from the model as it lies and after half a turn about each axis of the patient: where front is taken for
# back, no way of small steps leads there.
_STARTS = [np.diag([*signs, 1.0]) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]


@dataclass(frozen=True, eq=False)
class SolidMoments:
    """Moments of a solid.

    Parameters
    ----------
    volume : float
        mm^3.
    center : (3,) ndarray
        RAS mm.
    covariance : (3, 3) ndarray
        mm^2.
    """

    volume: float
    center: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of_surface(cls, surface: BSplineSurface) -> SolidMoments:
        """Moments of the solid in a closed surface.

        Notes
        -----
        Divergence theorem: the integral of a homogeneous polynomial of degree k over the solid is that of it times
        x . n over the surface, by k + 3. On every knot span that is a polynomial, so that Gauss quadrature is exact.
        """
        u, weights_u = bspline.gauss_points(surface.degrees[0], surface.knots_u, (5 * surface.degrees[0] + 1) // 2)
        v, weights_v = bspline.gauss_points(surface.degrees[1], surface.knots_v, (5 * surface.degrees[1] + 1) // 2)
        middle = surface.control_net.mean(axis=(0, 1))
        x = surface.grid(u, v) - middle
        flux = np.einsum("ijk,ijk->ij", x, surface.grid_area_vectors(u, v))
        flux = weights_u[:, None] * weights_v * flux
        volume = flux.sum() / 3.0
        center = np.einsum("ij,ijk->k", flux, x) / 4.0 / volume
        second = np.einsum("ij,ijk,ijl->kl", flux, x, x, optimize=True) / 5.0 / volume
        return cls(float(volume), center + middle, second - np.outer(center, center))

    @classmethod
    def of_region(cls, region: Region) -> SolidMoments:
        """Moments of a separated region."""
        found = moments(region)
        covariance = found.axes.T @ np.diag(found.extents**2) @ found.axes
        return cls(1000.0 * region.volume_ml, found.center, covariance)

    def moved(self, matrix: np.ndarray) -> SolidMoments:
        """Moments of the solid moved by a 4x4 affine matrix."""
        linear = matrix[:3, :3]
        return SolidMoments(
            self.volume * abs(float(np.linalg.det(linear))),
            linear @ self.center + matrix[:3, 3],
            linear @ self.covariance @ linear.T,
        )


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a model lies.

    Parameters
    ----------
    matrix : (4, 4) ndarray
        The affine map, from the model's RAS mm to the image's.
    maps : dict of str to (4, 4) ndarray
        From there on, each organ's own map to its region, near the identity.
    scale : float
        Of the similarity.
    degrees : float
        By which the similarity turns.
    """

    matrix: np.ndarray
    maps: dict[str, np.ndarray]
    scale: float
    degrees: float


def transport_map(source: SolidMoments, target: SolidMoments) -> np.ndarray:
    """Affine map that takes a solid's centre and covariance to another's, with the least mean square displacement.

    Parameters
    ----------
    source, target : SolidMoments

    Returns
    -------
    (4, 4) ndarray
        Its linear part is symmetric and positive definite.

    References
    ----------
    I. Olkin and F. Pukelsheim: The distance between two random vectors with given dispersion matrices. Linear Algebra
    and its Applications 48, 257-263, 1982.
    """
    root = _root(source.covariance)
    inverse = np.linalg.inv(root)
    matrix = np.eye(4)
    matrix[:3, :3] = inverse @ _root(root @ target.covariance @ root) @ inverse
    matrix[:3, 3] = target.center - matrix[:3, :3] @ source.center
    return matrix


def place(parents: Mapping[str, BSplineSurface], targets: Mapping[str, SolidMoments]) -> Placement:
    """Place a model by the moments of its organs in the image.

    Parameters
    ----------
    parents : mapping of str to BSplineSurface
        Closed surfaces of the model's organs, RAS mm.
    targets : mapping of str to SolidMoments
        Of organs in the image, at least two of the model's.

    Returns
    -------
    Placement

    Raises
    ------
    ValueError
        If the organs of the image are of quite another size than the model's, or lie turned against it.
    """
    solids = {name: SolidMoments.of_surface(parents[name]) for name in targets}
    _, matrix = max((_settled(solids, targets, start) for start in _STARTS), key=lambda found: found[0])
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    degrees = float(np.degrees(Rotation.from_matrix(matrix[:3, :3] / scale).magnitude()))
    _check_similarity(scale, degrees)
    moved = {name: solid.moved(matrix) for name, solid in solids.items()}
    cross, own, (to, start) = _second_moments(moved, targets)
    linear = cross @ np.linalg.inv(own)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = linear, to - linear @ start
    maps = {name: transport_map(solid.moved(affine), targets[name]) for name, solid in moved.items()}
    return Placement(affine @ matrix, maps, scale, degrees)


def _check_similarity(scale: float, degrees: float) -> None:
    """Refuse what is no patient in the model's frame and unit."""
    if not SCALES[0] <= scale <= SCALES[1]:
        msg = (
            f"The organs in the image are {scale:.2g} times as large as the model's; {SCALES[0]:g} to {SCALES[1]:g} "
            "times is plausible. Check the unit (mm) of the image and of the model, and which organ is which."
        )
        raise ValueError(msg)
    if degrees > MOST_DEGREES:
        msg = (
            f"The organs in the image are turned by {degrees:.0f} degrees against the model; at most "
            f"{MOST_DEGREES:.0f} degrees are plausible. Check the frame (RAS or LPS) of the image and of the "
            "model, and which organ is which."
        )
        raise ValueError(msg)


def _root(matrix: np.ndarray) -> np.ndarray:
    """Square root of a symmetric, positive definite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def _second_moments(solids: Mapping[str, SolidMoments], targets: Mapping[str, SolidMoments]):
    """Second moments of all organs together, each counted alike: of the model and the image, of the model; centres."""
    start = np.mean([solid.center for solid in solids.values()], axis=0)
    to = np.mean([targets[name].center for name in solids], axis=0)
    cross, own = np.zeros((3, 3)), np.zeros((3, 3))
    for name, solid in solids.items():
        linear = transport_map(solid, targets[name])[:3, :3]
        cross += linear @ solid.covariance + np.outer(targets[name].center - to, solid.center - start)
        own += solid.covariance + np.outer(solid.center - start, solid.center - start)
    return cross, own, (to, start)


def _settled(solids: Mapping[str, SolidMoments], targets: Mapping[str, SolidMoments], matrix: np.ndarray):
    """Repeat the similarity from one on; what the last one explains of the second moments, and all of them as one."""
    explained = 0.0
    for _ in range(_MOST_ROUNDS):
        moved = {name: solid.moved(matrix) for name, solid in solids.items()}
        step, explained = _similarity(*_second_moments(moved, targets))
        matrix = step @ matrix
        if np.abs(step[:3, :3] - np.eye(3)).max() < _SETTLED:
            break
    return explained, matrix


def _similarity(cross: np.ndarray, own: np.ndarray, centers) -> tuple[np.ndarray, float]:
    """Similarity of least squares (Umeyama, IEEE PAMI 13:376, 1991), and what it explains of the second moments."""
    to, start = centers
    left, values, right = np.linalg.svd(cross)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float(values @ signs) / float(np.trace(own))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * (left * signs) @ right
    matrix[:3, 3] = to - matrix[:3, :3] @ start
    return matrix, scale * float(values @ signs)
