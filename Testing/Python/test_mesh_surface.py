"""Triangles of one size on an organ's surface."""

from __future__ import annotations

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip

from VICRegistrationLib.export.step import Solid
from VICRegistrationLib.geometry.models import bell
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.triangles import enclosed_volume
from VICRegistrationLib.meshing.organ_meshes import mesh_surface
from VICRegistrationLib.meshing.quality import triangle_quality
from VICRegistrationLib.meshing.regions import MeshOptions
from VICRegistrationLib.phantoms.organs import pelvic_organs

ORGANS = pelvic_organs()


@pytest.fixture(autouse=True)
def gmsh_is_there():
    gmsh_or_skip()


@pytest.mark.parametrize("name", ORGANS)
def test_triangles_are_of_one_size_and_on_the_surface(name):
    surface = ORGANS[name]
    mesh = mesh_surface(Solid(name, surface), MeshOptions(size=5.0))
    report = triangle_quality(mesh.points, mesh.triangles)
    # Measured 31 to 119 degrees; a grid of the parameters has needles at the poles.
    assert report.angle_min > 20.0
    assert report.angle_max < 130.0
    assert report.edge_mean == pytest.approx(5.0, rel=0.1)
    # Closed: Euler's formula.
    assert report.nodes == 2 + report.triangles // 2
    np.testing.assert_allclose(closest_points(surface, mesh.points).distances, 0.0, atol=1e-6)
    np.testing.assert_allclose(surface.points(*mesh.parameters.T), mesh.points, atol=1e-9)
    # Chords of 5 mm across the thin vagina lose 5 %.
    assert enclosed_volume(mesh.points, mesh.triangles) == pytest.approx(surface.volume(), rel=0.06)


def test_smaller_triangles_are_more():
    solid = Solid("rectum", ORGANS["rectum"])
    few, many = (len(mesh_surface(solid, MeshOptions(size=size)).triangles) for size in (8.0, 4.0))
    assert many == pytest.approx(4 * few, rel=0.2)


def test_an_open_surface_is_refused():
    with pytest.raises(ValueError, match=r"bell: .*has a rim"):
        mesh_surface(Solid("bell", bell(20.0)))
