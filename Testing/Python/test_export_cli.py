"""``vic-registration export`` and ``fit --step``."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from small_phantom import SEED
from step_organs import organ
from vtkmodules.vtkIOGeometry import vtkSTLReader

from VICRegistrationLib import cli
from VICRegistrationLib.cli.solids import read_solids
from VICRegistrationLib.export.mesh_files import write_mesh
from VICRegistrationLib.export.mesh_reading import read_vtp_record
from VICRegistrationLib.export.step import step_text
from VICRegistrationLib.geometry.models import bell
from VICRegistrationLib.geometry.surface_file import read_surface, write_surface
from VICRegistrationLib.registration import organ_fit

pytestmark = pytest.mark.usefixtures("one_net")


def export(*words):
    return cli.main(["export", *map(str, words)])


@pytest.fixture
def bladder(tmp_path):
    write_surface(organ(), tmp_path / "bladder.json", name="bladder")
    return tmp_path / "bladder.json"


@pytest.fixture
def rectum(tmp_path):
    write_mesh(organ(closure="paper"), tmp_path / "rectum.vtp", name="rectum", chord_error=0.5)
    return tmp_path / "rectum.vtp"


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def names(folder):
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def products(path):
    return re.findall(r"=PRODUCT\('([^']*)'", path.read_text())


def test_one_surface_is_written_in_every_format(bladder, out, capsys):
    words = [word for kind in ("step", "stl", "ply", "vtp") for word in (f"--{kind}", out / f"b.{kind}")]
    assert export(bladder, *words) == 0
    assert names(out) == ["b.ply", "b.step", "b.stl", "b.vtp"]
    assert (out / "b.step").read_text() == step_text(read_solids([bladder]))
    np.testing.assert_array_equal(read_vtp_record(out / "b.vtp").surface.control_net, organ().control_net)
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert str(out / "b.ply") in printed.err


def test_several_surfaces_are_one_assembly(bladder, rectum, out):
    assert export(bladder, rectum, "--step", out / "pelvis.step", "--split", 4) == 0
    assert products(out / "pelvis.step") == ["bladder", "rectum", "organs"]
    assert (out / "pelvis.step").read_text().count("=ADVANCED_FACE(") == 8


def test_a_folder_gets_a_file_for_each_organ(bladder, rectum, out):
    assert export(bladder, rectum, "--step", f"{out}/", "--stl", f"{out}/") == 0
    assert names(out) == ["bladder.step", "bladder.stl", "rectum.step", "rectum.stl"]
    assert products(out / "rectum.step") == ["rectum"]
    assert export(bladder, "--ply", out) == 0
    assert "bladder.ply" in names(out)


def test_a_pattern_gets_a_file_for_each_organ(bladder, rectum, out):
    assert export(bladder, rectum, "--vtp", out / "p1_{name}.vtp", "--stl", out / "{name}" / "fine.stl") == 0
    assert names(out) == ["bladder", "p1_bladder.vtp", "p1_rectum.vtp", "rectum"]
    assert names(out / "rectum") == ["fine.stl"]


def test_organs_have_the_colours_of_pictures(bladder, rectum):
    solids = read_solids([bladder, rectum])
    assert solids[0].color == pytest.approx((0xF5 / 255, 0xB8 / 255, 0x2E / 255))
    assert solids[1].color != solids[0].color


def test_the_report_of_a_fit_is_left_out_with_a_word(bladder, out, tmp_path, capsys):
    (tmp_path / "report.json").write_text('{"schema": "vic-registration/report"}')
    assert export(bladder, tmp_path / "report.json", "--step", out / "a.step") == 0
    assert products(out / "a.step") == ["bladder"]
    assert "report.json is the report of a fit and has no surface; it is skipped" in capsys.readouterr().err
    assert export(tmp_path / "report.json", "--step", out / "b.step") == 2
    assert "report.json has no surface; give the organ's file" in capsys.readouterr().err.splitlines()[-1]
    assert names(out) == ["a.step"]


def test_a_surface_without_a_name_has_that_of_its_file(tmp_path, out):
    write_surface(organ(), tmp_path / "uterus.json")
    assert export(tmp_path / "uterus.json", "--step", out / "a.step") == 0
    assert products(out / "a.step") == ["uterus"]


def test_the_chord_error_sets_the_number_of_triangles(bladder, out):
    counts = []
    for error in (0.5, 0.05):
        assert export(bladder, "--stl", out / "a.stl", "--chord-error", error) == 0
        reader = vtkSTLReader()
        reader.SetFileName(str(out / "a.stl"))
        reader.Update()
        counts.append(reader.GetOutput().GetNumberOfCells())
    # Chords deviate by the square of their length, so that a tenth takes ten times as many triangles.
    assert counts[1] / counts[0] == pytest.approx(10.0, rel=0.3)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "No format was chosen; give at least one of --step FILE"),
        (["--stl", "OUT/a.stl"], "2 surfaces cannot share the file .*; give a folder such as --stl parts/, or a name"),
        (["--step", "OUT/a.stl"], r"--step .*a\.stl was given; the file's name must end in \.step or \.stp"),
        (["--ply", "OUT/a"], r"the file's name must end in \.ply"),
        (["--step", "OUT/a.step", "--stl", "OUT/{name}/x", "--split", "2"], r"must end in \.stl"),
        (["--step", "IN/{name}.step", "--vtp", "IN/"], r"rectum\.vtp would replace .*rectum\.vtp, which is read"),
    ],
)
def test_what_cannot_be_written_is_refused(bladder, rectum, out, capsys, words, complaint):
    here = names(bladder.parent)
    words = [word.replace("OUT", str(out)).replace("IN", str(bladder.parent)) for word in words]
    assert export(bladder, rectum, *words) == 2
    message = capsys.readouterr().err
    assert re.search(complaint, message)
    assert message.count("\n") == 1
    assert names(bladder.parent) == here


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--split", "0"], "'0' was given; a solid is split into 1 to 1000 faces"),
        (["--split", "2.5"], "'2.5' was given; a solid is split"),
        (["--chord-error", "0"], "'0' was given; a positive length in mm is needed"),
        (["--chord-error", "fine"], "'fine' was given; a positive length in mm is needed"),
    ],
)
def test_a_number_out_of_range_is_refused(bladder, out, capsys, words, complaint):
    with pytest.raises(SystemExit) as ended:
        export(bladder, "--step", out / "a.step", *words)
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err
    assert names(out) == []


def test_an_invalid_surface_leaves_no_file_at_all(bladder, tmp_path, out, capsys):
    write_surface(bell(30.0), tmp_path / "open.json", name="open")
    assert export(bladder, tmp_path / "open.json", "--stl", f"{out}/", "--step", out / "a.step") == 2
    message = capsys.readouterr().err
    assert re.search(r"error: open: The surface has a rim at R .* mm \(u .*\). A solid needs", message)
    assert not out.exists()
    # Triangles may be open, but not inside out.
    write_surface(read_surface(bladder).turned(), tmp_path / "turned.json", name="turned")
    assert export(bladder, tmp_path / "turned.json", "--stl", f"{out}/") == 2
    assert "turned: The surface is inside out" in capsys.readouterr().err
    assert not out.exists()
    assert export(tmp_path / "open.json", "--stl", out / "open.stl") == 0


def test_two_surfaces_of_one_name_are_refused(bladder, tmp_path, out, capsys):
    write_surface(organ(), tmp_path / "other.json", name="Bladder")
    assert export(bladder, tmp_path / "other.json", "--step", out / "a.step") == 2
    assert "both have a surface named 'Bladder'; give surfaces of different organs" in capsys.readouterr().err


def test_a_name_that_files_cannot_have_is_refused_where_it_would_be_one(tmp_path, out, capsys):
    write_surface(organ(), tmp_path / "a.json", name="a/b")
    assert export(tmp_path / "a.json", "--stl", f"{out}/") == 2
    assert "The name of a surface cannot be that of a file: the name 'a/b' holds '/'" in capsys.readouterr().err
    assert export(tmp_path / "a.json", "--stl", out / "fine.stl") == 0


def test_files_that_hold_no_surface_are_refused(tmp_path, out, capsys):
    (tmp_path / "a.json").write_text("{}")
    assert export(tmp_path / "a.json", "--stl", out / "a.stl") == 2
    assert "give a surface file" in capsys.readouterr().err
    assert export(tmp_path / "none.vtp", "--stl", out / "a.stl") == 2
    assert "cannot be read" in capsys.readouterr().err


def test_a_folder_in_the_way_leaves_everything_as_it_was(bladder, out, capsys):
    (out / "bladder.stl").mkdir(parents=True)
    assert export(bladder, "--step", out / "more" / "b.step", "--stl", out / "{name}.stl") == 2
    assert "bladder.stl is a folder; give the file another name" in capsys.readouterr().err
    assert names(out) == ["bladder.stl"]


# ------------------------------------------------------------------ fit --step


def fit(image_path, out, *words):
    config = out.parent / "organs.json"
    seed = [float(number) for number in SEED.split(",")]
    organs = [{"organ": name, "seed": seed} for name in ("bladder", "copy")]
    config.write_text(json.dumps({"schema": "vic-registration/organs", "version": 1, "organs": organs}))
    fixed = ("--config", str(config), "--output", str(out), "--no-pictures")
    return cli.main(["fit", str(image_path), *fixed, *words])


def test_a_fit_writes_solids_and_their_assembly(image_path, out):
    assert fit(image_path, out, "--step", "--quiet") == 0
    assert {"bladder.step", "copy.step", "organs.step"} <= set(names(out))
    (solid,) = read_solids([out / "bladder.json"])
    assert (out / "bladder.step").read_text() == step_text([solid])
    assert products(out / "organs.step") == ["bladder", "copy", "organs"]
    report = json.loads((out / "report.json").read_text())
    assert "bladder.step" in report["organs"]["bladder"]["files"]
    # Without the flag, those of an earlier fit would be of other surfaces.
    assert fit(image_path, out, "--quiet") == 0
    assert [name for name in names(out) if name.endswith(".step")] == []


def test_a_fit_that_is_no_solid_gets_no_step_file_and_a_warning(image_path, out, monkeypatch, capsys):
    check = organ_fit.check_surface
    problems = iter([check(bell())])
    monkeypatch.setattr(organ_fit, "check_surface", lambda surface: next(problems, ()))
    assert fit(image_path, out, "--step") == 0
    assert [name for name in names(out) if name.endswith(".step")] == ["copy.step"]
    assert "bladder: warning: bladder.step was not written" in capsys.readouterr().err
    report = json.loads((out / "report.json").read_text())
    assert "bladder.step" not in report["organs"]["bladder"]["files"]
    assert "copy.step" in report["organs"]["copy"]["files"]
