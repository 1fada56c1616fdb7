"""Nearly equal triangles on an organ's surface."""

from __future__ import annotations

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip

from VICRegistrationLib.geometry.models import bell
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.triangulation import triangulate
from VICRegistrationLib.meshing.relaxing import relaxed, smallest_angle
from VICRegistrationLib.meshing.surface_mesh import surface_mesh, triangle_quality
from VICRegistrationLib.phantoms.organs import pelvic_organs

ORGANS = pelvic_organs()


def volume(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.einsum("nk,nk->", np.cross(a, b), c) / 6.0


@pytest.mark.parametrize("name", ORGANS)
def test_triangles_are_nearly_equal_and_on_the_surface(name):
    gmsh_or_skip()
    surface = ORGANS[name]
    mesh = surface_mesh(surface, 5, name=name)
    report = triangle_quality(mesh.points, mesh.triangles)
    # Measured 34 to 104 degrees; a grid of the parameters has needles at the poles.
    assert report.angle_min > 25.0
    assert report.angle_max < 120.0
    assert report.edge_mean == pytest.approx(5.0, rel=0.1)
    assert report.nodes == 2 + report.triangles // 2
    np.testing.assert_allclose(closest_points(surface, mesh.points).distances, 0.0, atol=1e-6)
    np.testing.assert_allclose(surface.points(*mesh.parameters.T), mesh.points, atol=1e-9)
    # Chords of 5 mm across the thin vagina lose 5 %.
    assert volume(mesh.points, mesh.triangles) == pytest.approx(surface.volume(), rel=0.06)


def test_smaller_triangles_are_more():
    gmsh_or_skip()
    few, many = (len(surface_mesh(ORGANS["rectum"], size).triangles) for size in (8.0, 4.0))
    assert many == pytest.approx(4 * few, rel=0.2)


def test_relaxing_keeps_the_surface_closed_and_widens_the_angles():
    surface = ORGANS["rectum"]
    mesh = triangulate(surface, resolution=(24, 30))
    points, triangles = relaxed(surface, mesh.points, mesh.triangles)
    assert smallest_angle(points, triangles) > 2.0 * smallest_angle(mesh.points, mesh.triangles)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert volume(points, triangles) == pytest.approx(surface.volume(), rel=0.02)


def test_an_open_surface_and_a_size_of_nothing_are_refused():
    gmsh_or_skip()
    with pytest.raises(ValueError, match="has a rim"):
        surface_mesh(bell(20.0), 3.0)
    with pytest.raises(ValueError, match="size of the elements of 0 mm"):
        surface_mesh(ORGANS["rectum"], 0.0)
