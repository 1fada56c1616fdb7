"""Tetrahedral meshes in files, read back by other programs where they are installed."""

from __future__ import annotations

import re

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip
from small_tetrahedra import cube, read_vtu

from VICRegistrationLib.meshing.elements import EDGES, FACES, volumes
from VICRegistrationLib.meshing.formats import MESH_FORMATS, names_in_file, write_tetrahedra

LPS = np.array([-1.0, -1.0, 1.0])


@pytest.fixture(params=[1, 2], ids=["linear", "second order"])
def mesh(request):
    return cube(order=request.param)


def same_groups(found, wanted):
    assert list(found) == list(wanted)
    for name, rows in wanted.items():
        np.testing.assert_array_equal(found[name], rows)


def test_vtk_gets_everything_back(mesh, tmp_path):
    write_tetrahedra(mesh, tmp_path / "m.vtu")
    found = read_vtu(tmp_path / "m.vtu")
    np.testing.assert_array_equal(found.points, mesh.points)
    np.testing.assert_array_equal(found.tetrahedra, mesh.tetrahedra)
    np.testing.assert_array_equal(found.triangles, mesh.triangles)
    same_groups(found.tetrahedron_groups, mesh.tetrahedron_groups)
    same_groups(found.triangle_groups, mesh.triangle_groups)


@pytest.fixture
def opened():
    """Open a file with gmsh."""
    gmsh = gmsh_or_skip()
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)

    def read(path):
        gmsh.clear()
        gmsh.open(str(path))
        return gmsh

    yield read
    gmsh.finalize()


@pytest.mark.parametrize("suffix", [".msh", ".med"])
def test_gmsh_reads_its_formats_with_all_groups(mesh, suffix, tmp_path, opened):
    names = write_tetrahedra(mesh, tmp_path / f"m{suffix}")
    gmsh = opened(tmp_path / f"m{suffix}")
    # MED pads names with blanks.
    groups = {gmsh.model.getPhysicalName(*group).rstrip(): group for group in gmsh.model.getPhysicalGroups()}
    assert set(groups) == set(names.values()) == {*mesh.tetrahedron_groups, *mesh.triangle_groups}
    kind = {1: "Tetrahedron 4", 2: "Tetrahedron 10"}[mesh.order]
    for name, rows in {**mesh.tetrahedron_groups, **mesh.triangle_groups}.items():
        elements = 0
        for entity in gmsh.model.getEntitiesForPhysicalGroup(*groups[name]):
            types, tags, _ = gmsh.model.mesh.getElements(groups[name][0], entity)
            elements += sum(map(len, tags))
            if groups[name][0] == 3:
                assert gmsh.model.mesh.getElementProperties(types[0])[0] == kind
        assert elements == len(rows)


@pytest.mark.parametrize("suffix", [".msh", ".med", ".unv", ".bdf"])
def test_the_formats_of_gmsh_hold_the_same_elements(mesh, suffix, tmp_path, opened):
    write_tetrahedra(mesh, tmp_path / f"m{suffix}")
    gmsh = opened(tmp_path / f"m{suffix}")
    _, tags, _ = gmsh.model.mesh.getElements(3)
    assert sum(map(len, tags)) == len(mesh.tetrahedra)
    # Negative where the nodes are in another order than gmsh's.
    assert gmsh.model.mesh.getElementQualities(tags[0], "minSJ").min() > 0.1
    volumes_found = gmsh.model.mesh.getElementQualities(tags[0], "volume")
    assert volumes_found.sum() == pytest.approx(volumes(mesh.points, mesh.tetrahedra).sum())
    _, coordinates, _ = gmsh.model.mesh.getNodes()
    coordinates = coordinates.reshape(-1, 3)
    np.testing.assert_allclose(coordinates.min(axis=0), (mesh.points * LPS).min(axis=0), atol=1e-7)
    np.testing.assert_allclose(coordinates.max(axis=0), (mesh.points * LPS).max(axis=0), atol=1e-7)


def test_nastran_s_middles_of_edges_lie_there(tmp_path):
    gmsh_or_skip()
    write_tetrahedra(cube(order=2), tmp_path / "m.bdf")
    lines = (tmp_path / "m.bdf").read_text().splitlines()
    pairs = list(zip(lines, lines[1:]))
    points = np.array(
        [(line[40:56], line[56:72], after[8:24]) for line, after in pairs if line.startswith("GRID*")], dtype=float
    )
    # CTETRA, element, property, nodes from 1.
    rows = [[*line.split()[3:], *after.split()] for line, after in pairs if line.startswith("CTETRA")]
    corners, middles = np.split(points[np.array(rows, dtype=int) - 1], [4], axis=1)
    np.testing.assert_allclose(middles, corners[:, EDGES].mean(axis=2), atol=1e-7)


@pytest.mark.parametrize("suffix", [".bdf", ".vtk"])
def test_where_there_are_no_names_their_numbers_are_told(suffix, tmp_path):
    gmsh_or_skip()
    mesh = cube()
    numbers = write_tetrahedra(mesh, tmp_path / f"m{suffix}")
    text = (tmp_path / f"m{suffix}").read_text()
    if suffix == ".bdf":
        # CTETRA, element, property.
        found = [line.split()[2] for line in text.splitlines() if line.startswith(("CTETRA", "CTRIA"))]
    else:
        found = text.split("LOOKUP_TABLE default")[1].split()
    for name, rows in {**mesh.tetrahedron_groups, **mesh.triangle_groups}.items():
        assert found.count(numbers[name]) == len(rows)


def test_the_sets_of_a_unv_file_are_named(tmp_path):
    gmsh_or_skip()
    names = write_tetrahedra(cube(names=("Blase links", "Größe")), tmp_path / "m.unv")
    text = (tmp_path / "m.unv").read_text()
    assert names["Größe"] == "Grosse"
    assert all(name in text.split() for name in names.values())


def keyword_blocks(text):
    """Keyword lines of an .inp file with the numbers below them."""
    blocks = []
    for line in text.splitlines():
        if line.startswith("*"):
            blocks.append((line, []))
        else:
            blocks[-1][1].append(line)
    return blocks


def test_abaqus_gets_solid_elements_sets_and_surfaces(mesh, tmp_path):
    write_tetrahedra(mesh, tmp_path / "m.inp")
    blocks = keyword_blocks((tmp_path / "m.inp").read_text())
    kinds = [line for line, _ in blocks if line.startswith("*ELEMENT")]
    kind = "C3D4" if mesh.order == 1 else "C3D10"
    assert kinds == [f"*ELEMENT, TYPE={kind}, ELSET={name}" for name in mesh.tetrahedron_groups]
    sets = {line.split("ELSET=")[1]: rows for line, rows in blocks if line.startswith("*ELSET")}
    found = {line.split("NAME=")[1].split(",")[0]: rows for line, rows in blocks if line.startswith("*SURFACE")}
    assert list(found) == list(mesh.triangle_groups)
    for name, rows in found.items():
        triangles = set()
        for row in rows:
            elset, side = row.split(", ")
            numbers = [int(word) for line in sets[elset] for word in line.split(",")]
            faces = mesh.tetrahedra[np.array(numbers) - 1][:, FACES[int(side[1]) - 1][:3]]
            triangles |= {tuple(sorted(face)) for face in faces.tolist()}
        wanted = mesh.triangles[mesh.triangle_groups[name]][:, :3]
        assert triangles == {tuple(sorted(face)) for face in wanted.tolist()}
    nodes = next(rows for line, rows in blocks if line == "*NSET, NSET=left_right_interface_nodes")
    numbers = np.array([int(word) for line in nodes for word in line.split(",")])
    np.testing.assert_allclose(mesh.points[numbers - 1, 0], 3.0)


def test_abaqus_surfaces_face_outward_from_the_first_organ(tmp_path):
    mesh = cube()
    write_tetrahedra(mesh, tmp_path / "m.inp")
    text = (tmp_path / "m.inp").read_text()
    sets = re.findall(r"\*ELSET, ELSET=left_right_interface_S\d\n([\d, \n]+)", text)
    elements = np.array([int(word) for rows in sets for word in rows.replace("\n", ",").split(",") if word.strip()])
    assert np.isin(elements - 1, mesh.tetrahedron_groups["left"]).all()


def test_files_are_lps(tmp_path):
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    mesh = cube()
    write_tetrahedra(mesh, tmp_path / "m.vtu")
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(tmp_path / "m.vtu"))
    reader.Update()
    grid = reader.GetOutput()
    np.testing.assert_array_equal(grid.GetPoint(7), mesh.points[7] * LPS)
    assert grid.GetFieldData().GetAbstractArray("SPACE").GetValue(0) == "LPS"
    # The turn from RAS to LPS mirrors nothing.
    assert (volumes(mesh.points * LPS, mesh.tetrahedra) > 0.0).all()


@pytest.mark.parametrize("suffix", MESH_FORMATS)
def test_names_with_letters_of_other_alphabets_can_be_written(suffix, tmp_path):
    gmsh_or_skip()
    mesh = cube(names=("Blase links", 'Größe "2"'))
    write_tetrahedra(mesh, tmp_path / f"m{suffix}")
    assert (tmp_path / f"m{suffix}").stat().st_size > 1000


def test_names_for_abaqus_are_ascii_and_different():
    names = names_in_file(["Blase links", "blase_links", "Größe", "膀胱", "2b", "", "x" * 100], ascii_only=True)
    assert list(names.values())[:3] == ["Blase_links", "blase_links_2", "Grosse"]
    assert len({name.lower() for name in names.values()}) == 7
    for name in names.values():
        assert re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII)
        assert len(name) <= 62


def test_an_unknown_ending_is_refused_with_those_known(tmp_path):
    with pytest.raises(ValueError, match=r"m\.xyz was asked for; .*\.msh.*\.inp"):
        write_tetrahedra(cube(), tmp_path / "m.xyz")
    assert list(tmp_path.iterdir()) == []


def test_names_that_gmsh_could_not_read_are_shortened_and_stay_different(tmp_path, opened):
    long = "a" * 300
    write_tetrahedra(cube(names=(f"{long}\none", f"{long} two")), tmp_path / "m.msh")
    gmsh = opened(tmp_path / "m.msh")
    names = [gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups(3)]
    assert names[0] != names[1]
    assert all(name.startswith("a" * 60) for name in names)
