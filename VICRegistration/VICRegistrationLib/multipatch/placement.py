"""Placement of a generic model in an image: one similarity and one affine map for all organs.

Each organ is represented by volume, centre and covariance of the solid: of the model's surface, and of the separated
region. Between two such solids there is the optimal-transport map of Gaussians, which maps the moments of one to those
of the other without a turn or a reflection, so that principal axes need not be matched. The similarity and the affine
map are the least-squares fits to these maps of all organs.
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

# Plausible scales of a patient against the model; others mean another unit (cm, or metres).
SCALES = (0.5, 2.0)
# Largest plausible turn of a patient against the model; LPS taken for RAS is half a turn.
MOST_DEGREES = 45.0
# The transport maps depend on how the model is turned, so the similarity is iterated until it changes by less than
# this: a few times for usual patients, and 50 times for one that is turned by 45 degrees.
_SETTLED = 1e-5
_MOST_ROUNDS = 100
# The iteration starts at the model as it is, and after half a turn about each axis of the patient: it does not find
# these turns by itself, for instance where front is taken for back.
_STARTS = [np.diag([*signs, 1.0]) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
# Of results whose explained second moments differ by no more than this share, which is rounding, the first is taken: a
# half turn of balls in a row explains as much as none.
_EQUAL = 1e-9


@dataclass(frozen=True, eq=False)
class SolidMoments:
    """Volume, centre and covariance of a solid.

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
        """Return the moments of the solid that a closed surface encloses.

        Notes
        -----
        By the divergence theorem, the integral of a homogeneous polynomial f of degree k over the solid is the integral
        of f(x) x . n over the surface, divided by k + 3. On every knot span that integrand is a polynomial in u and v,
        so that Gauss quadrature is exact.
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
        """Return the moments of a separated region."""
        found = moments(region)
        covariance = found.axes.T @ np.diag(found.extents**2) @ found.axes
        return cls(1000.0 * region.volume_ml, found.center, covariance)

    def moved(self, matrix: np.ndarray) -> SolidMoments:
        """Return the moments of the solid after an affine map, (4, 4)."""
        linear = matrix[:3, :3]
        return SolidMoments(
            self.volume * abs(float(np.linalg.det(linear))),
            linear @ self.center + matrix[:3, 3],
            linear @ self.covariance @ linear.T,
        )


@dataclass(frozen=True, eq=False)
class Placement:
    """Position of a model in an image.

    Parameters
    ----------
    matrix : (4, 4) ndarray
        The affine map from the model to the image, RAS mm.
    maps : dict of str to (4, 4) ndarray
        Affine map of each organ to its region, to be applied after `matrix`; near the identity.
    scale : float
        Scale of the similarity.
    degrees : float
        Angle of its rotation.
    """

    matrix: np.ndarray
    maps: dict[str, np.ndarray]
    scale: float
    degrees: float


def transport_map(source: SolidMoments, target: SolidMoments) -> np.ndarray:
    """Affine map from a solid's centre and covariance to another's, with the least mean square displacement.

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
        Moments of these organs in the image, at least two.

    Returns
    -------
    Placement

    Raises
    ------
    ValueError
        If scale or rotation between the model's organs and the image's are not plausible.
    """
    solids = {name: SolidMoments.of_surface(parents[name]) for name in targets}
    found = [_settled(solids, targets, start) for start in _STARTS]
    least = (1.0 - _EQUAL) * max(explained for explained, _ in found)
    matrix = next(matrix for explained, matrix in found if explained >= least)
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
    """Refuse a scale or a rotation that means another unit or frame."""
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
    """Second moments of all organs, equally weighted: image with model, and model with itself; the two centres."""
    start = np.mean([solid.center for solid in solids.values()], axis=0)
    to = np.mean([targets[name].center for name in solids], axis=0)
    cross, own = np.zeros((3, 3)), np.zeros((3, 3))
    for name, solid in solids.items():
        linear = transport_map(solid, targets[name])[:3, :3]
        cross += linear @ solid.covariance + np.outer(targets[name].center - to, solid.center - start)
        own += solid.covariance + np.outer(solid.center - start, solid.center - start)
    return cross, own, (to, start)


def _settled(solids: Mapping[str, SolidMoments], targets: Mapping[str, SolidMoments], matrix: np.ndarray):
    """Iterate the similarity from a start matrix; the part of the second moments that it explains, and the matrix."""
    explained = 0.0
    for _ in range(_MOST_ROUNDS):
        moved = {name: solid.moved(matrix) for name, solid in solids.items()}
        step, explained = _similarity(*_second_moments(moved, targets))
        matrix = step @ matrix
        if np.abs(step[:3, :3] - np.eye(3)).max() < _SETTLED:
            break
    return explained, matrix


def _similarity(cross: np.ndarray, own: np.ndarray, centers) -> tuple[np.ndarray, float]:
    """Least-squares similarity (Umeyama, IEEE PAMI 13:376, 1991), and the part of the second moments it explains."""
    to, start = centers
    left, values, right = np.linalg.svd(cross)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float(values @ signs) / float(np.trace(own))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * (left * signs) @ right
    matrix[:3, 3] = to - matrix[:3, :3] @ start
    return matrix, scale * float(values @ signs)
