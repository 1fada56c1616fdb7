"""Meshes of models: a group for every patch, common nodes where parts are attached, shells with their thickness."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip
from small_model import egg_with_band

from VICRegistrationLib import cli
from VICRegistrationLib.meshing.elements import faces_of, scaled_jacobians
from VICRegistrationLib.meshing.formats import write_tetrahedra
from VICRegistrationLib.meshing.organ_meshes import MeshOptions
from VICRegistrationLib.multipatch import mesh as mesh_module
from VICRegistrationLib.multipatch.file import write_model
from VICRegistrationLib.multipatch.mesh import LEAST_QUALITY, mesh_model, solid_volume

# Coarse, so that gmsh takes tenths of a second.
SIZE, VOLUME_ERROR = 8.0, 0.05


@pytest.fixture(scope="module")
def model():
    gmsh_or_skip()
    return egg_with_band()


@pytest.fixture(scope="module", params=[1, 2], ids=["linear", "second order"])
def mesh(model, request):
    return mesh_model(model, MeshOptions(size=SIZE, order=request.param, volume_error=VOLUME_ERROR))


def nodes_of(mesh, *names):
    return set(np.concatenate([mesh.triangles[mesh.triangle_groups[name]].ravel() for name in names]).tolist())


def test_no_element_is_inverted_or_badly_shaped(mesh):
    assert scaled_jacobians(mesh.points, mesh.tetrahedra).min() >= LEAST_QUALITY


def test_a_note_names_each_part_with_a_poor_element(model, monkeypatch):
    monkeypatch.setattr(mesh_module, "LEAST_QUALITY", 0.99)
    mesh = mesh_model(model, MeshOptions(size=SIZE, volume_error=VOLUME_ERROR))
    quality = scaled_jacobians(mesh.points, mesh.tetrahedra)
    for note, (part, rows) in zip(mesh.notes, mesh.tetrahedron_groups.items()):
        assert (note.code, note.values["part"]) == ("poor_element_of_part", part)
        assert note.values["jacobian"] == quality[rows].min()
        assert f"The worst element of {part}, at R " in note.sentence()
    assert len(mesh.notes) == 2


def test_organs_and_cords_are_groups_of_tetrahedra_with_their_volumes(mesh, model):
    assert list(mesh.tetrahedron_groups) == ["egg", "string (estimated)"]
    assert sum(map(len, mesh.tetrahedron_groups.values())) == len(mesh.tetrahedra)
    assert mesh.exact_volumes["egg"] == model.parents["egg"].volume()
    # As Open CASCADE measures the same solid.
    assert mesh.exact_volumes["string (estimated)"] == pytest.approx(13119.2689, abs=1e-3)
    assert solid_volume(model, model.part("string")) == mesh.exact_volumes["string (estimated)"]


def test_every_patch_is_a_group_of_triangles_on_it(mesh, model):
    names = [model.part(patch.part).labelled(patch.name) for patch in model.patches]
    assert list(mesh.triangle_groups) == names
    assert sum(map(len, mesh.triangle_groups.values())) == len(mesh.triangles)
    for name, patch in zip(names, model.patches):
        corners = mesh.points[np.unique(mesh.triangles[mesh.triangle_groups[name]][:, :3])]
        # As near as the curves that gmsh puts nodes on are to the surfaces.
        assert np.abs(patch.surface(model.points).closest_points(corners).distances).max() < 1e-5


def test_triangles_look_out_of_the_part_that_their_patch_belongs_to(mesh, model):
    for name, patch in zip(mesh.triangle_groups, model.patches):
        a, b, c = mesh.points[mesh.triangles[mesh.triangle_groups[name]][:, :3]].transpose(1, 0, 2)
        parameters = patch.surface(model.points).closest_points((a + b + c) / 3.0).parameters
        normals = patch.surface(model.points).normals(*parameters.T)
        assert ((np.cross(b - a, c - a) * normals).sum(axis=1) > 0.0).all(), name


def test_attached_parts_have_common_nodes(mesh):
    faces, first, second = faces_of(mesh.tetrahedra)
    owner = np.zeros(len(mesh.tetrahedra), dtype=int)
    owner[mesh.tetrahedron_groups["string (estimated)"]] = 1
    between = (second >= 0) & (owner[first] != owner[second])
    foot = mesh.triangles[mesh.triangle_groups["egg middle second"]]
    assert {tuple(sorted(face)) for face in faces[between][:, :3].tolist()} == {
        tuple(sorted(face)) for face in foot[:, :3].tolist()
    }
    # The band begins along a whole border of a patch.
    border = nodes_of(mesh, "egg middle first") & nodes_of(mesh, "egg middle second")
    assert border
    assert border <= nodes_of(mesh, "band (estimated)")


def test_sheets_have_their_thickness_and_fixed_places_their_nodes(mesh, model):
    assert mesh.shells == {"band (estimated)": 2.0}
    fixed = set(mesh.node_groups["wall"].tolist())
    assert nodes_of(mesh, "string end (estimated)") <= fixed
    ends = sorted(fixed - nodes_of(mesh, "string end (estimated)"))
    assert len(ends) >= 3 * mesh.order
    surface = model.surface("band")
    parameters = surface.closest_points(mesh.points[ends]).parameters
    np.testing.assert_allclose(parameters[:, 1], surface.domain[1][1], atol=1e-6)


def test_an_abaqus_file_has_shells_with_thickness_and_fixed_nodes(mesh, tmp_path):
    write_tetrahedra(mesh, tmp_path / "egg.inp")
    text = (tmp_path / "egg.inp").read_text()
    kind = {1: "S3", 2: "STRI65"}[mesh.order]
    assert f"*ELEMENT, TYPE={kind}, ELSET=band_estimated\n" in text
    assert "*SHELL SECTION, ELSET=band_estimated, MATERIAL=band_estimated\n2\n" in text
    assert "*NSET, NSET=fixed_wall\n" in text
    assert "*SURFACE, NAME=egg_low_first, TYPE=ELEMENT\n" in text
    block = text.split("ELSET=band_estimated\n", 1)[1].split("*", 1)[0].splitlines()
    rows = np.array([[int(number) for number in line.split(",")] for line in block])
    band = mesh.triangles[mesh.triangle_groups["band (estimated)"]]
    np.testing.assert_array_equal(rows[:, 1:], band + 1)
    assert rows[:, 0].min() > len(mesh.tetrahedra)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"wall": 2.0}, "meshed without walls"), ({"patches": (2, 2)}, "has patches of its own")],
    ids=["wall", "patches"],
)
def test_walls_and_other_patches_are_refused(options, message, model):
    with pytest.raises(ValueError, match=message):
        mesh_model(model, MeshOptions(**options))


def test_a_model_that_does_not_hold_together_is_refused(model):
    patches = tuple(patch for patch in model.patches if patch.name != "string end")
    with pytest.raises(ValueError, match="cannot be meshed: string does not bound a solid"):
        mesh_model(replace(model, patches=patches))


def test_the_command_meshes_a_model(model, tmp_path, capsys):
    write_model(model, tmp_path / "model.json")
    words = ["--size", str(SIZE), "--volume-error", str(VOLUME_ERROR), "--quiet"]
    target = tmp_path / "egg.vtu"
    assert cli.main(["mesh", str(tmp_path / "model.json"), "--output", str(target), *words]) == 0
    assert "string (estimated): " in capsys.readouterr().out
    report = json.loads((tmp_path / "egg.vtu.quality.json").read_text())
    assert report["inverted"] == 0
    assert report["shells"] == {"band (estimated)": 2.0}
    assert report["fixed_nodes"]["wall"] > 3
    assert set(report["groups"]) == {"egg", "string (estimated)"}
    assert cli.main(["mesh", str(tmp_path / "model.json"), "--surface", "--output", str(tmp_path / "a.stl")]) == 2
    assert "--surface was given with a model" in capsys.readouterr().err


def test_a_model_is_no_surface_for_other_commands(model, tmp_path, capsys):
    write_model(model, tmp_path / "model.json")
    assert cli.main(["export", str(tmp_path / "model.json"), "--step", str(tmp_path / "a.step")]) == 2
    words = capsys.readouterr().err
    assert "is a model of several organs and not the surface of one; it is skipped" in words
    assert "Models of several organs (model.json) are for the commands model and mesh" in words
