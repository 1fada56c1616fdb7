"""The README's commands run as they are written, and its pages are there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from quick_fits import without_finer_nets

from VICRegistrationLib.cli import main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"```(sh|python)\n(.*?)```", README, re.DOTALL))
PROGRAM = ".venv/bin/vic-registration"


def commands():
    """The words of each line that calls the program."""
    lines = [shlex.split(line) for line in BLOCKS["sh"].splitlines()]
    return [words[1:] for words in lines if words[0] == PROGRAM]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which the commands have run, but for the mesh where gmsh is missing."""
    path = tmp_path_factory.mktemp("readme")
    with pytest.MonkeyPatch.context() as patch:
        without_finer_nets(patch)
        patch.chdir(path)
        for words in commands():
            if words[0] == "mesh":
                pytest.importorskip("gmsh", reason="gmsh is not installed", exc_type=OSError)
            assert main(words) == 0, words
        yield path


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 250


def test_it_names_the_program_in_every_line_but_the_installation():
    first, *others = BLOCKS["sh"].splitlines()
    assert "pip install" in first
    assert all(line.startswith(PROGRAM) for line in others)


def test_the_commands_write_what_they_say(folder):
    for name in (
        "phantom/mri.nii.gz",
        "bladder/bladder.json",
        "bladder/bladder.step",
        "bladder/report.json",
        "bladder.msh",
    ):
        assert (folder / "build" / name).stat().st_size > 0, name


def test_the_lines_of_python_run(folder, one_net, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    exec(compile(BLOCKS["python"], "README.md", "exec"), {})
    assert (folder / "build" / "bladder.step").stat().st_size > 0
    volume = float(capsys.readouterr().out.split()[0])
    assert volume == pytest.approx(132.4, rel=0.01)


def dead_links(page):
    """Links of a page to other pages, pictures and headings that are not there."""
    links = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", page.read_text(encoding="utf-8"))
    for target, anchor in links:
        path = page.parent / target if target else page
        if "://" not in target and not (path.exists() and (not anchor or anchor in anchors(path))):
            yield f"{page.name}: {target}#{anchor}"


def test_links_between_pages_lead_somewhere():
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    assert [link for page in pages for link in dead_links(page)] == []


def anchors(path):
    """What GitHub calls the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_page_is_named_in_the_readme():
    pages = {path.name for path in (ROOT / "docs").glob("*.md")}
    assert pages <= set(re.findall(r"\]\(docs/([\w-]+\.md)\)", README))
