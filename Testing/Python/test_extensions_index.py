"""Rules for a new entry of Slicer's Extensions Index, as far as they can be checked without a network."""

from __future__ import annotations

import ast
import functools
import json
import re
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "VICRegistration"
ENTRY = ROOT / "Resources" / "ExtensionsIndex" / "VICRegistration.json"
CMAKE = (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
SOURCES = sorted(path for path in MODULE.rglob("*.py") if "__pycache__" not in path.parts)
# Made by tools, and not in a clone.
NOT_CLONED = {".git", ".venv", ".venv-oldest", "build", "dist", "__pycache__", ".pytest_cache", ".ruff_cache"}
IN_SLICER = {"slicer", "qt", "ctk", "SampleData", "vtk", "vtkmodules", "numpy", "scipy", "SimpleITK"}
NETWORK = {"ftplib", "http", "httpx", "requests", "socket", "urllib", "urllib3", "xmlrpc"}
# Keys of the index's schema (version 1.0.1), and which of them are needed.
KEYS = {
    "$schema": str,
    "category": str,
    "scm_url": str,
    "scm_revision": str,
    "scm_type": str,
    "build_dependencies": list,
    "build_subdirectory": str,
    "enabled": bool,
    "tier": int,
}
NEEDED_KEYS = {"$schema", "category", "scm_url"}
# Run in processes of their own, and never imported.
PROGRAMS = {"gmsh_worker.py": {"gmsh"}, "patch_worker.py": {"gmsh"}}
# The one place where packages are installed: when they are needed, after asking.
INSTALLER = "mesher.py"
# Python 3.9 does not tell which modules are its own.
STANDARD_LIBRARY = getattr(sys, "stdlib_module_names", None)


@pytest.fixture(name="entry")
def fixture_entry():
    """The entry as it would be handed in."""
    return json.loads(ENTRY.read_text(encoding="utf-8"))


def extension_value(name):
    """One set(EXTENSION_...) of CMakeLists.txt, found by the pattern that the index uses."""
    found = re.findall(rf'set\s*\(EXTENSION_{name}\s*"([^"]+)"\)', CMAKE, re.IGNORECASE | re.MULTILINE)
    assert len(found) == 1, name
    return found[0]


def repository(url):
    """Owner and name of a repository on GitHub."""
    return urlsplit(url).path.strip("/").removesuffix(".git").split("/")[:2]


def file_of(url):
    """The file of this repository that a raw address on GitHub stands for."""
    parts = urlsplit(url)
    assert (parts.scheme, parts.netloc) == ("https", "raw.githubusercontent.com"), url
    owner, name, branch, path = parts.path.lstrip("/").split("/", 3)
    assert [owner, name] == repository(extension_value("HOMEPAGE"))
    assert branch == "main"
    return ROOT / path


@functools.cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(nodes):
    """First words of the absolute names that import statements name."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.split(".")[0]


def test_the_entry_has_the_keys_and_types_of_the_schema_and_unix_line_ends(entry):
    assert b"\r" not in ENTRY.read_bytes()
    assert set(entry) >= NEEDED_KEYS
    assert [key for key, value in entry.items() if type(value) is not KEYS.get(key)] == []


def test_the_extension_is_named_like_its_entry_and_not_after_slicer():
    assert re.findall(r"project\s*\(\s*([^\s)]+)", CMAKE) == [ENTRY.stem]
    assert not ENTRY.stem.lower().startswith("slicer")


def test_the_repository_is_named_after_slicer_and_fetched_by_https(entry):
    address = urlsplit(entry["scm_url"])
    assert (address.scheme, address.netloc) == ("https", "github.com")
    assert repository(entry["scm_url"]) == repository(extension_value("HOMEPAGE"))
    assert repository(entry["scm_url"])[1] == f"Slicer{ENTRY.stem}"


def test_the_entry_agrees_with_the_build_files(entry):
    assert entry["category"] == extension_value("CATEGORY")
    needed = extension_value("DEPENDS").split()
    assert entry["build_dependencies"] == ([] if needed == ["NA"] else needed)
    # Another one is for extensions that build other projects first.
    assert entry["build_subdirectory"] == "."


def test_the_module_is_listed_in_the_category_of_the_extension():
    categories = re.search(
        r"categories\s*=\s*\[([^\]]*)\]", (MODULE / "VICRegistration.py").read_text(encoding="utf-8")
    )
    assert f'"{extension_value("CATEGORY")}"' in categories.group(1)


def test_the_description_is_one_or_two_sentences():
    description = re.sub(r"\([^)]*\)", "", extension_value("DESCRIPTION"))
    assert 1 <= len(re.findall(r"\.(?:\s|$)", description)) <= 2
    # CMake takes a semicolon for the end of a list's item.
    assert ";" not in description
    assert extension_value("CONTRIBUTORS")


def test_the_icon_and_at_least_one_screenshot_are_png_files_of_the_repository():
    screenshots = extension_value("SCREENSHOTURLS").split()
    assert screenshots
    for url in [extension_value("ICONURL"), *screenshots]:
        assert file_of(url).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n", url


def test_a_licence_lies_in_the_root_and_is_named_in_the_readme():
    assert (ROOT / "LICENSE").is_file()
    assert "Apache License 2.0" in README


def test_the_readme_shows_what_the_extension_is():
    title, summary = README.split("\n\n")[:2]
    assert title == f"# {ENTRY.stem}"
    assert 1 <= len(re.findall(r"\.(?:\s|$)", summary)) <= 2
    assert re.search(r"https://doi\.org/10\.", README), "a link to the publication"


def test_every_module_has_a_sentence_in_the_readme():
    for module in MODULE.glob("*.py"):
        assert re.search(rf"\*\*Module {module.stem}\*\*[^.]+\.", README), module.stem


def test_the_readme_leads_to_a_tutorial_with_sample_data_and_pictures():
    assert "](docs/tutorial.md)" in README
    tutorial = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    assert len(re.findall(r"^\d+\. ", tutorial, re.MULTILINE)) >= 7
    assert "Sample Data" in tutorial
    assert "Resources/Screenshots/" in tutorial


def test_the_repository_is_small():
    sizes = [
        path.stat().st_size
        for path in ROOT.rglob("*")
        if path.is_file() and not NOT_CLONED.intersection(path.relative_to(ROOT).parts)
    ]
    # The index allows 100 MB for a clone, which holds every file twice: as it is, and in the history.
    assert sum(sizes) < 20e6


def test_importing_a_file_only_defines_things():
    allowed = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)
    others = [
        f"{path.relative_to(MODULE).as_posix()}:{part.lineno}"
        for path in SOURCES
        for node in tree(path).body[1:]
        for part in unguarded(node)
        # `python -m VICRegistrationLib` runs this file; nothing imports it.
        if not isinstance(part, allowed) and not is_main_guard(part) and path.name != "__main__.py"
    ]
    assert others == []


def unguarded(node):
    """Statements of a try for a module that not every system has, or the statement itself."""
    is_guard = isinstance(node, ast.Try) and not node.finalbody
    return [*node.body, *(part for handler in node.handlers for part in handler.body)] if is_guard else [node]


def is_main_guard(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("__name__ == '__main__'", "TYPE_CHECKING")


@pytest.mark.skipif(STANDARD_LIBRARY is None, reason="this Python does not list its standard library (needs 3.10)")
def test_importing_a_file_needs_only_what_slicer_has():
    known = IN_SLICER | STANDARD_LIBRARY | {"VICRegistrationLib"}
    others = {
        path.relative_to(MODULE).as_posix(): set(imported(tree(path).body)) - known - PROGRAMS.get(path.name, set())
        for path in SOURCES
    }
    assert {path: names for path, names in others.items() if names} == {}


def test_nothing_is_sent_or_fetched_and_installed_only_with_consent():
    found = [
        (path.relative_to(MODULE).as_posix(), name)
        for path in SOURCES
        for name in imported(ast.walk(tree(path)))
        if name in NETWORK
    ]
    assert found == []
    installing = [path for path in SOURCES if "pip_install" in path.read_text(encoding="utf-8")]
    assert [path.name for path in installing] == [INSTALLER]
    text = installing[0].read_text(encoding="utf-8")
    assert text.index("confirmOkCancelDisplay(") < text.index('pip_install("gmsh")')


def test_no_program_is_kept_in_binary_form():
    binaries = {".a", ".bin", ".dll", ".dylib", ".exe", ".jar", ".pyc", ".pyd", ".so", ".whl", ".zip"}
    found = [
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*")
        if path.suffix in binaries and not NOT_CLONED.intersection(path.relative_to(ROOT).parts)
    ]
    assert found == []
