"""Tetrahedral meshes of balls and hollow balls, made without a mesher, for the tests of simulations."""

from __future__ import annotations

import numpy as np

from VICRegistrationLib.meshing.elements import EDGES
from VICRegistrationLib.meshing.groups import faces_of
from VICRegistrationLib.meshing.tetrahedra import TetrahedralMesh


def hollow_ball(inner, outer, *, level, layers, order=1, center=(0.0, 0.0, 0.0)):
    """Concentric layers around a cavity: an octahedron's triangles, quartered `level` times, times `layers`."""
    directions, triangles = _sphere(level)
    radii = np.linspace(inner, outer, layers + 1)
    points = (radii[:, None, None] * directions).reshape(-1, 3)
    tetrahedra = _split_prisms(triangles, len(directions), layers)
    mesh = _grouped(points, tetrahedra, lambda places: np.linalg.norm(places, axis=1) < (inner + outer) / 2.0)
    return _moved(mesh if order == 1 else _curved(mesh), center)


def ball(radius, *, level, order=1, center=(0.0, 0.0, 0.0)):
    """scikit-fem's ball, refined `level` times."""
    import skfem

    grid = skfem.MeshTet1.init_ball(nrefs=level)
    mesh = _grouped(radius * grid.p.T, grid.t.T, lambda places: np.zeros(len(places), dtype=bool))
    return _moved(mesh if order == 1 else _curved(mesh, only_outside=True), center)


def _sphere(level):
    """Unit vectors and triangles, counter-clockwise seen from outside."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    triangles = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(level):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        unique, index = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
        middles = points[unique].mean(axis=1)
        new = len(points) + index.reshape(-1, 3)
        points = np.concatenate([points, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
        (a, b, c), (ab, bc, ca) = triangles.T, new.T
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return points, triangles


def _split_prisms(triangles, n, layers):
    """Three tetrahedra in each prism; the common diagonal of two neighbours starts at the lower number."""
    a, b, c = np.sort(triangles, axis=1).T
    cells = []
    for layer in range(layers):
        low, high = layer * n, (layer + 1) * n
        for corners in ((a + low, b + low, c + low, c + high), (a + low, b + low, b + high, c + high)):
            cells.append(np.stack(corners, axis=1))
        cells.append(np.stack((a + low, a + high, b + high, c + high), axis=1))
    return np.concatenate(cells)


def _grouped(points, tetrahedra, is_inside):
    """Mesh of well-turned tetrahedra with its boundary in groups as the meshers' are."""
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    turned = np.linalg.det(edges) < 0.0
    tetrahedra = np.array(tetrahedra)
    tetrahedra[turned] = tetrahedra[turned][:, [0, 2, 1, 3]]
    faces, _, second = faces_of(tetrahedra)
    faces = faces[second < 0]
    inside = is_inside(points[faces[:, 0]])
    groups = {"ball_inside": np.flatnonzero(inside), "ball_outside": np.flatnonzero(~inside)}
    groups = {name: rows for name, rows in groups.items() if len(rows)}
    return TetrahedralMesh(points, tetrahedra, {"ball_wall": np.arange(len(tetrahedra))}, faces, groups)


def _curved(mesh, *, only_outside=False):
    """Second order: middles of edges at the middle radius, so that spheres stay spheres."""
    pairs = np.sort(mesh.tetrahedra[:, EDGES], axis=2)
    unique, index = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    ends = mesh.points[unique]
    middles, radii = ends.mean(axis=1), np.linalg.norm(ends, axis=2)
    length = np.linalg.norm(middles, axis=1)
    wanted = radii.mean(axis=1)
    if only_outside:
        # The ball's inner edges stay straight; those between two points of its surface are arcs.
        faces = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        n = len(mesh.points)
        wanted = np.where(np.isin(unique @ [n, 1], faces @ [n, 1]), wanted, length)
    middles = middles * np.divide(wanted, length, out=np.ones_like(length), where=length > 0.0)[:, None]
    middle_of = len(mesh.points) + index.reshape(-1, 6)
    points = np.concatenate([mesh.points, middles])
    tetrahedra = np.concatenate([mesh.tetrahedra, middle_of], axis=1)
    faces, _, second = faces_of(tetrahedra)
    faces = faces[second < 0]
    radius = np.linalg.norm(mesh.points[faces[:, 0]], axis=1)
    middle = (radius.min() + radius.max()) / 2.0 if len(mesh.triangle_groups) > 1 else 0.0
    inside = radius < middle
    groups = {"ball_inside": np.flatnonzero(inside), "ball_outside": np.flatnonzero(~inside)}
    groups = {name: rows for name, rows in groups.items() if len(rows)}
    return TetrahedralMesh(points, tetrahedra, mesh.tetrahedron_groups, faces, groups)


def _moved(mesh, center):
    points = mesh.points + np.asarray(center)
    return TetrahedralMesh(points, mesh.tetrahedra, mesh.tetrahedron_groups, mesh.triangles, mesh.triangle_groups)
