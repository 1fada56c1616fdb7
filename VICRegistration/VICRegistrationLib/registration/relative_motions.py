"""Motions of several stacks to each other, whatever surface lies between them.

A surface that was fitted to several stacks lies, at each place, at the edge of the one that is sharp there, and
confirms the motion with which it was fitted. Motions found in turn with it come to rest slowly: those of the demo's
organs were still off by 0.2 to 0.5 mm. Here the surface is free on each of its normal lines and eliminated from the
equations (their Schur complement): the edges of the stacks are compared with each other.
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

# Weight against a distance between two edges that is the same on all lines: on a part of an organ it looks like a
# shift. Half of it and two and a half times as much give the same errors on the demo's organs and on a real bladder;
# without it the stack that shows a third of that bladder is left out.
_GROWTH = 0.02
# Distance of an edge from the surface, in widths of the edge, from which on it is taken for another one: Tukey's
# biweight, with which a motion comes to rest where it started from anywhere within 1 mm and 2 degrees.
_FARTHEST = 1.0


@dataclass(frozen=True, eq=False)
class RelativeMotions:
    """Motions of k further stacks beside the first one.

    Parameters
    ----------
    motions : list of k (4, 4) ndarray
        mm.
    moved : float
        How far they are from those before, root mean square over the surface, mm.
    deviations : (k, 2) ndarray
        Standard deviations of each turn (degrees) and of each displacement of the surface's centre (mm), as far as the
        edges of the stacks are apart from each other after these motions.
    """

    motions: list[np.ndarray]
    moved: float
    deviations: np.ndarray


def relative_motions(
    surface: BSplineSurface, alignments: Sequence[Alignment], trusts: Sequence[float]
) -> RelativeMotions:
    """Find how further stacks have moved beside the first one, by the edges of all of them.

    Parameters
    ----------
    surface : BSplineSurface
        Near the edges.
    alignments : sequence of 1 + k Alignment
        Of the surface in the first stack, which has no motion, and in the further ones.
    trusts : sequence of 1 + k float
        How much a voxel of each counts.

    Returns
    -------
    RelativeMotions

    Notes
    -----
    Least squares: the sum of w_i (o_i - n' A m_i - g_i - s)^2 over all stacks i and normal lines is minimised over the
    place s of the surface on each line and seven unknowns of each further stack. There o is the offset of its edge, w
    its weight, and A m the displacement of the line's point by six of them; g is a distance between both edges that is
    the same on all lines, so that pixels of another size, or an organ that is a little fuller, do not turn it. All of
    them are 0 for the first stack. To first order in the motion; repeat it from those that are found.
    """
    u, v = surface.midpoints(*SAMPLES)
    points, normals = surface.points(u, v), surface.normals(u, v)
    center = points.mean(axis=0)
    turned = np.cross(np.eye(3)[:, None], points - center)
    displacements = np.concatenate([turned, np.broadcast_to(np.eye(3)[:, None], turned.shape)])
    along = np.column_stack([np.einsum("jnk,nk->nj", displacements, normals), np.ones(len(points))])
    held = np.einsum("ank,bnk->ab", displacements, displacements) / len(points)

    weights = np.array([_weights(each, trust) for each, trust in zip(alignments, trusts)])
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
    """Make the normal equations of the seven unknowns of each further stack, after the surface is eliminated.

    Parameters
    ----------
    weights, offsets : (1 + k, n) ndarray
        Of each stack's edge on each line.
    along : (n, 7) ndarray
        Displacement of an edge by each unknown.
    held : (6, 6) ndarray
        Mean squared displacement of the surface by the first six.
    before : (k, 6) ndarray
        Motions so far.

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
    """Variance of an edge of weight 1 by how far edges are apart after they were moved; all of shape (1 + k, n)."""
    total = np.maximum(weights.sum(axis=0), 1e-300)
    left = offsets - moved
    left = left - (weights * left).sum(axis=0) / total
    # How much a line shows of differences: little where one stack alone shows the edge.
    shared = (weights * (1.0 - weights / total)).sum(axis=0)
    return float((weights * left**2).sum() * (shared**2).sum() / max(shared.sum() ** 2, 1e-300))


def _weights(found: Alignment, trust: float) -> np.ndarray:
    """How exactly each line of a stack shows the place of the edge, (n,), by voxels; 0 where it shows none."""
    if found.view is None:
        return np.zeros_like(found.offsets)
    voxel = found.view.voxel
    near = np.clip(1.0 - (found.offsets / (_FARTHEST * found.view.tau)) ** 2, 0.0, None) ** 2
    return near * trust * found.sharpness / (abs(np.linalg.det(voxel)) * np.linalg.norm(voxel, axis=0).min() ** 2)


def _unknowns(motion: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Turn (radians) and shift (mm) of a motion (4, 4) about a centre, (6,)."""
    return np.append(Rotation.from_matrix(motion[:3, :3]).as_rotvec(), shift_of(motion, center))
