"""A tetrahedral mesh with scikit-fem's functions on it: Lagrange elements, linear or second order and then curved."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..meshing.groups import faces_of
from ..meshing.tetrahedra import TetrahedralMesh


def require_scikit_fem() -> None:
    """Refuse to go on without scikit-fem.

    Raises
    ------
    RuntimeError
        If it is not installed.
    """
    try:
        import skfem  # noqa: F401
    except ImportError as error:
        msg = "Simulations need scikit-fem, which is not installed; run pip install 'vicregistration[fe]'."
        raise RuntimeError(msg) from error


class FiniteElements:
    """Functions that are continuous on a mesh and polynomial on each of its elements.

    Parameters
    ----------
    mesh : TetrahedralMesh
        RAS mm. With ten nodes, functions and geometry are quadratic (isoparametric elements).

    Raises
    ------
    RuntimeError
        If scikit-fem is not installed.
    ValueError
        If the mesh has no elements.
    """

    def __init__(self, mesh: TetrahedralMesh) -> None:
        require_scikit_fem()
        import skfem

        if not len(mesh.tetrahedra):
            msg = "The mesh has no tetrahedra; give a volume mesh."
            raise ValueError(msg)
        self.mesh = mesh
        corners, cells = np.unique(mesh.tetrahedra[:, :4], return_inverse=True)
        cells = np.ascontiguousarray(cells.reshape(-1, 4).T)
        places = np.ascontiguousarray(mesh.points[corners].T)
        grid = skfem.MeshTet1(places, cells)
        element = skfem.ElementTetP1()
        if mesh.order == 2:
            element = skfem.ElementTetP2()
            dofs = skfem.Basis(grid, element).element_dofs
            places = np.empty((3, dofs.max() + 1))
            places[:, dofs] = mesh.points[mesh.tetrahedra].transpose(2, 1, 0)
            grid = skfem.MeshTet2(places, cells)
        self.basis = skfem.Basis(grid, element)
        # The mesh's node of every degree of freedom: scikit-fem counts corners first, then edges.
        self.nodes = np.empty(self.basis.N, dtype=int)
        self.nodes[self.basis.element_dofs] = mesh.tetrahedra.T

    @property
    def places(self) -> np.ndarray:
        """Places of the degrees of freedom, (n, 3) RAS mm."""
        return self.mesh.points[self.nodes]

    @cached_property
    def cavities(self) -> np.ndarray:
        """Triangles of the surfaces of cavities, (m, 3 or 6) nodes of the mesh."""
        return self._boundary[self._in_cavity]

    @cached_property
    def outside(self) -> np.ndarray:
        """Triangles of the surface towards the surroundings, (m, 3 or 6) nodes of the mesh."""
        return self._boundary[~self._in_cavity]

    @cached_property
    def _boundary(self) -> np.ndarray:
        faces, _, second = faces_of(self.mesh.tetrahedra)
        return faces[second < 0]

    @cached_property
    def _in_cavity(self) -> np.ndarray:
        """Whether each boundary triangle is one of a cavity: a closed part that is turned inside out."""
        triangles = self._boundary[:, :3]
        edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        n = len(self.mesh.points)
        links = sparse.coo_matrix((np.ones(len(edges), dtype=bool), tuple(edges.T)), shape=(n, n))
        part = connected_components(links, directed=False)[1][triangles[:, 0]]
        corners = self.mesh.points[triangles] - self.mesh.points[triangles.ravel()].mean(axis=0)
        cones = np.einsum("nk,nk->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        return np.bincount(part, weights=cones, minlength=part.max() + 1)[part] < 0.0

    def group(self, name: str) -> np.ndarray:
        """Triangles of a group.

        Parameters
        ----------
        name : str

        Returns
        -------
        (m, 3 or 6) ndarray of int
            Nodes of the mesh.

        Raises
        ------
        ValueError
            If the mesh has no such group of triangles.
        """
        if name not in self.mesh.triangle_groups:
            known = ", ".join(self.mesh.triangle_groups) or "none"
            msg = f"The mesh has no group of triangles {name!r}; it has: {known}."
            raise ValueError(msg)
        return self.mesh.triangles[self.mesh.triangle_groups[name]]
