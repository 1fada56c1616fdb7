"""Correction of a surface by boundary points, in their surroundings only.

A net of 9x7 is too coarse for a dent of 5 mm: one control point moves a third of the organ. So the net is made finer
without changing the surface, and a height over the surface is sought in the control points around the boundary points.
Four energies make it, all relative to the surface before:

- each point pulls the place of the surface nearest to it along the normal there;
- the height is stiff as a thin plate, in millimetres on the surface itself, so that poles and seam do not show;
- it lies on an elastic bed that grows harder away from the points, which ends the dent without ringing;
- the grey levels, in a ring around each point. At the point itself the doctor's word counts and not theirs, and farther
  away they have had theirs before; and a point in agreement with the surface leaves it as it is.

All other control points of the finer net stay where they are.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse import linalg as sparse_linalg
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ..geometry import bspline
from ..geometry.parametrization import Parametrization
from ..geometry.projection import Projection, closest_points
from ..geometry.surface import BSplineSurface
from ..imaging.boxes import ball_radius
from .boundary import check_distances
from .cost import Correlation, Objective
from .nets import refined, sampled
from .sample_grid import Frame
from .stages import Stage, Step, iterate_stage

# How far around a point the surface may move: this part of the radius of a ball of the organ's volume, but at least
# this many times as far as the point lies off.
_REACH_RADII = 0.5
_REACH_DEVIATIONS = 1.6
# The finest spans that are needed, in reaches: tried on phantoms, with half as many the dent rings.
_SPAN = 0.55
# The dent of a thin plate on an even bed has sunk to 5 % at 3.2 times the plate's characteristic length.
_PLATE_LENGTH = 1.0 / 3.2
# The same between neighbours within reach of each other, as a share of their distance: a row of points makes one dent.
_NEIGHBOURS = 0.75
# Hardness of the bed at a point, where 1 is about that of a sharp edge, and how much harder it is at the reach.
_BED = 0.05
_BED_GROWTH = 20.0
# The ring in which the grey levels count, as radii of two Gaussians in reaches.
_RING = (0.25, 0.6)
# A point that lies off by this part of the ramp's width opens its ring to 63 %.
_OPENING = 0.5
# Points nearer to the surface than this are met, mm.
_MET = 0.01
# Points that would need a steeper slope between them than this, within the plate's length, contradict each other.
_STEEPEST = 3.0


def correct(
    surface: BSplineSurface, points: np.ndarray, stage: Stage, *, closure: str, weight: float
) -> Generator[Step, None, BSplineSurface]:
    """Pull a surface to boundary points, step by step.

    Parameters
    ----------
    surface : BSplineSurface
        Closed organ.
    points : (n, 3) ndarray
        At least one; in the surface's frame, mm.
    stage : Stage
        Sampler, levels and stop rule; its energies do not count.
    closure : {"smooth", "paper"}
        How the surface is closed and stays closed.
    weight : float
        Weight of the points, dimensionless: with 1 a point is as strong as a sharp edge on a disc of the radius of its
        reach.

    Yields
    ------
    Step
        With the cost of the whole surface.

    Returns
    -------
    BSplineSurface
        With a finer net where there was something to move.

    Raises
    ------
    ValueError
        If a point is too far from the surface, or the surface is no closed organ.
    """
    feet = closest_points(surface, points)
    check_distances(points, feet.distances)
    reach = np.maximum(_REACH_RADII * ball_radius(surface.volume()), _REACH_DEVIATIONS * np.abs(feet.distances))
    met = np.abs(feet.distances).max() < _MET
    finer = surface if met else refined(surface, _SPAN * reach.min(), closure=closure)
    whole = stage.correlation(sampled(finer, closure))
    samples = whole.sample(np.zeros(whole.surface.n_dof))
    if met:
        yield Step(stage.name, 1, samples.cost, 0.0, surface, stage.stop_rule)
        return surface
    patch = _Patch.around(feet, reach, whole)
    unit = 1.0 / (stage.virtual.profile.width**2 * patch.area)
    stiffness, rest = patch.pulled(points, np.pi * weight * unit * reach**2, unit * patch.plate(whole))
    local = whole.restricted(patch.heights, patch.lines, share=patch.ring_share(stage.virtual.profile.width))
    judge = whole.restricted(patch.heights, patch.lines, share=np.ones(len(patch.lines)))
    others = samples.cost - judge.sample(np.zeros(patch.heights.n_dof)).cost
    objective = Objective([local], stiffness=stiffness if local.surface.sparse else stiffness.toarray(), reference=rest)
    for iteration, (iterate, stopped_by) in enumerate(iterate_stage(stage, objective), start=1):
        finer = patch.heights.deform(iterate.q)
        cost = others + judge.sample(iterate.q).cost
        yield Step(stage.name, iteration, cost, iterate.displacement, finer, stopped_by)
    return finer


@dataclass(frozen=True, eq=False)
class _Patch:
    """Surroundings of the boundary points on a surface.

    Parameters
    ----------
    heights : Parametrization
        Degrees of freedom are moved along the normals of the surface.
    shape : (n_control, n_dof) csr_matrix
        The height over the surface as a spline.
    lines : (n_lines,) ndarray of int
        Samples of the surface that it moves.
    feet : Projection
        Of the boundary points to the surface.
    reach : (n_points,) ndarray
        mm.
    distances : (n_lines, n_points) ndarray
        Of the samples from the feet, in reaches.
    area : float
        Of the whole surface, mm^2.
    """

    heights: Parametrization
    shape: sparse.csr_matrix
    lines: np.ndarray
    feet: Projection
    reach: np.ndarray
    distances: np.ndarray
    area: float

    @classmethod
    def around(cls, feet: Projection, reach: np.ndarray, whole: Correlation) -> _Patch:
        """Find the degrees of freedom and the samples within reach of the points' feet."""
        closed = whole.parametrization
        surface, frame = closed.surface, whole.surface.frame(np.zeros(closed.n_dof))
        u, v = _places(closed)
        places = surface.points(u, v)
        apart = cdist(places, feet.points)
        near = (apart <= np.maximum(reach, apart.min(axis=0))).any(axis=1)
        shape = closed.matrices[0].tocsc()[:, near].tocsr()
        normals = _smoothed_normals(places[near], frame, 0.5 * _PLATE_LENGTH * reach.min())
        index = np.arange(shape.shape[1])
        matrices = tuple((shape @ sparse.diags(along)).tocsr() for along in normals.T)
        lines = np.flatnonzero(np.diff((whole.surface.grid.bases[0] @ shape).indptr))
        return cls(
            heights=Parametrization(surface, matrices, (index,) * 3, len(index)),
            shape=shape,
            lines=lines,
            feet=feet,
            reach=reach,
            distances=cdist(frame.points[lines], feet.points) / reach,
            area=float(frame.length.mean() * np.prod(np.ptp(surface.domain, axis=1))),
        )

    def ring_share(self, width: float) -> np.ndarray:
        """How much the grey levels count on each line, (n_lines,)."""
        squared = self.distances**2
        opening = 1.0 - np.exp(-((self.feet.distances / (_OPENING * width)) ** 2))
        outer = (opening * np.exp(-squared / _RING[1] ** 2)).max(axis=1)
        return outer * (1.0 - np.exp(-squared / _RING[0] ** 2).max(axis=1))

    def plate(self, whole: Correlation) -> sparse.csc_matrix:
        """Energy of plate and bed, integrated over the surface, (n_dof, n_dof) in mm^2 for heights in mm."""
        frame = whole.surface.frame(np.zeros(whole.parametrization.n_dof))
        area = self.area * frame.length[self.lines] / frame.length.sum()
        height = whole.surface.grid.bases[0][self.lines] @ self.shape
        lengths = self._plate_lengths()
        length = np.where(self.distances <= 1.0, lengths, lengths.min()).max(axis=1)
        growth = _BED_GROWTH ** (np.minimum(self.distances.min(axis=1), 1.0) ** 2)
        total = height.T @ sparse.diags(_BED * area * growth) @ height
        plate = sparse.diags(_BED * area * length**4)
        for factor, second in zip((1.0, 2.0, 1.0), self._second_derivatives(whole, frame)):
            total = total + factor * (second.T @ plate @ second)
        return total.tocsc()

    def _plate_lengths(self) -> np.ndarray:
        """Characteristic length of the plate at each boundary point, mm: a row of them makes one dent, not a row."""
        shares = np.full(len(self.reach), _PLATE_LENGTH)
        if len(shares) > 1:
            apart = cKDTree(self.feet.points).query(self.feet.points, k=2)[0][:, 1] / self.reach
            shares = np.where(apart <= 1.0, np.maximum(_NEIGHBOURS * apart, shares), shares)
        return shares * self.reach

    def pulled(self, points: np.ndarray, weights: np.ndarray, plate) -> tuple[sparse.csc_matrix, np.ndarray]:
        """Energy of points, plate and bed about their rest: its matrix, and the rest, (n_dof,)."""
        start, pulled, rest = self.heights.surface, self.heights.surface, np.zeros(self.heights.n_dof)
        means = self._means()
        weights = sparse.diags(np.diff(means.indptr) * (means @ weights))
        for parameters in (self.feet.parameters, None):
            # The finer net has the same parameters; once pulled, the surface has other feet.
            u, v = (closest_points(pulled, points).parameters if parameters is None else parameters).T
            normals = pulled.normals(u, v)
            basis = _basis(start, u, v)
            along = means @ sum(sparse.diags(n) @ basis @ m for n, m in zip(normals.T, self.heights.matrices))
            offsets = means @ np.einsum("nk,nk->n", points - start.points(u, v), normals)
            matrix = (plate + along.T @ weights @ along).tocsc()
            rest = sparse_linalg.spsolve(matrix, along.T @ (weights @ offsets))
            pulled = self.heights.deform(rest)
        return matrix, rest

    def _means(self) -> sparse.csr_matrix:
        """Means of points that contradict each other, (n_places, n_points); most have a place of their own."""
        feet, heights, count = self.feet.points, self.feet.distances, len(self.reach)
        a, b = cKDTree(feet).query_pairs(_PLATE_LENGTH * self.reach.min(), output_type="ndarray").T
        steep = np.abs(heights[a] - heights[b]) > _STEEPEST * np.linalg.norm(feet[a] - feet[b], axis=1)
        joined = sparse.csr_matrix((np.ones(steep.sum()), (a[steep], b[steep])), shape=(count, count))
        number, place = csgraph.connected_components(joined, directed=False)
        members = sparse.csr_matrix((np.ones(count), (place, np.arange(count))), shape=(number, count))
        return sparse.diags(1.0 / np.bincount(place)) @ members

    def _second_derivatives(self, whole: Correlation, frame: Frame) -> list[sparse.csr_matrix]:
        """Second derivatives of the height along two unit tangents a and b: aa, ab, bb, three (n_lines, n_dof), 1/mm.

        Covariant ones, S_ab not counting: a height that only tilts a plane is not bent, be it at a pole.
        """
        bases = [basis[self.lines] for basis in whole.surface.grid.bases]
        net = self.heights.surface.control_net.reshape(-1, 3)
        tangents = np.stack([tangent[self.lines] for tangent in frame.tangents], axis=1)
        metric = tangents @ tangents.transpose(0, 2, 1)
        dual = np.linalg.solve(metric, tangents)
        along_u, along_v = (basis @ self.shape for basis in bases[1:3])
        seconds = []
        for basis in bases[3:]:
            symbols = np.einsum("nak,nk->na", dual, basis @ net)
            turned = sparse.diags(symbols[:, 0]) @ along_u + sparse.diags(symbols[:, 1]) @ along_v
            seconds.append(basis @ self.shape - turned)
        # Columns of the inverse of the Cholesky factor's transpose make the tangents orthonormal.
        unit = np.linalg.inv(np.linalg.cholesky(metric)).transpose(0, 2, 1)
        result = []
        for a, b in ((0, 0), (0, 1), (1, 1)):
            mixed = unit[:, 0, a] * unit[:, 1, b] + unit[:, 1, a] * unit[:, 0, b]
            shares = (unit[:, 0, a] * unit[:, 0, b], mixed, unit[:, 1, a] * unit[:, 1, b])
            result.append(sum(sparse.diags(share) @ second for share, second in zip(shares, seconds)))
        return result


def _places(closed: Parametrization) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (u, v) of each degree of freedom of one coordinate: those of the control point that it moves most."""
    surface = closed.surface
    columns = surface.control_net.shape[1]
    most = np.asarray(abs(closed.matrices[0]).tocsc().argmax(axis=0)).ravel()
    u, v = (
        bspline.greville_abscissae(degree, knots)
        for degree, knots in zip(surface.degrees, (surface.knots_u, surface.knots_v))
    )
    # A pole and its ring move together, along the normal of the pole: so the ring stays in one plane.
    v[[1, -2]] = v[[0, -1]]
    return u[most // columns], v[most % columns]


def _smoothed_normals(places: np.ndarray, frame: Frame, radius: float) -> np.ndarray:
    """Mean normals of the surface around places (n, 3): unit vectors that do not follow its ripples, (n, 3).

    Control points lie fractions of a millimetre apart around a pole, where directions that differ fold the surface.
    """
    squared = cdist(places, frame.points, "sqeuclidean")
    weights = frame.length * np.exp((squared.min(axis=1, keepdims=True) - squared) / radius**2)
    mean = weights @ frame.normals
    return mean / np.linalg.norm(mean, axis=1, keepdims=True)


def _basis(surface: BSplineSurface, u: np.ndarray, v: np.ndarray) -> sparse.csr_matrix:
    """Basis functions of a surface at pairs of parameters, (n, n_control)."""
    columns = surface.control_net.shape[1]
    first_u, values_u = bspline.nonzero_basis(surface.degrees[0], surface.knots_u, u)
    first_v, values_v = bspline.nonzero_basis(surface.degrees[1], surface.knots_v, v)
    i = first_u[:, None] + np.arange(values_u.shape[1])
    j = first_v[:, None] + np.arange(values_v.shape[1])
    index = (i[:, :, None] * columns + j[:, None, :]).reshape(len(i), -1)
    values = (values_u[:, :, None] * values_v[:, None, :]).reshape(len(i), -1)
    rows = np.arange(len(i) + 1) * index.shape[1]
    shape = (len(i), surface.control_net.shape[0] * columns)
    return sparse.csr_matrix((values.ravel(), index.ravel(), rows), shape=shape)
