"""Conjugate gradients for elasticity: blocks of nodes first move as rigid bodies, then every node for itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

# About so many nodes move as one body, in at most so many bodies.
_BLOCK, _MOST_BLOCKS = 60, 256
_TOLERANCE = 1e-10
_MAX_ITERATIONS = 5000


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Solution of a linear system.

    Parameters
    ----------
    values : (3 n,) ndarray
    iterations : int
    residual : float
        Norm of what is left, relative to that of the right side.
    """

    values: np.ndarray
    iterations: int
    residual: float


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """Displacements of points by three translations and three small rotations about their centre.

    Parameters
    ----------
    points : (n, 3) ndarray

    Returns
    -------
    (3, n, 6) ndarray
        Components, points, motions; rotations are scaled to the size of translations.
    """
    offset = points - points.mean(axis=0)
    offset = offset / max(np.sqrt(np.square(offset).sum(axis=1).mean()), 1e-300)
    motions = np.zeros((3, len(points), 6))
    for axis in range(3):
        motions[axis, :, axis] = 1.0
        after, before = (axis + 1) % 3, (axis + 2) % 3
        motions[after, :, 3 + axis], motions[before, :, 3 + axis] = -offset[:, before], offset[:, after]
    return motions


def solve_elastic(
    stiffness: sparse.spmatrix, load: np.ndarray, points: np.ndarray, *, mass: sparse.spmatrix | None = None
) -> LinearSolution:
    """Solve a symmetric positive system of nodal displacements.

    Parameters
    ----------
    stiffness : (3 n, 3 n) sparse matrix
        All first components, then all second, then all third ones.
    load : (3 n,) ndarray
    points : (n, 3) ndarray
        Places of the nodes.
    mass : (n, n) sparse matrix, optional
        Give it if nothing holds the body: the solution then has no mean displacement and no mean rotation, weighted by
        this matrix. The load must have no resultant force and moment.

    Returns
    -------
    LinearSolution

    Raises
    ------
    RuntimeError
        If the iteration does not converge.

    Notes
    -----
    Preconditioned conjugate gradients. The preconditioner adds the solution for rigid motions of blocks of nodes
    (Nicolaides, SIAM Journal on Numerical Analysis 24, 1987) to that of each node by itself.
    """
    stiffness = stiffness.tocsr()
    held = None if mass is None else _holding(stiffness, points, mass)

    def apply(x):
        product = stiffness @ x
        return product if held is None else product + held @ (held.T @ x)

    precondition = _preconditioner(stiffness, points, held)
    scale = np.linalg.norm(load)
    if scale == 0.0:
        return LinearSolution(np.zeros_like(load), 0, 0.0)
    x, residual = np.zeros_like(load), load.copy()
    z = precondition(residual)
    direction, product = z.copy(), residual @ z
    for iteration in range(1, _MAX_ITERATIONS + 1):
        image = apply(direction)
        step = product / (direction @ image)
        x += step * direction
        residual -= step * image
        if np.linalg.norm(residual) <= _TOLERANCE * scale:
            return LinearSolution(x, iteration, float(np.linalg.norm(load - apply(x)) / scale))
        z = precondition(residual)
        product, previous = residual @ z, product
        direction = z + (product / previous) * direction
    msg = (
        f"The displacements did not converge in {_MAX_ITERATIONS} iterations; check the mesh for bad elements, take a "
        "Poisson's ratio farther from 0.5, or a stiffer foundation."
    )
    raise RuntimeError(msg)


def _holding(stiffness, points, mass) -> np.ndarray:
    """Columns (3 n, 6) whose products with themselves hold mean displacement and rotation as the body's stiffness."""
    motions = rigid_motions(points)
    weighted = np.concatenate([mass @ motions[axis] for axis in range(3)])
    weighted /= np.linalg.norm(weighted, axis=0)
    return weighted * np.sqrt(stiffness.diagonal().mean())


def _preconditioner(stiffness, points, held):
    motions = _block_motions(points)
    coarse = (motions.T @ stiffness @ motions).toarray()
    if held is not None:
        projected = motions.T @ held
        coarse += projected @ projected.T
    # Blocks of one or two nodes, or of nodes in a line, do not have all six motions.
    coarse[np.diag_indices_from(coarse)] += 1e-10 * np.diag(coarse).max()
    factor = cho_factor(coarse)
    inverse = _inverse_blocks(stiffness, len(points))

    def apply(residual):
        each = np.einsum("abn,bn->an", inverse, residual.reshape(3, -1)).ravel()
        return each + motions @ cho_solve(factor, motions.T @ residual)

    return apply


def _inverse_blocks(stiffness, n: int) -> np.ndarray:
    """Inverses of the nodes' own 3 x 3 matrices, (3, 3, n)."""
    blocks = np.empty((n, 3, 3))
    for row in range(3):
        for column in range(3):
            blocks[:, row, column] = stiffness[row * n : (row + 1) * n, column * n : (column + 1) * n].diagonal()
    return np.linalg.inv(blocks).transpose(1, 2, 0)


def _block_motions(points: np.ndarray) -> sparse.csr_matrix:
    """Rigid motions of blocks of neighbouring nodes as columns, (3 n, 6 blocks)."""
    n, pieces, columns = len(points), [], []
    for number, nodes in enumerate(_blocks(points)):
        motions = rigid_motions(points[nodes])
        rows = nodes + n * np.arange(3)[:, None]
        pieces.append((np.repeat(rows.ravel(), 6), motions.reshape(-1)))
        columns.append(np.tile(6 * number + np.arange(6), 3 * len(nodes)))
    rows, values = (np.concatenate(part) for part in zip(*pieces))
    return sparse.csr_matrix((values, (rows, np.concatenate(columns))), shape=(3 * n, 6 * len(columns)))


def _blocks(points: np.ndarray) -> list[np.ndarray]:
    """Halve sets of nodes across their longest extent until they are small."""
    blocks, target = [np.arange(len(points))], min(max(len(points) // _BLOCK, 1), _MOST_BLOCKS)
    while 2 * len(blocks) <= target:
        halves = []
        for nodes in blocks:
            order = nodes[np.argsort(points[nodes, np.ptp(points[nodes], axis=0).argmax()], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        blocks = halves
    return blocks
