"""Matrices and loads of linear elasticity: all x components, then all y, then all z of the displacements."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from .elements import FiniteElements
from .problems import Material
from .surfaces import normal_integrals, surface_mass

# Components XX, YY, ZZ, XY, YZ, XZ of a symmetric tensor, as VTK counts them.
COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def stiffness_matrix(elements: FiniteElements, material: Material) -> sparse.csr_matrix:
    """Matrix of the integral of sigma(u) : epsilon(v), (3 n, 3 n), kPa mm.

    Parameters
    ----------
    elements : FiniteElements
    material : Material

    Returns
    -------
    csr_matrix

    Notes
    -----
    From six scalar matrices G_ij of the integrals of d_j u d_i v, which take a fraction of the memory of vectors' ones:
    block (i, j) is lambda G_ij + mu G_ji + delta_ij mu (G_00 + G_11 + G_22).
    """
    from skfem import BilinearForm

    lame_lambda, mu = material.lame
    products = {}
    for i, j in COMPONENTS:
        form = BilinearForm(lambda u, v, w, i=i, j=j: u.grad[j] * v.grad[i])
        products[i, j] = form.assemble(elements.basis)
        products[j, i] = products[i, j].T
    laplacian = mu * (products[0, 0] + products[1, 1] + products[2, 2])
    blocks = [
        [
            lame_lambda * products[i, j] + mu * products[j, i] + (laplacian if i == j else 0.0 * laplacian)
            for j in range(3)
        ]
        for i in range(3)
    ]
    return sparse.bmat(blocks, format="csr")


def mass_matrix(elements: FiniteElements) -> sparse.csr_matrix:
    """Matrix of the integral of u v for scalar functions, (n, n) mm^3."""
    from skfem import BilinearForm

    return BilinearForm(lambda u, v, w: u * v).assemble(elements.basis).tocsr()


def spring_matrix(elements: FiniteElements, triangles: np.ndarray, foundation: float) -> sparse.csr_matrix:
    """Matrix of the integral of k u . v over triangles (nodes of the mesh), (3 n, 3 n), kPa mm."""
    scalar = surface_mass(elements.mesh.points, triangles)[elements.nodes][:, elements.nodes]
    return sparse.block_diag([foundation * scalar] * 3, format="csr")


def body_load(elements: FiniteElements, force: np.ndarray) -> np.ndarray:
    """Vector of the integral of f . v over the volume for a constant f (kPa/mm), (3 n,) mN."""
    from skfem import LinearForm

    return np.outer(force, LinearForm(lambda v, w: 1.0 * v).assemble(elements.basis)).ravel()


def traction_load(elements: FiniteElements, triangles: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Vector of the integral of (sigma n) . v over triangles for a constant sigma, (3 n,) mN.

    Parameters
    ----------
    elements : FiniteElements
    triangles : (m, 3 or 6) ndarray of int
        Nodes of the mesh, counter-clockwise seen from outside.
    stress : (3, 3) array_like
        kPa; -p times the unit matrix for a pressure p.

    Returns
    -------
    (3 n,) ndarray
    """
    pulls = normal_integrals(elements.mesh.points, triangles)[elements.nodes]
    return (np.asarray(stress) @ pulls.T).ravel()


def mean_strains(elements: FiniteElements, displacement: np.ndarray) -> np.ndarray:
    """Mean strain of every element.

    Parameters
    ----------
    elements : FiniteElements
    displacement : (3, n) ndarray
        mm, at the degrees of freedom.

    Returns
    -------
    (m, 6) ndarray
        Components XX, YY, ZZ, XY, YZ, XZ of the tensor.
    """
    basis = elements.basis
    weights = basis.dx / basis.dx.sum(axis=1, keepdims=True)
    gradients = np.stack([(basis.interpolate(part).grad * weights).sum(axis=2) for part in displacement])
    return np.stack([(gradients[i, j] + gradients[j, i]) / 2.0 for i, j in COMPONENTS], axis=1)
