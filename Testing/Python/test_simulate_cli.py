"""``vic-registration simulate``: meshes in, displacement, strain, picture and report out."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

pytest.importorskip("skfem", reason="scikit-fem is not installed: pip install 'vicregistration[fe]'")

from fe_meshes import hollow_ball

from VICRegistrationLib import cli
from VICRegistrationLib.meshing.formats import write_tetrahedra
from VICRegistrationLib.simulation.problems import InnerPressure, Material
from VICRegistrationLib.simulation.reading import read_mesh
from VICRegistrationLib.simulation.solution import solve

CENTER = (5.0, -30.0, 60.0)


@pytest.fixture(scope="module")
def mesh():
    """Hollow and uneven, so that no axis or sign can be mistaken for another."""
    mesh = hollow_ball(20.0, 25.0, level=1, layers=1, order=2)
    return dataclasses.replace(mesh, points=mesh.points * [1.0, 0.7, 1.2] + CENTER)


@pytest.fixture(scope="module")
def paths(mesh, tmp_path_factory):
    """The mesh in both formats."""
    folder = tmp_path_factory.mktemp("mesh")
    for suffix in ("msh", "vtu"):
        write_tetrahedra(mesh, folder / f"wall.{suffix}")
    return {suffix: folder / f"wall.{suffix}" for suffix in ("msh", "vtu")}


def simulate(*words):
    return cli.main(["simulate", *map(str, words)])


@pytest.fixture(scope="module")
def folder(paths, tmp_path_factory):
    """Folder of a run with a pressure."""
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    folder = tmp_path_factory.mktemp("run") / "out"
    words = ("--case", "pressure", "--pressure", 0.5, "--young", 200, "--poisson", 0.4, "--output", folder, "--quiet")
    assert simulate(paths["msh"], *words) == 0
    return folder


def read_grid(path):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("suffix", ["msh", "vtu"])
def test_a_mesh_comes_back_as_it_was_written(suffix, order, tmp_path):
    mesh = hollow_ball(20.0, 25.0, level=1, layers=2, order=order, center=CENTER)
    write_tetrahedra(mesh, tmp_path / f"mesh.{suffix}")
    found = read_mesh(tmp_path / f"mesh.{suffix}")
    assert found.order == order
    np.testing.assert_allclose(found.points[found.tetrahedra], mesh.points[mesh.tetrahedra], atol=1e-12)
    for kind, cells in (("tetrahedron_groups", "tetrahedra"), ("triangle_groups", "triangles")):
        groups, known = getattr(found, kind), getattr(mesh, kind)
        assert set(groups) == set(known)
        for name, rows in known.items():
            places = found.points[getattr(found, cells)[groups[name]]]
            np.testing.assert_allclose(places, mesh.points[getattr(mesh, cells)[rows]], atol=1e-12)


def test_the_folder_holds_results_picture_and_report(folder):
    assert sorted(path.name for path in folder.iterdir()) == ["simulation.json", "simulation.png", "simulation.vtu"]
    assert (folder / "simulation.png").read_bytes().startswith(b"\x89PNG")


def test_the_report_tells_problem_and_result(folder, mesh):
    report = json.loads((folder / "simulation.json").read_text(encoding="utf-8"))
    known = solve(mesh, InnerPressure(0.5), Material(young=200.0, poisson=0.4))
    assert report["schema"] == "vic-registration/simulation"
    assert (report["case"], report["mesh"], report["order"]) == ("pressure", "wall.msh", 2)
    assert report["problem"] == {"pressure": 0.5, "foundation": 0.0, "surface": None}
    assert report["material"] == {"young": 200.0, "poisson": 0.4, "density": 1050.0}
    assert report["energy"] == pytest.approx(known.energy, rel=1e-8)
    assert report["largest_displacement"] == pytest.approx(np.linalg.norm(known.displacement, axis=1).max(), rel=1e-6)


def test_vectors_and_tensors_of_the_vtu_are_lps(folder, mesh):
    grid = read_grid(folder / "simulation.vtu")
    known = solve(mesh, InnerPressure(0.5), Material(young=200.0, poisson=0.4))
    turn = np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(vtk_to_numpy(grid.GetPoints().GetData()), mesh.points * turn, atol=1e-12)
    displacement = vtk_to_numpy(grid.GetPointData().GetArray("displacement"))
    np.testing.assert_allclose(displacement, known.displacement * turn, atol=1e-8)
    for name in ("strain", "stress"):
        tensors = getattr(known, name)[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]] * np.outer(turn, turn)
        found = vtk_to_numpy(grid.GetCellData().GetArray(name))[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
        np.testing.assert_allclose(found, tensors, atol=1e-6 * np.abs(tensors).max())
    stress = vtk_to_numpy(grid.GetCellData().GetArray("equivalent_stress"))
    np.testing.assert_allclose(stress, known.equivalent_stress, rtol=1e-5)
    assert grid.GetCellData().GetArray("stress").GetComponentName(4) == "YZ"


def test_self_weight_moves_an_organ_where_gravity_points(paths, tmp_path):
    words = ("--case", "self-weight", "--gravity", "-1,0,0", "--young", 20, "--foundation", 0.5, "--no-pictures")
    assert simulate(paths["vtu"], *words, "--output", tmp_path, "--quiet") == 0
    report = json.loads((tmp_path / "simulation.json").read_text(encoding="utf-8"))
    assert report["force"][0] < 0.0
    np.testing.assert_allclose(report["force"][1:], 0.0, atol=1e-9)
    displacement = vtk_to_numpy(read_grid(tmp_path / "simulation.vtu").GetPointData().GetArray("displacement"))
    # RAS -1,0,0 is LPS +1,0,0.
    assert displacement[:, 0].mean() > 0.0
    assert not (tmp_path / "simulation.png").exists()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["--case", "pressure", "--density", "1000"], "--density was given, which belongs to --case self-weight"),
        (["--case", "self-weight", "--pressure", "1"], "--pressure was given, which belongs to --case pressure"),
        (["--case", "pressure", "--poisson", "0.5"], "Poisson's ratio of 0.5"),
        (["--case", "pressure", "--young", "-3"], "Young's modulus of -3"),
        (
            ["--case", "pressure", "--surface", "roof"],
            "no group of triangles 'roof'; it has: ball_inside, ball_outside",
        ),
    ],
)
def test_what_makes_no_sense_is_one_line_and_writes_nothing(paths, words, match, tmp_path, capsys):
    assert simulate(paths["msh"], *words, "--output", tmp_path / "out", "--quiet", "--no-pictures") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert match in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("absent.msh", None, "cannot be read"),
        ("mesh.stl", "solid", "a file .msh or .vtu is needed"),
        ("empty.msh", "", "does not hold together"),
        ("old.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n", "MSH 4.1 as text is understood"),
        (
            "cut.msh",
            "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 3 1 3\n3 1 0 3\n1\n2\n$EndNodes\n",
            "does not hold",
        ),
        ("empty.vtu", "<VTKFile/>", "holds no tetrahedra"),
        ("no.vtu", "nothing of XML", "holds no tetrahedra"),
    ],
)
def test_a_file_that_is_no_mesh_is_one_line(name, content, match, tmp_path, capfd):
    if content is not None:
        (tmp_path / name).write_text(content)
    assert simulate(tmp_path / name, "--case", "pressure", "--output", tmp_path / "out", "--no-pictures") == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert match in line
    assert not (tmp_path / "out").exists()


def test_inverted_elements_are_refused(mesh, tmp_path):
    flipped = mesh.tetrahedra.copy()
    flipped[7] = flipped[7][[0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]
    write_tetrahedra(dataclasses.replace(mesh, tetrahedra=flipped), tmp_path / "bad.vtu")
    with pytest.raises(ValueError, match="1 inverted elements among"):
        read_mesh(tmp_path / "bad.vtu")


def test_missing_scikit_fem_is_told_with_the_way_out(paths, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "skfem", None)
    assert simulate(paths["msh"], "--case", "pressure", "--output", tmp_path / "out") == 2
    assert "pip install 'vicregistration[fe]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
