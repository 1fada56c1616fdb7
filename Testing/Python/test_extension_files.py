"""The files of the Slicer extension agree with each other, so that a build installs all of it."""

from __future__ import annotations

import ast
import re
import struct
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "VICRegistration"
LIBRARY = MODULE / "VICRegistrationLib"
# Each folder imports from those in the rows above it only.
ROWS = (
    ("transactions", "file_names", "frames", "json_files", "messages", "organ_colours", "surface_formats"),
    ("files",),
    ("geometry", "imaging"),
    ("segmentation",),
    ("registration",),
    ("export",),
    ("analysis",),
    ("phantoms", "meshing"),
    ("report",),
    ("validation", "multipatch"),
    ("mrml", "cli", "api"),
    ("gui", "demo"),
)
ROW_OF = {room: row for row, rooms in enumerate(ROWS) for room in rooms}
SLICER_NAMES = {"slicer", "qt", "ctk", "SampleData", "MRMLCorePython"}
ICONS = [ROOT / "Resources" / "VICRegistration.png", MODULE / "Resources" / "Icons" / "VICRegistration.png"]


def cmake_list(name):
    """The words of one set(...) command in the module's CMakeLists.txt."""
    text = re.sub(r"#.*", "", (MODULE / "CMakeLists.txt").read_text())
    return re.search(rf"set\({name}\s+([^)]*)\)", text).group(1).split()


def files_below(folder, pattern):
    found = (path for path in folder.rglob(pattern) if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(MODULE).as_posix() for path in found}


def imported_names(path):
    """Absolute dotted names of all that a file imports, wherever in the file it does so."""
    package = path.relative_to(MODULE).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = [*above, *([node.module] if node.module else [])]
            yield from (".".join([*base, alias.name]) for alias in node.names)


def rooms_imported_by(path):
    """Folders and single files of the library that a file of it imports."""
    for name in imported_names(path):
        parts = name.split(".")
        if parts[0] == "VICRegistrationLib" and len(parts) > 1 and parts[1] in ROW_OF:
            yield parts[1]


def resources():
    """Files beside the modules that are no Python: Slicer copies them to the same places."""
    in_library = {file for file in files_below(LIBRARY, "*") if not file.endswith(".py")}
    return files_below(MODULE / "Resources", "*") | in_library


@pytest.mark.parametrize(
    ("name", "files"),
    [("MODULE_PYTHON_SCRIPTS", files_below(MODULE, "*.py")), ("MODULE_PYTHON_RESOURCES", resources())],
)
def test_the_module_lists_every_file_once(name, files):
    listed = cmake_list(name)
    differences = [f"add to {name}:      {file}" for file in sorted(files - set(listed))]
    differences += [f"remove from {name}: {file}" for file in sorted(set(listed) - files)]
    differences += [f"listed twice in {name}: {file}" for file in sorted(set(listed)) if listed.count(file) > 1]
    assert not differences, "\n" + "\n".join(differences)


def test_a_wheel_holds_the_library_s_files_that_are_no_python():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^\[tool\.setuptools\.package-data\]\nVICRegistrationLib = (\[.*\])$", text, re.MULTILINE)
    packed = {f"VICRegistrationLib/{file}" for file in ast.literal_eval(listed.group(1))}
    assert packed == {file for file in resources() if file.startswith("VICRegistrationLib/")}


def test_every_package_has_its_init_file():
    folders = {path.parent for path in LIBRARY.rglob("*.py")}
    assert [folder.name for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_only_the_module_file_lies_where_slicer_looks_for_modules():
    assert [path.name for path in MODULE.glob("*.py")] == ["VICRegistration.py"]


def test_the_extension_builds_and_packs_its_module():
    text = (ROOT / "CMakeLists.txt").read_text()
    commands = [
        "cmake_minimum_required(",
        "find_package(Slicer REQUIRED)",
        "include(${Slicer_USE_FILE})",
        "add_subdirectory(VICRegistration)",
        "include(${Slicer_EXTENSION_GENERATE_CONFIG})",
        "include(${Slicer_EXTENSION_CPACK})",
    ]
    places = [text.find(command) for command in commands]
    assert -1 not in places
    assert places == sorted(places)


@pytest.mark.parametrize("icon", ICONS, ids=["extension", "module"])
def test_an_icon_has_128_by_128_pixels_and_transparency(icon):
    header = icon.read_bytes()[:26]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    # The first chunk of a PNG: width, height, bits per channel, and colour type, where 6 is RGBA.
    assert struct.unpack(">IIBB", header[16:]) == (128, 128, 8, 6)


def test_the_licence_is_apache_2():
    text = (ROOT / "LICENSE").read_text()
    assert text.split()[:4] == ["Apache", "License", "Version", "2.0,"]
    assert "END OF TERMS AND CONDITIONS" in text


def test_every_folder_has_a_row():
    rooms = {path.name for path in LIBRARY.iterdir() if path.is_dir()} | {path.stem for path in LIBRARY.glob("*.py")}
    assert rooms - {"__init__", "__main__", "__pycache__"} == set(ROW_OF)


def test_imports_point_one_way():
    upwards = [
        (path.relative_to(LIBRARY).as_posix(), other)
        for room in ROW_OF
        for path in sorted((LIBRARY / room).rglob("*.py")) or [LIBRARY / f"{room}.py"]
        for other in rooms_imported_by(path)
        if other != room and ROW_OF[other] >= ROW_OF[room]
    ]
    assert upwards == []


def test_the_architecture_names_every_package():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^ {8}(\w+)/ ", text, re.MULTILINE))
    assert named == {path.parent.name for path in LIBRARY.glob("*/__init__.py")}


def test_every_picture_is_on_a_page():
    pages = "".join(path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    pictures = {path.name for path in (ROOT / "Resources").rglob("*.png")} - {path.name for path in ICONS}
    assert {name for name in pictures if f"/{name}" not in pages} == set()


@pytest.mark.parametrize(
    ("names", "packages"), [(SLICER_NAMES, {"mrml", "gui"}), ({"qt", "ctk"}, {"gui"})], ids=["Slicer", "Qt"]
)
def test_who_knows_slicer_and_who_knows_qt(names, packages):
    known = [
        (path.relative_to(LIBRARY).as_posix(), name)
        for path in sorted(LIBRARY.rglob("*.py"))
        if path.relative_to(LIBRARY).parts[0] not in packages
        for name in imported_names(path)
        if name.split(".")[0] in names
    ]
    assert known == []
