"""Tetrahedra in organs by gmsh: shape, volume, groups, common nodes."""

from __future__ import annotations

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip
from random_organs import random_organ

from VICRegistrationLib.export.step import Solid
from VICRegistrationLib.geometry.models import bell, closed_organ
from VICRegistrationLib.geometry.projection import closest_points
from VICRegistrationLib.geometry.validity import check_surface
from VICRegistrationLib.meshing import organ_meshes
from VICRegistrationLib.meshing.elements import faces_of, scaled_jacobians, volumes
from VICRegistrationLib.meshing.groups import second_order
from VICRegistrationLib.meshing.organ_meshes import mesh_organs
from VICRegistrationLib.meshing.process import MeshingError
from VICRegistrationLib.meshing.quality import quality
from VICRegistrationLib.meshing.regions import MeshOptions
from VICRegistrationLib.phantoms.organs import pelvic_organs

ORGANS = pelvic_organs()


@pytest.fixture(autouse=True)
def gmsh_is_there():
    gmsh_or_skip()


def ball(x, radius, name):
    return Solid(name, closed_organ((13, 11), axes=radius * np.eye(3), center=(x, 0.0, 0.0)))


def boundary(mesh):
    """Nodes of each face of the boundary, sorted."""
    faces, _, second = faces_of(mesh.tetrahedra[:, :4])
    return {tuple(sorted(face)) for face in faces[second < 0].tolist()}


@pytest.mark.parametrize(
    ("size", "order"),
    [
        (3.0, 1),
        (5.0, 2),
        pytest.param(5.0, 1, marks=pytest.mark.long),
        pytest.param(3.0, 2, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize(
    "name", [name if name == "bladder" else pytest.param(name, marks=pytest.mark.long) for name in ORGANS]
)
def test_the_demo_organs_are_meshed_well(name, size, order):
    mesh = mesh_organs([Solid(name, ORGANS[name])], MeshOptions(size=size, order=order))
    report = quality(mesh)
    assert report.inverted == 0
    assert report.scaled_jacobian_min >= 0.15
    # 0.5 % at 3 mm, and with the square of the size; curved elements keep the volume better.
    assert abs(report.volume_ratio - 1.0) <= (0.005 * (size / 3.0) ** 2 if order == 1 else 0.0005)
    assert report.volume_exact == pytest.approx(ORGANS[name].volume())
    assert mesh.notes == ()
    assert list(mesh.tetrahedron_groups) == [name]
    assert list(mesh.triangle_groups) == [f"{name}_surface"]
    assert {tuple(sorted(face)) for face in mesh.triangles[:, :3].tolist()} == boundary(mesh)
    nodes = np.unique(mesh.triangles)
    np.testing.assert_allclose(closest_points(ORGANS[name], mesh.points[nodes]).distances, 0.0, atol=1e-3)


def test_a_note_has_the_worst_element_if_it_is_poor(monkeypatch):
    monkeypatch.setattr(organ_meshes, "LEAST_QUALITY", 0.99)
    mesh = mesh_organs([ball(0.0, 15.0, "ball")], MeshOptions(size=8.0, volume_error=0.05))
    (note,) = mesh.notes
    assert note.code == "poor_element"
    assert note.values["jacobian"] == scaled_jacobians(mesh.points, mesh.tetrahedra).min()
    assert "The worst element, at R " in note.sentence()


@pytest.mark.parametrize("seed", [1, 3, 5, *(pytest.param(seed, marks=pytest.mark.long) for seed in (9, 17, 20))])
def test_organs_of_random_shape_are_meshed(seed):
    """Six of the 200 that were tried: those with the sharpest bends, and those that need several ways."""
    surface = random_organ(seed)
    assert not check_surface(surface)
    report = quality(mesh_organs([Solid("organ", surface)], MeshOptions(size=6.0, order=1 + seed % 2)))
    assert report.inverted == 0
    assert report.scaled_jacobian_min > 0.1
    assert abs(report.volume_ratio - 1.0) <= 0.02


def test_a_hollow_organ_has_an_inside_and_an_outside():
    mesh = mesh_organs([ball(0.0, 20.0, "bladder")], MeshOptions(size=5.0, wall=3.0))
    report = quality(mesh)
    assert list(mesh.tetrahedron_groups) == ["bladder_wall"]
    assert list(mesh.triangle_groups) == ["bladder_inside", "bladder_outside"]
    assert report.volume_exact == pytest.approx(4.0 / 3.0 * np.pi * (23.0**3 - 20.0**3), rel=2e-3)
    for name, radius in (("bladder_inside", 20.0), ("bladder_outside", 23.0)):
        nodes = np.unique(mesh.triangles[mesh.triangle_groups[name]])
        # The generic model is a sphere within 0.1 %, the wall 3 mm within 1 %.
        np.testing.assert_allclose(np.linalg.norm(mesh.points[nodes], axis=1), radius, atol=0.06)
    corners = mesh.points[mesh.triangles[mesh.triangle_groups["bladder_inside"]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Out of the wall is into the lumen.
    assert (np.einsum("nk,nk->n", normals, corners.mean(axis=1)) < 0.0).all()


@pytest.mark.parametrize("order", [1, 2])
def test_overlapping_organs_share_the_nodes_of_their_interface(order):
    one, two = ball(0.0, 20.0, "one"), ball(37.0, 20.0, "two")
    mesh = mesh_organs([one, two], MeshOptions(size=6.0, order=order))
    assert list(mesh.triangle_groups) == ["one_surface", "two_surface", "one_two_interface"]
    # Two caps of height 1.5 of a sphere of 20.
    lens = 2.0 * np.pi * 1.5**2 * (3.0 * 20.0 - 1.5) / 3.0
    (note,) = mesh.notes
    assert (note.code, note.values["first"], note.values["second"]) == ("overlap_resolved", "two", "one")
    assert note.values["volume_mm3"] == pytest.approx(lens, rel=0.02)
    assert mesh.exact_volumes["one"] == pytest.approx(one.surface.volume())
    assert mesh.exact_volumes["two"] == pytest.approx(two.surface.volume() - lens, rel=1e-3)
    report = quality(mesh)
    assert report.inverted == 0
    interface = mesh.triangles[mesh.triangle_groups["one_two_interface"]]
    for name in ("one", "two"):
        nodes = np.unique(mesh.tetrahedra[mesh.tetrahedron_groups[name]])
        assert np.isin(interface, nodes).all()
    # It is the part of the first organ's surface that lies inside of the second one.
    np.testing.assert_allclose(
        closest_points(one.surface, mesh.points[np.unique(interface[:, :3])]).distances, 0.0, atol=1e-3
    )
    faces = {tuple(sorted(face)) for face in mesh.triangles[:, :3].tolist()}
    assert faces == boundary(mesh) | {tuple(sorted(face)) for face in interface[:, :3].tolist()}


def test_the_order_of_the_organs_is_their_priority():
    one, two = ball(0.0, 20.0, "one"), ball(37.0, 20.0, "two")
    mesh = mesh_organs([two, one], MeshOptions(size=8.0))
    assert mesh.exact_volumes["two"] == pytest.approx(two.surface.volume())
    assert mesh.notes[0].values["second"] == "two"


def test_lumens_stay_free_of_the_walls_of_others():
    """The wall of the first reaches into the lumen of the second."""
    mesh = mesh_organs([ball(0.0, 15.0, "one"), ball(32.0, 15.0, "two")], MeshOptions(size=6.0, wall=4.0))
    assert any("the lumen of two" in note.sentence() for note in mesh.notes)
    centers = mesh.points[mesh.tetrahedra].mean(axis=1)
    for x in (0.0, 32.0):
        assert np.linalg.norm(centers - [x, 0.0, 0.0], axis=1).min() > 14.9
    assert {"one_inside", "one_outside", "two_inside", "two_outside", "one_two_interface"} == set(mesh.triangle_groups)


@pytest.mark.parametrize("apart", [(28.0, 0.0, 0.0), (18.0, 18.0, 12.0)], ids=["far", "with boxes that meet"])
def test_organs_that_do_not_touch_are_meshed_side_by_side(apart):
    one = ball(0.0, 12.0, "one")
    matrix = np.eye(4)
    matrix[:3, 3] = apart
    mesh = mesh_organs([one, Solid("two", one.surface.transformed(matrix))], MeshOptions(size=8.0, wall=1.0))
    assert list(mesh.triangle_groups) == ["one_inside", "one_outside", "two_inside", "two_outside"]
    assert mesh.notes == ()


def test_an_organ_inside_of_one_named_before_it_is_refused_and_meshed_the_other_way_round():
    outer, inner = ball(0.0, 20.0, "outer"), ball(3.0, 10.0, "inner")
    with pytest.raises(MeshingError, match="Nothing is left of inner"):
        mesh_organs([outer, inner], MeshOptions(size=8.0))
    mesh = mesh_organs([inner, outer], MeshOptions(size=8.0))
    # All of the inner one's surface is an interface.
    assert list(mesh.triangle_groups) == ["outer_surface", "inner_outer_interface"]
    assert quality(mesh).volume == pytest.approx(outer.surface.volume(), rel=0.03)


def test_curving_never_spoils_an_element():
    """A flat element at the surface of a small ball: fully curved it would be turned inside out."""
    surface = closed_organ((13, 11), axes=10.0 * np.eye(3))
    angles = np.radians([0.0, 110.0, 235.0])
    corners = np.column_stack([np.cos(angles), np.sin(angles), np.full(3, 0.15)])
    points = np.vstack([9.9 * corners / np.linalg.norm(corners, axis=1, keepdims=True), [[0.0, 0.0, 3.2]]])
    cells = np.array([[0, 1, 2, 3]])
    assert volumes(points, cells)[0] > 0.0
    nodes, curved, flattened = second_order(points, cells, np.zeros(1, dtype=int), [surface], least_quality=0.15)
    assert flattened > 0
    assert scaled_jacobians(nodes, curved)[0] >= min(0.15, scaled_jacobians(points, cells)[0]) - 1e-12


def test_what_is_no_solid_is_refused_before_meshing():
    told = []
    with pytest.raises(ValueError, match="bell: The surface"):
        mesh_organs([Solid("bell", bell(20.0))], on_progress=told.append)
    with pytest.raises(ValueError, match="give at least one"):
        mesh_organs([])
    with pytest.raises(ValueError, match="would be called one;"):
        mesh_organs([ball(0.0, 10.0, "one"), ball(50.0, 10.0, "one")])
    assert told == ["checking the surfaces"]


@pytest.mark.parametrize("options", [{"size": 0.01}, {"wall": 1e-6}], ids=["tiny elements", "tiny wall"])
def test_a_mesh_that_would_fill_the_memory_is_refused_before_it_is_begun(options):
    with pytest.raises(ValueError, match=r"would be about .* tetrahedra, more than .*; choose larger elements"):
        mesh_organs([Solid("ball", closed_organ(axes=10.0 * np.eye(3)))], MeshOptions(**options))


def test_surfaces_are_cut_into_patches_for_loads_and_contacts():
    ball = closed_organ(axes=10.0 * np.eye(3))
    mesh = mesh_organs([Solid("ball", ball)], MeshOptions(size=4.0, patches=(4, 2)))
    names = {f"ball_surface_{around}_{along}" for around in range(1, 5) for along in (1, 2)}
    assert set(mesh.triangle_groups) == names
    rows = np.concatenate(list(mesh.triangle_groups.values()))
    np.testing.assert_array_equal(np.sort(rows), np.arange(len(mesh.triangles)))
    middles = mesh.points[mesh.triangles[:, :3]].mean(axis=1)
    # The poles lie on the third axis, which runs from the lower to the upper half of v.
    lower = np.concatenate([cells for name, cells in mesh.triangle_groups.items() if name.endswith("_1")])
    upper = np.concatenate([cells for name, cells in mesh.triangle_groups.items() if name.endswith("_2")])
    assert abs(middles[lower, 2].mean() - middles[upper, 2].mean()) > 8.0
