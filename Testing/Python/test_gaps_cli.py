"""``vic-registration gaps``."""

from __future__ import annotations

import json

import numpy as np
import pytest

from VICRegistrationLib import cli
from VICRegistrationLib.geometry.models import closed_organ
from VICRegistrationLib.geometry.surface_file import write_surface


@pytest.fixture
def balls(tmp_path):
    """Balls of 10 mm whose centres are 25 mm apart, and one that holds the first: paths by name."""
    paths = {}
    for name, radius, place in (("a", 10.0, 0.0), ("b", 10.0, 25.0), ("around_a", 15.0, 0.0)):
        paths[name] = tmp_path / f"{name}.json"
        surface = closed_organ((17, 13), axes=radius * np.eye(3), center=np.array([place, 0.0, 0.0]))
        write_surface(surface, paths[name], name=name)
    return paths


def test_a_pair_gets_a_line_with_distance_and_place(balls, capsys):
    assert cli.main(["gaps", str(balls["a"]), str(balls["b"])]) == 0
    words = capsys.readouterr().out.split()
    assert words[:4] == ["a", "and", "b", "are"]
    # The generic sphere itself is right to a few micrometres.
    assert float(words[4]) == pytest.approx(5.0, abs=0.01)


def test_the_numbers_are_written(balls, tmp_path, capsys):
    path = tmp_path / "gaps.json"
    assert cli.main(["gaps", *map(str, balls.values()), "--output", str(path)]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3
    content = json.loads(path.read_text(encoding="utf-8"))
    assert (content["schema"], content["frame"]) == ("vic-registration/gaps", "RAS")
    apart, inside, touching = content["gaps"]
    assert apart["distance"] == pytest.approx(5.0, abs=0.01)
    np.testing.assert_allclose(np.mean(apart["nearest"]["points"], axis=0), [12.5, 0.0, 0.0], atol=0.05)
    assert inside["relation"] == "first inside second"
    assert inside["common_volume"] == pytest.approx(4.0 / 3.0 * np.pi * 10.0**3, rel=1e-3)
    assert touching["distance"] == pytest.approx(0.0, abs=0.01)


def test_one_surface_has_no_gap(balls, capsys):
    assert cli.main(["gaps", str(balls["a"])]) == 2
    assert capsys.readouterr().err.startswith("vic-registration: error: One surface was given, a; gaps are between")


def test_a_surface_is_not_replaced_by_the_numbers(balls, capsys):
    before = balls["a"].read_bytes()
    assert cli.main(["gaps", *map(str, balls.values()), "--output", str(balls["a"])]) == 2
    assert "would replace" in capsys.readouterr().err
    assert balls["a"].read_bytes() == before


def test_a_folder_is_no_surface(balls, tmp_path, capsys):
    assert cli.main(["gaps", str(tmp_path)]) == 2
    assert f"{tmp_path} is a folder; give the organs' files in it" in capsys.readouterr().err
