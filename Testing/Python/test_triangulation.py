"""Triangles of a surface: watertight where it is closed, outward, and as close to it as asked for."""

from __future__ import annotations

import numpy as np
import pytest

from VICRegistrationLib.geometry import models
from VICRegistrationLib.geometry.parametrization import closed_organ
from VICRegistrationLib.geometry.triangles import enclosed_volume
from VICRegistrationLib.geometry.triangulation import resolution_for_chord_error, triangulate, triangulate_volume


@pytest.fixture(params=["smooth", "paper"])
def organ(request):
    surface = models.closed_organ(closure=request.param, axes=np.diag([25.0, 18.0, 32.0]), center=(5.0, 60.0, -9.0))
    parametrization = closed_organ(surface, closure=request.param)
    return parametrization.deform(np.random.default_rng(1).normal(scale=1.0, size=parametrization.n_dof))


def edges(mesh):
    """All directed edges of the triangles, (3 m, 2)."""
    return np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])


def triangle_normals(mesh):
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("resolution", [(3, 2), (8, 6), (9, 7), (40, 31)])
def test_every_edge_of_a_closed_surface_is_run_once_in_each_sense(organ, resolution):
    mesh = triangulate(organ, resolution=resolution)
    directed = edges(mesh)
    assert len(np.unique(directed, axis=0)) == len(directed)
    np.testing.assert_array_equal(np.unique(directed, axis=0), np.unique(directed[:, ::-1], axis=0))


def test_a_closed_organ_has_the_topology_of_a_sphere(organ):
    mesh = triangulate(organ, resolution=(24, 16))
    n_edges = len(edges(mesh)) // 2
    assert len(mesh.points) - n_edges + len(mesh.triangles) == 2
    # Two poles, and 15 rings of 24 points.
    assert len(mesh.points) == 2 + 15 * 24
    assert len(mesh.triangles) == 2 * 24 + 14 * 24 * 2


def test_triangles_and_normals_point_outward(organ):
    mesh = triangulate(organ, resolution=(48, 32))
    facets = triangle_normals(mesh)
    assert np.einsum("nk,nk->", mesh.points[mesh.triangles[:, 0]] - organ.control_net[0, 0], facets) > 0.0
    for k in range(3):
        assert np.einsum("nk,nk->n", facets, mesh.normals[mesh.triangles[:, k]]).min() > 0.0


def test_vertices_lie_on_the_surface_with_its_normals(organ):
    mesh = triangulate(organ, resolution=(20, 14))
    u, v = mesh.parameters.T
    np.testing.assert_allclose(mesh.points, organ.points(u, v), atol=1e-12)
    np.testing.assert_allclose(mesh.normals, organ.normals(u, v), atol=1e-12)


def test_no_two_vertices_coincide_and_none_is_unused(organ):
    mesh = triangulate(organ, resolution=(20, 14))
    assert len(np.unique(np.round(mesh.points, 9), axis=0)) == len(mesh.points)
    np.testing.assert_array_equal(np.unique(mesh.triangles), np.arange(len(mesh.points)))


@pytest.mark.parametrize("chord_error", [1.0, 0.2, 0.05])
def test_no_edge_leaves_the_surface_by_more_than_the_chord_error(organ, chord_error):
    n_u, n_v = resolution_for_chord_error(organ, chord_error)
    mesh = triangulate(organ, chord_error=chord_error)
    assert len(mesh.triangles) == 2 * n_u * (n_v - 1)
    u, v = np.linspace(0.0, 1.0, n_u + 1), np.linspace(0.0, 1.0, n_v + 1)
    corners = organ.grid(u, v)
    middles = organ.grid((u[:-1] + u[1:]) / 2.0, (v[:-1] + v[1:]) / 2.0)
    centers = (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:]) / 4.0
    assert np.linalg.norm(middles - centers, axis=2).max() <= chord_error
    # Not wasteful either: the worst place uses a good part of what is allowed.
    assert np.linalg.norm(middles - centers, axis=2).max() > chord_error / 10.0


@pytest.mark.parametrize("chord_error", [0.2, 0.02])
def test_triangles_enclose_the_volume_of_the_surface(organ, chord_error):
    mesh = triangulate_volume(organ, chord_error=chord_error)
    # Moved by one first-order step: what is left falls with the square of the chord error.
    assert enclosed_volume(mesh.points, mesh.triangles) == pytest.approx(organ.volume(), rel=5e-4 * chord_error**2)
    assert np.abs(organ.closest_points(mesh.points).distances).max() < chord_error


def test_the_bell_stays_open_at_its_rim():
    mesh = triangulate(models.bell(50.0), resolution=(24, 10))
    directed = edges(mesh)
    backward = {tuple(edge) for edge in directed[:, ::-1].tolist()}
    border = [edge for edge in directed.tolist() if tuple(edge) not in backward]
    assert len(border) == 24
    vertices = np.unique(border)
    np.testing.assert_array_equal(mesh.parameters[vertices, 1], 0.0)


@pytest.mark.parametrize("chord_error", [0.0, -1.0, np.nan])
def test_a_chord_error_that_is_no_length_is_refused(organ, chord_error):
    with pytest.raises(ValueError, match="was asked for; give a positive length such as 0.05"):
        triangulate(organ, chord_error=chord_error)
