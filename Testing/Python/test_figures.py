"""Every figure of the pages is in the record of a command that is named beside it."""

from __future__ import annotations

import pytest
import records
import run

PAGES = {page.relative_to(records.ROOT).as_posix(): page for page in records.PAGES}


def test_the_figures_of_the_pages_are_printed_by_the_commands_beside_them():
    assert {name: found for name, page in PAGES.items() if (found := records.unsupported(page))} == {}


def test_settings_that_a_page_may_name_without_a_command_are_still_on_it():
    assert {name: found for name in records.SETTINGS if (found := records.outdated(PAGES[name]))} == {}


def test_the_tables_of_the_pages_are_those_of_the_records():
    for page in PAGES.values():
        text = page.read_text(encoding="utf-8")
        assert records.renewed(text) == (text, []), page.name


def test_every_record_belongs_to_a_benchmark():
    assert {path.stem for path in records.RECORDS.glob("*.md")} <= set(run.BENCHMARKS)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder of pages with one record."""
    monkeypatch.setattr(records, "ROOT", tmp_path)
    monkeypatch.setattr(records, "RECORDS", tmp_path / "measured")
    text = "  Organs of 140 ml.\n\n  | organ | mean mm |\n  |-------|--------:|\n  | rectum |   0.35 |"
    records.write_record("accuracy", "Distances", "2 cores", text)
    return tmp_path


def page(place, text):
    path = place / "page.md"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("A mean of 0.35 mm, organs of 140 ml (`--only accuracy`).", []),
        ("A mean of 0.39 mm (`--only accuracy`).", ["0.39"]),
        ("## Accuracy\n\nBy `--only accuracy`.\n\n| rectum | 0.39 |\n|--|--|\n", ["0.39"]),
        ("A mean of 0.35 mm.", ["0.35"]),
        ("- By `--only accuracy`: 0.35.\n- Elsewhere 0.35 mm.", ["0.35"]),
        ("It takes 2 minutes.", ["2"]),
        ("Two of 7 organs, table 2.1, a net of 9x7, Python 3.9, `0.39 mm`, 512 x 512.", []),
    ],
)
def test_a_figure_without_a_record_is_found(place, text, wrong):
    found = records.unsupported(page(place, text))
    assert [sentence.split(": ")[1] for sentence in found] == wrong


def test_a_table_is_renewed_below_its_mark(place):
    old = "Before.\n\n<!-- table: accuracy, organ -->\n| organ |\n|---|\n| 0.39 |\n\nAfter.\n"
    new, missing = records.renewed(old)
    assert "| rectum |   0.35 |\n\nAfter." in new
    assert "0.39" not in new
    assert records.renewed(new) == (new, missing) == (new, [])


def test_a_mark_without_a_table_is_found_and_left_alone(place):
    text = "<!-- table: accuracy, organs -->\n| old |\n"
    assert records.renewed(text) == (text, ["docs/measured/accuracy.md has no table 'organs', but 'organ'"])


@pytest.mark.parametrize("text", ["  Skipped: gmsh is not installed.", "  The data is absent."])
def test_a_run_without_its_data_is_not_kept(place, text):
    with pytest.raises(ValueError, match="not complete"):
        records.write_record("meshes", "Meshes", "2 cores", text)
    assert not (place / "measured" / "meshes.md").exists()
