"""``vic-registration model show`` and ``model check``."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_model import egg_with_band

from VICRegistrationLib import cli
from VICRegistrationLib.multipatch.file import model_text, read_model, write_model


@pytest.fixture
def path(tmp_path):
    write_model(egg_with_band(), tmp_path / "egg.json")
    return tmp_path / "egg.json"


def test_the_parts_of_a_model_are_listed_and_estimated_ones_named(path, capsys):
    assert cli.main(["model", "show", str(path)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == ["egg", "organ", "9", "128", "36.3", "ml"]
    assert lines[2][:3] == ["band", "(estimated)", "sheet"]
    assert lines[2][-3:] == ["2", "mm", "thick"]
    assert lines[3][:3] == ["string", "(estimated)", "cord"]


def test_the_pelvis_is_the_model_that_ships(capsys):
    assert cli.main(["model", "show"]) == 0
    pelvis = capsys.readouterr().out
    assert "levator ani (estimated)" in pelvis
    assert cli.main(["model", "show", "pelvis-fine"]) == 0
    assert capsys.readouterr().out != pelvis


@pytest.mark.parametrize("suffix", [".png", ".step", ".stp", ".vtp", ".json"])
def test_a_model_is_written_in_the_format_of_the_file_s_name(suffix, path, tmp_path, capsys):
    if suffix == ".png":
        pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    target = tmp_path / f"out{suffix}"
    assert cli.main(["model", "show", str(path), "--output", str(target)]) == 0
    assert f"written to {target}" in capsys.readouterr().err
    assert target.stat().st_size > 1000
    if suffix == ".json":
        np.testing.assert_array_equal(read_model(target).points, egg_with_band().points)


def test_other_formats_and_the_input_itself_are_refused(path, tmp_path, capsys):
    assert cli.main(["model", "show", str(path), "--output", str(tmp_path / "egg.obj")]) == 2
    assert "ends in .png, .json, .step, .stp, .vtp" in capsys.readouterr().err
    assert cli.main(["model", "show", str(path), "--output", str(path)]) == 2
    assert "would replace" in capsys.readouterr().err


def test_nothing_is_wrong_with_a_good_model(path, capsys):
    assert cli.main(["model", "check", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: 3 parts, 15 patches, 221 points; no errors found.\n"


def test_all_that_is_wrong_is_printed_and_the_exit_code_says_so(path, capsys):
    content = json.loads(model_text(egg_with_band()))
    # The band begins with points of its own, and the cord has lost its end.
    band = next(patch for patch in content["patches"] if patch["name"] == "band")
    rows = band["indices"]
    for row in rows:
        row[0] = row[1]
    content["patches"] = [patch for patch in content["patches"] if patch["name"] != "string end"]
    path.write_text(json.dumps(content), encoding="utf-8")
    assert cli.main(["model", "check", str(path)]) == 3
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("band shares no points with any other part")
    assert lines[1].startswith("string does not bound a solid")


def test_a_file_that_is_no_model_is_one_line(path, tmp_path, capsys):
    assert cli.main(["model", "check", str(tmp_path / "none.json")]) == 2
    assert "There is no model or file" in capsys.readouterr().err
    path.write_text("{}", encoding="utf-8")
    assert cli.main(["model", "check", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_unknown_flag_is_refused_by_the_action(capsys):
    with pytest.raises(SystemExit):
        cli.main(["model", "show", "--colour"])
    assert "show has no flag --colour; see vic-registration model show --help" in capsys.readouterr().err
