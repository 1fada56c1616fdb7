"""Motions of several stacks relative to each other, by the distances between their edges.

A surface that was fitted to several stacks follows, at each place, the stack that is sharp there, and so confirms the
motions with which it was fitted. Fitting surface and motions in turn therefore converges slowly: the motions of the
demo's organs were still wrong by 0.2 to 0.5 mm. Here the position of the surface on each normal line is an unknown that
is eliminated from the equations (Schur complement), so that the edges of the stacks are compared with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..geometry.parametrization import rigid_matrix
from ..geometry.surface import BSplineSurface
from .alignment import HOLD, SAMPLES, Alignment
from .stacks import shift_of

# Weight of the squared distance between two edges that is the same on all lines; it must be limited, because on a part
# of an organ it cannot be distinguished from a translation. Half and two and a half times of it give the same errors on
# the demo's organs and on a real bladder; without it the stack that shows a third of that bladder is left out.
_GROWTH = 0.02
# Distance of an edge from the surface, in widths of the edge, at which Tukey's biweight becomes 0. With it a motion
# converges from anywhere within 1 mm and 2 degrees.
_FARTHEST = 1.0


@dataclass(frozen=True, eq=False)
class RelativeMotions:
    """Motions of k further stacks relative to the first one.

    Parameters
    ----------
    motions : list of k (4, 4) ndarray
        mm.
    moved : float
        Largest change of a motion, as root mean square displacement over the surface, mm.
    deviations : (k, 2) ndarray
        Standard deviations of each rotation (degrees) and of each displacement of the surface's centre (mm), from the
        distances that remain between the edges of the stacks.
    """

    motions: list[np.ndarray]
    moved: float
    deviations: np.ndarray


def relative_motions(
    surface: BSplineSurface, alignments: Sequence[Alignment], voxel_weights: Sequence[float]
) -> RelativeMotions:
    """Improve the motions of further stacks relative to the first one, by the edges of all stacks.

    Parameters
    ----------
    surface : BSplineSurface
        Near the edges.
    alignments : sequence of 1 + k Alignment
        Of the surface in the first stack, with the identity as motion, and in the further ones.
    voxel_weights : sequence of 1 + k float
        Weight of a voxel of each stack.

    Returns
    -------
    RelativeMotions

    Notes
    -----
    Least squares: the sum of w_i (o_i - n' A m_i - g_i - s)^2 over all stacks i and normal lines is minimised over the
    position s of the surface on each line and seven unknowns of each further stack, six for m and one for g. Here o is
    the offset of the stack's edge, w its weight, and A m the displacement of the line's point by a small motion m. g is
    the same on all lines; without it, another pixel size or a fuller organ would turn the stack. m and g of the first
    stack are 0. The equations are of first order in the motion, so call the function again with the result.
    """
    u, v = surface.midpoints(*SAMPLES)
    points, normals = surface.points(u, v), surface.normals(u, v)
    center = points.mean(axis=0)
    turned = np.cross(np.eye(3)[:, None], points - center)
    displacements = np.concatenate([turned, np.broadcast_to(np.eye(3)[:, None], turned.shape)])
    along = np.column_stack([np.einsum("jnk,nk->nj", displacements, normals), np.ones(len(points))])
    held = np.einsum("ank,bnk->ab", displacements, displacements) / len(points)

    weights = np.array([_weights(each, voxel_weight) for each, voxel_weight in zip(alignments, voxel_weights)])
    offsets = np.array([each.offsets for each in alignments])
    motions = [each.motion for each in alignments[1:]]
    before = np.array([_unknowns(motion, center) for motion in motions])
    matrix, right = _equations(weights, offsets, along, held, before)
    inverse = np.linalg.pinv(matrix, hermitian=True)
    found = (inverse @ right).reshape(len(motions), 7)
    steps = found[:, :6]
    covariance = inverse * _variance(weights, offsets, np.vstack([np.zeros(7), found]) @ along.T)
    variances = np.maximum(np.diag(covariance).reshape(-1, 7), 0.0)
    deviations = np.sqrt(np.column_stack([variances[:, :3].sum(axis=1), variances[:, 3:6].sum(axis=1)]))
    deviations[:, 0] = np.degrees(deviations[:, 0])
    moved = float(np.sqrt(max(step @ held @ step for step in steps)))
    return RelativeMotions([m @ rigid_matrix(step, center) for m, step in zip(motions, steps)], moved, deviations)


def _equations(
    weights: np.ndarray, offsets: np.ndarray, along: np.ndarray, held: np.ndarray, before: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Make the normal equations for the seven unknowns of each further stack, with the surface eliminated.

    Parameters
    ----------
    weights, offsets : (1 + k, n) ndarray
        Of each stack's edge on each line.
    along : (n, 7) ndarray
        Displacement of an edge along the line by each unknown.
    held : (6, 6) ndarray
        Quadratic form of the mean squared displacement of the surface by the first six unknowns.
    before : (k, 6) ndarray
        Unknowns of the motions so far.

    Returns
    -------
    matrix : (7 k, 7 k) ndarray
    right : (7 k,) ndarray
    """
    total = np.maximum(weights.sum(axis=0), 1e-300)
    joint = (weights * offsets).sum(axis=0) / total
    count = len(before)
    matrix, right = np.zeros((count, 7, count, 7)), np.zeros((count, 7))
    for one in range(count):
        for other in range(count):
            left = weights[1 + one] * ((one == other) - weights[1 + other] / total)
            matrix[one, :, other] = along.T @ (left[:, None] * along)
            if one == other:
                matrix[one, :6, one, :6] += HOLD * left.sum() * held
                matrix[one, 6, one, 6] += _GROWTH * left.sum()
                right[one, :6] = -HOLD * left.sum() * held @ before[one]
        right[one] += along.T @ (weights[1 + one] * (offsets[1 + one] - joint))
    return matrix.reshape(right.size, right.size), right.ravel()


def _variance(weights: np.ndarray, offsets: np.ndarray, moved: np.ndarray) -> float:
    """Variance of an edge's offset at weight 1, from the distances between the moved edges; arrays (1 + k, n)."""
    total = np.maximum(weights.sum(axis=0), 1e-300)
    residuals = offsets - moved
    residuals = residuals - (weights * residuals).sum(axis=0) / total
    # A line's information about differences is small if one stack alone shows the edge there.
    shared = (weights * (1.0 - weights / total)).sum(axis=0)
    return float((weights * residuals**2).sum() * (shared**2).sum() / max(shared.sum() ** 2, 1e-300))


def _weights(found: Alignment, voxel_weight: float) -> np.ndarray:
    """Weights of a stack's offsets, (n,): in proportion to its voxels; 0 on lines without an edge."""
    if found.view is None:
        return np.zeros_like(found.offsets)
    voxel = found.view.voxel
    near = np.clip(1.0 - (found.offsets / (_FARTHEST * found.view.tau)) ** 2, 0.0, None) ** 2
    return (
        near * voxel_weight * found.sharpness / (abs(np.linalg.det(voxel)) * np.linalg.norm(voxel, axis=0).min() ** 2)
    )


def _unknowns(motion: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Rotation vector (radians) and translation (mm) of a motion (4, 4) about a centre, (6,)."""
    return np.append(Rotation.from_matrix(motion[:3, :3]).as_rotvec(), shift_of(motion, center))
