"""Correction of a surface by boundary points: places where a user knows the wall to be.

A point is knowledge about the whole surface, not a dent in it. So

1. one smooth deformation of space takes the surface through the points, see :mod:`..geometry.space_deformation`: it
   moves the wall by 20 mm where that is needed, and does not fold;
2. the grey levels around the points are fitted again from there, with the points as observations: beside the residuals
   of the image, each point pulls the place of the deformed surface that is nearest to it. Near a point the deformation
   is held, away from it the surface before; between the two, the surface goes to the edge that the image shows.
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
from ..imaging.boxes import ball_radius
from ..imaging.image import Image
from .boundary_points import LARGEST_LEFT_MM, check_distances
from .cost import Correlation, Objective
from .joint_stacks import with_stacks
from .nets import refined, sampled
from .options import FitOptions
from .sample_grid import SampledSurface
from .schedule import Schedule
from .stacks import StackUse
from .stages import Stage, Step, iterate_stage

# How far around a point space is deformed, in radii of a ball of the organ's volume: the second one where with the
# first a wall is moved farther than the points lie off by more than this share of the largest distance, measured at so
# many places. And at least this many times as far as the farthest point lies off, with the first one and with the
# second. A bladder that an expert draws without its tumours ends at 0.87 mm with eight points so, and with half and
# twice this share; at 1.05 with the first radius alone.
_RADII, _BEYOND, _SAMPLES = (1.0, 0.5), 0.05, (48, 32)
_DISTANCES, _LEAST_DISTANCES = 3.0, 2.0
# How far around a point it counts for the fit: likewise. With 1.6 distances eight points leave a mean of 1.45 mm in a
# bladder that is missed by up to 19 mm, with 3, 5 and 8 one of 1.1; with 5 and 8 the far wall of a thin organ is moved.
_REACH_RADII = 0.5
_REACH_DISTANCES = 3.0
# The longest spans of a net that can follow a correction, in reaches. Points 5 mm off the demo's organs are met to 0.05
# to 0.14 mm; with half of it to 0.04 to 0.09, which takes three times as long, with twice of it to 0.07 to 0.45.
_SPAN = 0.55
# Shorter spans, as a share, for points that the surface does not pass so. One of seven bladders with 16 points leaves
# them by 0.4 mm then, and by 1.1 mm without; half of this share changes nothing there.
_FINER = 0.5
# Weight against leaving the surface before, away from the points, and the deformed one, at them; 1 is about that of a
# sharp edge. With half and twice as much, points are met and other walls moved by no more than 0.1 mm differently.
_HOLD = 1.0
# Bending energies: a stiff one, and one with which points are met that this leaves off. With the first, points 6 mm
# apart make one bulge, and one 5 mm off the demo's bladder bends its wall to a radius of 5.0 mm; with half of it to 4.5
# mm, with twice to 5.6 mm, where it moves walls beyond half the organ's radius by more than 0.25 mm. With a tenth the
# wall ripples by 0.2 mm between points.
_BENDING = (1.7e-3, 4e-5)
# Radius around a point within which the deformed surface counts, in reaches. With half of it these points are met to
# 0.09 to 0.30 mm, with twice of it walls far from them are moved by up to 0.8 in place of 0.6 mm.
_NEAR = 0.7
# Points nearer to the surface than this, mm, ask for no correction.
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
        With automatic choices filled in; `boundary_weight` is that of the points.
    stacks : sequence of StackUse
        Further stacks that the surface was fitted to.

    Yields
    ------
    Step

    Returns
    -------
    BSplineSurface
        Valid; with a finer net where that of the surface could not follow.

    Raises
    ------
    ValueError
        If a point is too far from the surface, the surface is no closed organ, or no surface without folds passes the
        points.
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
    """Take a surface through points with its own net; the last step and the largest distance left, None and infinity.

    Where a stage with the first bending energy does not meet them, it is run with the next one.
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
        # What the image shows beside the points contradicts them.
        cost = stage.cost_of(sampled(deformed, options.closure), deformed)
        kept = Step("boundary points, deformation alone", 1, cost, 0.0, deformed, "displacement")
        left = float(np.abs(closest_points(deformed, points).distances).max())
    if kept is not last:
        yield kept
    return kept, left


def _deformed(before: BSplineSurface, points: np.ndarray, ball: float, options: FitOptions) -> BSplineSurface:
    """Deform space through the points, as far around them as moves no wall much farther than they lie off."""
    space = sampled(before, options.closure).parametrization
    distances = closest_points(before, points).distances
    farthest = np.abs(distances).max()
    for share in _RADII:
        radius = max(share * ball, (_DISTANCES if share == _RADII[0] else _LEAST_DISTANCES) * farthest)
        deformed = deformed_through(space, points, radius)
        moved = closest_points(before, deformed.points(*deformed.midpoints(*_SAMPLES))).distances
        beyond = max(-moved.min() + min(distances.min(), 0.0), moved.max() - max(distances.max(), 0.0))
        if beyond < _BEYOND * farthest and not check_surface(deformed):
            break
    return deformed


@dataclass(frozen=True, eq=False)
class _Observed:
    """Boundary points as observations beside the grey levels.

    Parameters
    ----------
    before, deformed : BSplineSurface
        Without the points, and deformed through them; of the same net.
    points : (n, 3) ndarray
    reach : (n,) ndarray
        How far around each point it counts, mm.
    options : FitOptions
    """

    before: BSplineSurface
    deformed: BSplineSurface
    points: np.ndarray
    reach: np.ndarray
    options: FitOptions

    @cached_property
    def feet(self) -> Projection:
        """The places of the deformed surface that are nearest to the points."""
        return closest_points(self.deformed, self.points)

    def fitted(self, stage: Stage) -> Generator[Step, None, Step]:
        """Run a stage on the grey levels from the deformed surface, step by step; returns the last one."""
        space = sampled(self.deformed, self.options.closure)
        width = stage.virtual.profile.width
        correlations = stage.correlations(space, share=self._nearness(space, self.reach))
        weights = self.options.boundary_weight * np.pi * self.reach**2 / (width**2 * self.before.area())
        stiffness, reference = self._with_points(space, weights, *self._hold(correlations, stage))
        objective = Objective(correlations, stiffness=stiffness, reference=reference)
        step, whole = None, Objective(stage.correlations(space))
        for iteration, (iterate, stopped_by) in enumerate(iterate_stage(stage, objective), start=1):
            reached = space.parametrization.deform(iterate.q)
            step = Step(stage.name, iteration, whole.cost_of(reached), iterate.displacement, reached, stopped_by)
            yield step
        return step

    def _nearness(self, space: SampledSurface, radii: np.ndarray) -> np.ndarray:
        """How near each normal line of the deformed surface is to the points, on the same side of the organ, (n,).

        1 at a point and between two that are close together, 0 far from all. Where sides do not count, a bladder with
        eight points is off by 1.24 in place of 1.19 mm.
        """
        frame = space.frame(np.zeros(space.n_dof))
        alike = frame.normals @ self.deformed.normals(*self.feet.parameters.T).T
        near = np.clip(alike, 0.0, 1.0) * np.exp(-((cdist(frame.points, self.feet.points) / radii) ** 4))
        return 1.0 - (1.0 - near).prod(axis=1)

    def _hold(self, correlations: Sequence[Correlation], stage: Stage):
        """Energies of the displacement since the deformed surface: matrix K and vector f of q' K q - 2 f' q.

        Away from the points they lead back to the surface before. Without that, a point 5 mm off the demo's bladder
        moves walls far from it by 0.97 in place of 0.19 mm.
        """
        space = correlations[0].surface
        frame = space.frame(np.zeros(space.n_dof))
        near = self._nearness(space, _NEAR * self.reach)
        unit = stage.virtual.profile.width**2
        back = np.einsum("nk,nk->n", space.grid.bases[0] @ self._way_back(), frame.normals)
        weight = _HOLD * frame.area / unit
        along = frame.normals[:, :, None] * frame.normals[:, None, :]
        energy = correlations[0].energies(bending=stage.bending, sliding=stage.sliding, anchor=0.0)
        energy = energy + space.quadratic_form(weight[:, None, None] * along)
        return energy, space.normal_motion(frame.normals).T @ (weight * (1.0 - near) * back)

    def _way_back(self) -> np.ndarray:
        """From the control points of the deformed surface to those of the surface before, (n_control, 3) mm."""
        return (self.before.control_net - self.deformed.control_net).reshape(-1, 3)

    def _with_points(self, space: SampledSurface, weights: np.ndarray, energy, pull: np.ndarray):
        """Energies and points as one quadratic form about its rest: its matrix and the rest, (n_dof,).

        Each point pulls the place of the deformed surface that is nearest to it.
        """
        u, v = self.feet.parameters.T
        offsets, basis = self.points - self.deformed.points(u, v), _basis(self.deformed, u, v)
        total, right = sparse.csc_matrix((space.n_dof, space.n_dof)), pull.copy()
        for k, (matrix, index) in enumerate(zip(space.parametrization.matrices, space.parametrization.indices)):
            motion = sparse.csr_matrix((len(weights), space.n_dof)).tolil()
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
