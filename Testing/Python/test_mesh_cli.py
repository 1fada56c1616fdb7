"""``vic-registration mesh`` and its files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from needs_gmsh import gmsh_or_skip
from small_tetrahedra import read_vtu

from VICRegistrationLib import cli
from VICRegistrationLib.export.mesh_reading import read_vtp_record
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.surface_file import write_surface
from VICRegistrationLib.meshing.elements import volumes
from VICRegistrationLib.meshing.formats import MESH_FORMATS

BALL = closed_organ(axes=15.0 * np.eye(3), center=(3.0, 40.0, -20.0))


@pytest.fixture
def organ(tmp_path):
    write_surface(BALL, tmp_path / "bladder.json", name="bladder")
    return tmp_path / "bladder.json"


def mesh(*words):
    gmsh_or_skip()
    return cli.main(["mesh", *map(str, words)])


def test_the_mesh_and_its_quality_are_written_and_printed(organ, tmp_path, capsys):
    target = tmp_path / "out" / "bladder.vtu"
    assert mesh(organ, "--size", 6, "--order", 2, "--wall", 3, "--output", target) == 0
    captured = capsys.readouterr()
    assert "second-order tetrahedra" in captured.out
    assert "0 inverted" in captured.out
    assert "bladder_inside" in captured.out
    assert "meshing" in captured.err.splitlines()
    assert sorted(path.name for path in target.parent.iterdir()) == ["bladder.vtu", "bladder.vtu.quality.json"]
    report = json.loads((tmp_path / "out" / "bladder.vtu.quality.json").read_text())
    assert (report["schema"], report["version"]) == ("vic-registration/mesh-quality", 1)
    assert (report["size"], report["order"], report["wall"]) == (6.0, 2, 3.0)
    assert report["inverted"] == 0
    assert report["groups"]["bladder_wall"]["volume_ratio"] == pytest.approx(1.0, abs=1e-3)
    found = read_vtu(target)
    assert len(found.tetrahedra) == report["tetrahedra"]
    assert volumes(found.points, found.tetrahedra).sum() == pytest.approx(report["volume"])
    # The mesh lies where the organ lies: in memory RAS again.
    np.testing.assert_allclose(found.points.mean(axis=0), [3.0, 40.0, -20.0], atol=1.0)


@pytest.mark.parametrize("suffix", [".msh", ".inp", ".bdf", ".med", ".unv", ".vtk"])
def test_the_ending_chooses_the_format(organ, tmp_path, suffix, capsys):
    assert mesh(organ, "--size", 8, "--output", tmp_path / f"m{suffix}", "--quiet") == 0
    assert (tmp_path / f"m{suffix}").stat().st_size > 10_000
    assert capsys.readouterr().err == ""


def test_several_organs_are_one_mesh(organ, tmp_path, capsys):
    write_surface(BALL.transformed(np.eye(4) + np.eye(4, k=3) * 28.0), tmp_path / "rectum.json", name="rectum")
    assert mesh(organ, tmp_path / "rectum.json", "--size", 8, "--output", tmp_path / "both.vtu") == 0
    assert "note: rectum and bladder overlap by" in capsys.readouterr().out
    assert "bladder_rectum_interface" in read_vtu(tmp_path / "both.vtu").triangle_groups


def test_triangles_are_written_on_demand(organ, tmp_path, capsys):
    assert mesh(organ, "--surface", "--size", 4, "--output", tmp_path / "fine.vtp") == 0
    assert "angles: " in capsys.readouterr().out
    np.testing.assert_array_equal(read_vtp_record(tmp_path / "fine.vtp").surface.control_net, BALL.control_net)
    report = json.loads((tmp_path / "fine.vtp.quality.json").read_text())
    assert report["angle_min"] > 20.0
    for suffix in (".stl", ".ply"):
        assert mesh(organ, "--surface", "--size", 6, "--output", tmp_path / f"fine{suffix}") == 0
        assert (tmp_path / f"fine{suffix}").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--output", "m.xyz"), "m.xyz was asked for; give a file name that ends in .msh"),
        (("--output", "m.msh", "--surface"), "triangles need a name that ends in .stl"),
        (("--output", "m.stl", "--surface", "--wall", "2"), "--wall was given, which is for tetrahedra"),
        (("--output", "m.stl", "--surface", "--volume-error", "0.1"), "--volume-error was given"),
        (("--output", "m.msh", "--size", "-3"), "size of the elements of -3 mm"),
        (("--output", "m.msh", "--wall", "0"), "thickness of the wall of 0 mm"),
        (("--output", "m.msh", "--time-limit", "nan"), "time limit of nan s"),
        (("--output", ""), "name of the folder is empty"),
    ],
)
def test_wrong_words_are_refused_before_anything_is_done(words, told, organ, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["mesh", "bladder.json", *words]) == 2
    captured = capsys.readouterr()
    assert told in captured.err
    assert len(captured.err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bladder.json"]


def test_words_that_are_no_numbers_are_usage_errors(organ, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["mesh", str(organ), "--size", "thin", "--output", "m.msh"])
    assert end.value.code == 2
    assert "'thin' was given; a number is needed" in capsys.readouterr().err


def test_a_mesh_never_replaces_the_surface_it_is_made_of(tmp_path, capsys, monkeypatch):
    write_surface(BALL, tmp_path / "m.msh.quality.json", name="bladder")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["mesh", "m.msh.quality.json", "--output", "m.msh"]) == 2
    assert "would replace" in capsys.readouterr().err


def test_help_shows_formats_and_groups(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["mesh", "--help"])
    assert end.value.code == 0
    shown = capsys.readouterr().out
    for word in (*MESH_FORMATS, "NAME_inside", "--wall", "--order", "--time-limit"):
        assert word in shown


def test_patches_and_the_names_in_an_abaqus_file_are_told(organ, tmp_path):
    target = tmp_path / "b.inp"
    assert mesh(organ, "--size", 8, "--patches", "2x3", "--output", target, "--quiet") == 0
    report = json.loads((tmp_path / "b.inp.quality.json").read_text())
    assert {"bladder_surface_1_1", "bladder_surface_2_3"} <= set(report["surfaces"])
    assert report["names_in_file"]["bladder_surface_1_1"] == "bladder_surface_1_1"
    assert "bladder_surface_2_3" in target.read_text(encoding="ascii")


@pytest.mark.parametrize(("words", "told"), [("4", "such as 4x3"), ("0x2", "whole numbers from 1 to")])
def test_patches_that_make_no_sense_are_refused(organ, tmp_path, capsys, words, told):
    gmsh_or_skip()
    try:
        code = cli.main(["mesh", str(organ), "--patches", words, "--output", str(tmp_path / "b.msh")])
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "b.msh").exists()
