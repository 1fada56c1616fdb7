"""Models in files for CAD and for pictures: exact faces with their names, triangles that know their patch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_model import COLUMNS, ROWS, egg_with_band
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from VICRegistrationLib import cli
from VICRegistrationLib.export.surface_data import triangles_in
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.geometry.triangles import enclosed_volume
from VICRegistrationLib.multipatch.pelvis import pelvis
from VICRegistrationLib.multipatch.step import model_step_text, write_model_step
from VICRegistrationLib.multipatch.triangles import model_triangles
from VICRegistrationLib.multipatch.vtp import write_model_vtp


@pytest.fixture(scope="module")
def model():
    return egg_with_band()


@pytest.fixture(scope="module", params=[egg_with_band, pelvis], ids=["egg", "pelvis"])
def read_back(request, tmp_path_factory):
    """A model, what Open CASCADE finds in its STEP file, and the module that asks it."""
    pytest.importorskip("OCP", reason="needs cadquery-ocp-novtk, which has no wheel for this Python")
    import open_cascade

    path = tmp_path_factory.mktemp("step") / "model.step"
    write_model_step(request.param(), path)
    return request.param(), path, open_cascade


def test_organs_and_cords_are_valid_solids_with_their_volumes(read_back):
    model, path, open_cascade = read_back
    shape = open_cascade.read(path)
    assert open_cascade.is_valid(shape)
    solids = open_cascade.solids(shape)
    assert len(solids) == sum(part.kind != "sheet" for part in model.parts)
    # Faces meet in edges that they share; a gap would leave the shell open.
    assert all(open_cascade.is_closed(solid) for solid in solids)
    organs = [open_cascade.volume(solid) for solid in solids[: len(model.organs)]]
    exact = [model.parents[organ].volume() for organ in model.organs]
    np.testing.assert_allclose(organs, exact, rtol=1e-6)
    # Open CASCADE had nothing to repair.
    assert open_cascade.largest_tolerance(shape) <= 1e-6


def test_every_patch_is_one_face_with_its_name(read_back):
    model, path, open_cascade = read_back
    names = open_cascade.face_names(path)
    patches = [model.part(patch.part).labelled(patch.name) for patch in model.patches]
    feet = [f"{part.name} foot (estimated)" for part in model.parts if part.kind == "cord"]
    assert sorted(names) == sorted(patches + feet)


def test_parts_are_products_and_what_is_not_seen_is_called_estimated(read_back):
    model, path, open_cascade = read_back
    assembly, *products = sorted(open_cascade.parts(path), key=lambda part: not part.components)
    assert [product.name for product in products] == [part.labelled() for part in model.parts]
    assert all(product.name.endswith("(estimated)") != (product.name in model.organs) for product in products)
    assert assembly.components == tuple(product.name for product in products)


def test_faces_of_a_part_share_edges_and_attached_parts_share_vertices(model):
    text = model_step_text(model)
    ends = {index for patch in model.patches for index in patch.indices[[0, 0, -1, -1], [0, -1, 0, -1]]}
    assert text.count("VERTEX_POINT(") == len(ends)
    # Three columns have three borders across each of two rows' limits, and three along each of three rows.
    egg_edges = len(COLUMNS) * (len(ROWS) - 1) + len(COLUMNS) * len(ROWS)
    band_edges, cord_edges = 4, 12
    assert text.count("EDGE_CURVE(") == egg_edges + band_edges + cord_edges
    # One of the band's lies on the egg, and four of the cord's.
    assert text.count("B_SPLINE_CURVE_WITH_KNOTS(") == egg_edges + band_edges + cord_edges - 5


def test_a_cord_that_is_not_closed_is_refused_and_no_file_is_begun(model, tmp_path):
    from dataclasses import replace

    patches = tuple(patch for patch in model.patches if patch.name != "string end")
    with pytest.raises(ValueError, match="string does not bound a solid"):
        write_model_step(replace(model, patches=patches), tmp_path / "model.step")
    assert list(tmp_path.iterdir()) == []


def test_triangles_of_neighbours_meet(model):
    mesh = model_triangles(model)
    egg = mesh.triangles[mesh.of(model.patches_of("egg"))]
    edges = np.sort(egg[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    exact = model.parents["egg"].volume()
    assert enclosed_volume(mesh.points, egg) == pytest.approx(exact, rel=0.02)
    finer = model_triangles(model, chord_error=0.01)
    assert len(finer.triangles) > 2 * len(mesh.triangles)


def test_patches_that_run_along_a_border_in_opposite_ways_meet_in_the_same_vertices(model):
    def turned(patch):
        knots = tuple(part[0] + part[-1] - part[::-1] for part in patch.knots)
        return replace(patch, knots=knots, indices=patch.indices[::-1, ::-1])

    other = replace(model, patches=tuple(turned(p) if p.part == "band" else p for p in model.patches))
    meshes = [model_triangles(each) for each in (model, other)]
    assert len(meshes[0].points) == len(meshes[1].points)
    areas = []
    for mesh in meshes:
        a, b, c = np.moveaxis(mesh.points[mesh.triangles[mesh.of(model.patches_of("band"))]], 1, 0)
        areas.append(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    assert areas[1] == pytest.approx(areas[0], rel=1e-3)


def test_a_vtp_file_knows_the_patch_and_the_part_of_every_triangle(model, tmp_path):
    write_model_vtp(model, tmp_path / "model.vtp")
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / "model.vtp"))
    reader.Update()
    data, cells = reader.GetOutput(), reader.GetOutput().GetCellData()
    assert data.GetFieldData().GetAbstractArray("SPACE").GetValue(0) == "LPS"
    points, triangles = triangles_in(data)
    words = {
        key: [cells.GetAbstractArray(key).GetValue(row) for row in range(len(triangles))] for key in ("patch", "part")
    }
    assert set(words["part"]) == {"egg", "band (estimated)", "string (estimated)"}
    assert {"egg middle second", "string end (estimated)", "band (estimated)"} < set(words["patch"])
    estimated = vtk_to_numpy(cells.GetArray("estimated"))
    assert (estimated == [word.endswith("(estimated)") for word in words["part"]]).all()
    numbers = vtk_to_numpy(cells.GetArray("patch_number"))
    assert {words["patch"][row] for row in np.flatnonzero(numbers == 1)} == {model.patches[0].name}
    # In LPS, x and y are turned over.
    ras = points * [-1, -1, 1]
    on_egg = np.unique(triangles[np.array(words["part"]) == "egg"])
    assert np.abs(model.parents["egg"].closest_points(ras[on_egg]).distances).max() < 1e-4


def test_the_triangles_of_a_model_are_left_out_where_surfaces_are_wanted(model, tmp_path, capsys):
    write_model_vtp(model, tmp_path / "model.vtp")
    write_surface(model.parents["egg"], tmp_path / "egg.json", name="egg")
    files = [str(tmp_path / name) for name in ("egg.json", "model.vtp")]
    assert cli.main(["export", *files, "--step", str(tmp_path / "a.step")]) == 0
    assert "model.vtp is a model of several organs" in capsys.readouterr().err


def test_a_picture_shows_every_part(model, tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    from VICRegistrationLib.multipatch.picture import draw_model, model_shapes

    shapes = dict(zip((patch.name for patch in model.patches), model_shapes(model)))
    assert (shapes["egg low first"].opacity, shapes["egg low first"].two_sided) == (1.0, False)
    assert (shapes["band"].opacity < 1.0, shapes["band"].two_sided) == (True, True)
    assert (shapes["string end"].opacity < 1.0, shapes["string end"].two_sided) == (True, False)
    draw_model(model, tmp_path / "model.png")
    assert (tmp_path / "model.png").read_bytes()[:4] == b"\x89PNG"
