"""The paper's validation comes out as tables and plots that hold what was found."""

from __future__ import annotations

import contextlib
import csv
import io
import sys

import numpy as np
import pytest

from VICRegistrationLib.geometry import models
from VICRegistrationLib.validation import report
from VICRegistrationLib.validation.plots import parameters
from VICRegistrationLib.validation.prototypical import BELL_MM, TESTS

PNG = b"\x89PNG\r\n\x1a\n"
# Voxels of 3 mm: coarse, but it takes a second.
SIZE = 32
FIGURES = (
    "figures_5_6_one_dimension.png",
    "figures_9_11_13_bell.png",
    "figure_10_scaling.png",
    "figure_12_translation.png",
    "figure_14_scaling_and_rotation.png",
)


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def printed():
    return []


@pytest.fixture(scope="module")
def folder(tmp_path_factory, lines, printed):
    pytest.importorskip("matplotlib", reason="plots need matplotlib")
    folder = tmp_path_factory.mktemp("reproduce")
    with contextlib.redirect_stdout(io.StringIO()) as stdout:
        report.reproduce(folder, sizes=(SIZE,), say=lines.append)
    printed.append(stdout.getvalue())
    return folder


@pytest.fixture(scope="module")
def rows(folder):
    return list(csv.DictReader((folder / "table.csv").read_text(encoding="utf-8").splitlines()))


def test_every_free_parameter_of_every_test_has_a_row(rows):
    assert [(row["test"], row["parameter"]) for row in rows] == [(t.name, name) for t in TESTS for name in t.free]


def test_rows_hold_what_was_found_beside_theory_and_the_paper(rows):
    for row in rows:
        found, theory = float(row[f"found_{SIZE}"]), float(row["theory"])
        # Numbers are printed with six digits.
        assert float(row[f"error_{SIZE}"]) == pytest.approx(abs(found - theory), abs=2e-6)
        # Less than half a voxel of 3 mm, and of R about that share of the bell's half width.
        assert abs(found - theory) < (1.5 if row["unit"] == "mm" else 0.06)
    assert (rows[5]["imposed"], rows[5]["theory"], rows[5]["error_paper"]) == ("10.000000", "-10.000000", "1.21")


def test_rows_say_how_long_it_took(rows):
    assert all(int(row[f"iterations_{SIZE}"]) > 4 and float(row[f"seconds_{SIZE}"]) > 0.0 for row in rows)


def test_the_table_for_people_states_what_was_chosen(folder):
    text = (folder / "table.md").read_text(encoding="utf-8")
    for choice in ("50 mm, in the middle", "straight down", "0.5 mm (standard deviation)", "Grey levels of figure 5"):
        assert choice in text
    assert "1.21" in text
    assert text.endswith("\n")


@pytest.mark.parametrize("name", FIGURES)
def test_there_is_a_picture_for_each_figure_of_the_paper(folder, name):
    assert (folder / name).read_bytes().startswith(PNG)


def test_nothing_else_is_left_in_the_folder(folder):
    assert sorted(path.name for path in folder.iterdir()) == sorted([*FIGURES, "table.csv", "table.md"])


def test_progress_names_every_test(folder, lines):
    assert all(any(line.startswith(test.name) for line in lines) for test in TESTS)


def test_the_table_is_printed(folder, printed):
    assert printed[0].strip()
    assert (folder / "table.md").read_text(encoding="utf-8").startswith(printed[0].rstrip("\n"))


@pytest.mark.parametrize("test", TESTS, ids=lambda test: test.name)
def test_parameters_follow_from_the_surfaces_of_the_iterations(test):
    class Reached:
        surface = models.bell(BELL_MM)

    start, end = parameters(test, [Reached()])
    neutral = [1.0 if name in ("R00", "R11", "R22") else 0.0 for name in test.free]
    np.testing.assert_array_equal(start, neutral)
    # The surface of the image has the parameters of theory; 64-bit least squares.
    np.testing.assert_allclose(end, test.theory, atol=1e-9)


def test_without_matplotlib_nothing_is_computed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr(report, "prototypical_image", None)
    with pytest.raises(RuntimeError, match="matplotlib"):
        report.reproduce(tmp_path)
    assert not list(tmp_path.iterdir())
