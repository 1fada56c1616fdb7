"""Correction of a surface by boundary points: points on the organ's wall that the user gives.

A point must move its surroundings smoothly, and not make a local dent.

1. A smooth deformation of space takes the surface through the points, see :mod:`..geometry.space_deformation`. It can
   move the wall by 20 mm without folding it.
2. From there, the surface is fitted again to the grey levels around the points. The points are observations: the
   squared distance of each from the place of the surface that was nearest to it after step 1 is added to the objective.
   The surface is anchored to the deformed surface near the points, and to the surface before the correction elsewhere.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg
from scipy.spatial.distance import cdist

from ..geometry import bspline
from ..geometry.projection import Projection, closest_points
from ..geometry.space_deformation import agreeing, deformed_through
from ..geometry.surface import BSplineSurface
from ..geometry.validity import check_surface
from ..imaging.image import Image
from ..imaging.moments import ball_radius
from .boundary_points import LARGEST_LEFT_MM, check_distances
from .cost import Correlation, Objective
from .joint_stacks import with_stacks
from .nets import refined, sampled
from .options import FitOptions
from .sample_grid import SampledSurface
from .schedule import Schedule
from .stacks import StackUse
from .stages import Stage, Step, iterate_stage

# Radius of the deformation around a point, in radii of a ball with the organ's volume. The second value is taken if the
# first one moves the wall beyond the farthest point, inward or outward, by more than the share _BEYOND of the largest
# distance, at _SAMPLES places; or if it folds the surface. With the first value, the radius is at least _DISTANCES
# times the largest distance, with the second one _LEAST_DISTANCES times. A bladder that an expert draws without its
# tumours has an error of 0.87 mm with eight points, also with half and twice of the share; 1.05 mm with the first
# radius alone.
_RADII, _BEYOND, _SAMPLES = (1.0, 0.5), 0.05, (48, 32)
_DISTANCES, _LEAST_DISTANCES = 3.0, 2.0
# Reach of a point in the fit: the larger of this many radii of that ball and this many times the point's distance. With
# 1.6 distances the mean error of a bladder that is missed by up to 19 mm is 1.45 mm with eight points, with 3, 5 and 8
# it is 1.1 mm; with 5 and 8 the far wall of a thin organ is moved.
_REACH_RADII = 0.5
_REACH_DISTANCES = 3.0
# Longest spans of the net for a correction, in reaches. Surfaces then pass points 5 mm off the demo's organs within
# 0.05 to 0.14 mm; with half of it 0.04 to 0.09 mm, in three times the time, with twice of it 0.07 to 0.45 mm.
_SPAN = 0.55
# Factor of that length for a second attempt, if the surface still misses a point. One of seven bladders with 16 points
# misses them by 0.4 mm then, and by 1.1 mm without; half of this factor changes nothing there.
_FINER = 0.5
# Weight of the anchor; 1 is about that of a sharp edge. With half and twice of it, the distances from the points and
# the displacements of other walls change by no more than 0.1 mm.
_HOLD = 1.0
# Weights of the bending energy: the second one is taken if the surface misses points with the first one. With the
# first, points 6 mm apart make one bulge, and a point 5 mm off the demo's bladder bends its wall to a radius of 5.0 mm;
# with half of it to 4.5 mm, with twice to 5.6 mm, where it moves walls beyond half the organ's radius by more than 0.25
# mm. With a tenth the wall ripples by 0.2 mm between points.
_BENDING = (1.7e-3, 4e-5)
# Radius around a point within which the anchor holds the deformed surface, in reaches. With half of it the surface
# passes these points within 0.09 to 0.30 mm, with twice of it walls far from them move by up to 0.8 in place of 0.6 mm.
_NEAR = 0.7
# Without a point farther from the surface than this, mm, there is no correction.
_MET = 0.01


def correct(
    image: Image, surface: BSplineSurface, points: np.ndarray, options: FitOptions, stacks: Sequence[StackUse] = ()
) -> Generator[Step, None, BSplineSurface]:
    """Correct a surface by boundary points, step by step.

    Parameters
    ----------
    image : Image
        The grey levels.
    surface : BSplineSurface
        Closed organ, RAS mm.
    points : (n, 3) ndarray
        At least one, RAS mm.
    options : FitOptions
        With automatic choices filled in; `boundary_weight` is the weight of the points.
    stacks : sequence of StackUse
        Further stacks to which the surface was fitted.

    Yields
    ------
    Step

    Returns
    -------
    BSplineSurface
        A valid solid; its net is finer if necessary.

    Raises
    ------
    ValueError
        If a point is too far from the surface, the surface is no closed organ, or every surface through the points
        folds.
    """
    distances = closest_points(surface, points).distances
    check_distances(points, distances)
    away = np.abs(distances)
    farthest = float(away.max())
    if farthest < _MET:
        schedule = Schedule.around(image, surface, options, points=points)
        stage = with_stacks(schedule, surface, stacks, points=points).to_boundary_points
        cost = stage.cost_of(sampled(surface, options.closure), surface)
        yield Step(stage.name, 1, cost, 0.0, surface, stage.stop_rule)
        return surface
    ball = ball_radius(surface.volume())
    nearest = max(_REACH_RADII * ball, _REACH_DISTANCES * float(away.min()))
    before = refined(surface, _SPAN * nearest, closure=options.closure)
    kept, left = yield from _passed(image, before, points, _BENDING, options, stacks)
    last = kept
    if left * options.boundary_weight >= LARGEST_LEFT_MM:
        finer = refined(before, _FINER * _SPAN * nearest, closure=options.closure)
        if finer is not before:
            last, reached = yield from _passed(image, finer, points, _BENDING[-1:], options, stacks)
            kept = last if reached < left else kept
    if kept is None:
        msg = (
            f"No surface without folds passes the boundary points, {len(points)} of them and up to {farthest:.1f} mm "
            "from the surface. Check the points beside it, or separate the organ anew."
        )
        raise ValueError(msg)
    if kept is not last:
        yield kept
    return kept.surface


def _passed(
    image: Image,
    before: BSplineSurface,
    points: np.ndarray,
    bendings: Sequence[float],
    options: FitOptions,
    stacks: Sequence[StackUse],
) -> Generator[Step, None, tuple[Step | None, float]]:
    """Correct a surface without changing its net, with one bending energy after the other until it passes the points.

    Returns the last step and the largest distance from a point, mm; None and infinity if the surface folds.
    """
    ball = ball_radius(before.volume())
    deformed = _deformed(before, points, ball, options)
    if check_surface(deformed):
        return None, np.inf
    points = agreeing(deformed, points)
    away = np.abs(closest_points(before, points).distances)
    reach = np.maximum(_REACH_RADII * ball, _REACH_DISTANCES * away)
    observed = _Observed(before, deformed, points, reach, options)
    schedule = Schedule.around(image, deformed, options, points=points)
    stage = with_stacks(schedule, deformed, stacks, points=points).to_boundary_points
    kept, left = None, np.inf
    for bending in bendings:
        last = yield from observed.fitted(replace(stage, bending=bending))
        if check_surface(last.surface):
            break
        kept, left = last, float(np.abs(closest_points(last.surface, points).distances).max())
        if left * options.boundary_weight < LARGEST_LEFT_MM:
            break
    if kept is None:
        # The image around the points contradicts them: fitting to it folds the surface.
        cost = stage.cost_of(sampled(deformed, options.closure), deformed)
        kept = Step("boundary points, deformation alone", 1, cost, 0.0, deformed, "displacement")
        left = float(np.abs(closest_points(deformed, points).distances).max())
    if kept is not last:
        yield kept
    return kept, left


def _deformed(before: BSplineSurface, points: np.ndarray, ball: float, options: FitOptions) -> BSplineSurface:
    """Deform a surface through the points, with the smaller radius if the larger one moves walls too far."""
    parametrization = sampled(before, options.closure).parametrization
    distances = closest_points(before, points).distances
    farthest = np.abs(distances).max()
    for share in _RADII:
        radius = max(share * ball, (_DISTANCES if share == _RADII[0] else _LEAST_DISTANCES) * farthest)
        deformed = deformed_through(parametrization, points, radius)
        moved = closest_points(before, deformed.points(*deformed.midpoints(*_SAMPLES))).distances
        beyond = max(-moved.min() + min(distances.min(), 0.0), moved.max() - max(distances.max(), 0.0))
        if beyond < _BEYOND * farthest and not check_surface(deformed):
            break
    return deformed


@dataclass(frozen=True, eq=False)
class _Observed:
    """Fit to grey levels with boundary points as additional observations.

    Parameters
    ----------
    before, deformed : BSplineSurface
        Before the correction, and deformed through the points; with the same net.
    points : (n, 3) ndarray
        RAS mm.
    reach : (n,) ndarray
        Of each point, mm.
    options : FitOptions
    """

    before: BSplineSurface
    deformed: BSplineSurface
    points: np.ndarray
    reach: np.ndarray
    options: FitOptions

    @cached_property
    def feet(self) -> Projection:
        """Closest points of the deformed surface to the boundary points."""
        return closest_points(self.deformed, self.points)

    def fitted(self, stage: Stage) -> Generator[Step, None, Step]:
        """Run a stage on the grey levels from the deformed surface, step by step; returns the last step."""
        sampled_surface = sampled(self.deformed, self.options.closure)
        width = stage.virtual.profile.width
        correlations = stage.correlations(sampled_surface, share=self._nearness(sampled_surface, self.reach))
        weights = self.options.boundary_weight * np.pi * self.reach**2 / (width**2 * self.before.area())
        stiffness, reference = self._with_points(sampled_surface, weights, *self._hold(correlations, stage))
        objective = Objective(correlations, stiffness=stiffness, reference=reference)
        step, whole = None, Objective(stage.correlations(sampled_surface))
        for iteration, (iterate, stopped_by) in enumerate(iterate_stage(stage, objective), start=1):
            reached = sampled_surface.parametrization.deform(iterate.q)
            step = Step(stage.name, iteration, whole.cost_of(reached), iterate.displacement, reached, stopped_by)
            yield step
        return step

    def _nearness(self, sampled_surface: SampledSurface, radii: np.ndarray) -> np.ndarray:
        """Weight of each normal line of the deformed surface by its distance from the points, (n,).

        1 at a point and between two that are close together, 0 far from all and on the other side of the organ. Without
        the distinction of sides, the error of a bladder with eight points is 1.24 in place of 1.19 mm.
        """
        frame = sampled_surface.frame(np.zeros(sampled_surface.n_dof))
        alike = frame.normals @ self.deformed.normals(*self.feet.parameters.T).T
        near = np.clip(alike, 0.0, 1.0) * np.exp(-((cdist(frame.points, self.feet.points) / radii) ** 4))
        return 1.0 - (1.0 - near).prod(axis=1)

    def _hold(self, correlations: Sequence[Correlation], stage: Stage):
        """Energies of the displacement from the deformed surface: matrix K and vector f of q' K q - 2 f' q.

        Away from the points their minimum is the surface before the correction. Without that, a point 5 mm off the
        demo's bladder moves walls far from it by 0.97 in place of 0.19 mm.
        """
        sampled_surface = correlations[0].surface
        frame = sampled_surface.frame(np.zeros(sampled_surface.n_dof))
        near = self._nearness(sampled_surface, _NEAR * self.reach)
        unit = stage.virtual.profile.width**2
        way_back = (self.before.control_net - self.deformed.control_net).reshape(-1, 3)
        back = np.einsum("nk,nk->n", sampled_surface.grid.bases[0] @ way_back, frame.normals)
        weight = _HOLD * frame.area / unit
        along = frame.normals[:, :, None] * frame.normals[:, None, :]
        energy = correlations[0].energies(bending=stage.bending, sliding=stage.sliding, anchor=0.0)
        energy = energy + sampled_surface.quadratic_form(weight[:, None, None] * along)
        return energy, sampled_surface.normal_motion(frame.normals).T @ (weight * (1.0 - near) * back)

    def _with_points(self, sampled_surface: SampledSurface, weights: np.ndarray, energy, pull: np.ndarray):
        """Add the squared distances of the points to the energies: matrix of the sum, and its minimum, (n_dof,).

        The distance of a point is that from its foot, the place of the deformed surface that was nearest to it.
        """
        u, v = self.feet.parameters.T
        offsets, basis = self.points - self.deformed.points(u, v), _basis(self.deformed, u, v)
        total, right = sparse.csc_matrix((sampled_surface.n_dof, sampled_surface.n_dof)), pull.copy()
        for k, (matrix, index) in enumerate(
            zip(sampled_surface.parametrization.matrices, sampled_surface.parametrization.indices)
        ):
            motion = sparse.csr_matrix((len(weights), sampled_surface.n_dof)).tolil()
            motion[:, index] = basis @ matrix
            motion = motion.tocsr()
            total = total + motion.T @ sparse.diags(weights) @ motion
            right += motion.T @ (weights * offsets[:, k])
        if sparse.issparse(energy):
            form = (energy + total).tocsc()
            return form, sparse_linalg.spsolve(form, right)
        form = energy + total.toarray()
        return form, np.linalg.solve(form, right)


def _basis(surface: BSplineSurface, u: np.ndarray, v: np.ndarray) -> sparse.csr_matrix:
    """Matrix of the basis functions of a surface at pairs of parameters, (n, n_control)."""
    n_u, n_v, _ = surface.control_net.shape
    along_u = bspline.collocation(surface.degrees[0], surface.knots_u, u)
    along_v = bspline.collocation(surface.degrees[1], surface.knots_v, v)
    # Row-wise Kronecker product.
    return sparse.kron(along_u, np.ones((1, n_v))).multiply(sparse.kron(np.ones((1, n_u)), along_v)).tocsr()
