"""What holds for every file of code: functions fit on a screen, tests have no time limits and patch nothing private."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = sorted((ROOT / "VICRegistration").rglob("*.py"))
TESTS = sorted([*(ROOT / "Testing" / "Python").glob("*.py"), *(ROOT / "Testing" / "Slicer").glob("*.py")])
# They run seldom, and a name that has moved would be noticed late.
SCRIPTS = sorted([*(ROOT / "Resources").glob("*.py"), *(ROOT / "docs" / "examples").glob("*.py")])
SCRIPTS += sorted((ROOT / "Testing" / "benchmarks").glob("*.py"))
MOST_LINES = 60
CLOCKS = {"monotonic", "perf_counter", "time"}


def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def place(path, node):
    return f"{path.relative_to(ROOT).as_posix()}:{node.lineno}"


def lines_of(function):
    """Lines of a function without its docstring, which may tell all there is to know."""
    first = function.body[0]
    is_text = (
        isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str)
    )
    docstring = first.end_lineno - first.lineno + 1 if is_text else 0
    return function.end_lineno - function.lineno + 1 - docstring


def time_limits(path):
    """Places where a file gives up after a time, or asks how long something took."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Call) and any(keyword.arg == "timeout" for keyword in node.keywords):
            yield place(path, node)
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("pytest.mark.timeout", "signal.alarm"):
            yield place(path, node)
        if isinstance(node, ast.Compare):
            called = [part.func for part in ast.walk(node) if isinstance(part, ast.Call)]
            names = {getattr(function, "attr", getattr(function, "id", "")) for function in called}
            if names & CLOCKS:
                yield place(path, node)


def patched_constants(path):
    """Places where a file sets a constant of a module that begins with an underscore."""
    for node in ast.walk(tree(path)):
        texts = []
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("setattr", "setitem", "delattr"):
            texts = [part.value for part in node.args if isinstance(part, ast.Constant)]
        elif isinstance(node, (ast.Assign, ast.AugAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            texts = [target.attr for target in targets if isinstance(target, ast.Attribute)]
        if any(isinstance(text, str) and re.search(r"(?:^|\.)_[A-Z][A-Z0-9_]*$", text) for text in texts):
            yield place(path, node)


def test_no_function_is_longer_than_a_screen():
    long = [
        f"{place(path, node)} {node.name}: {lines_of(node)} lines"
        for path in LIBRARY
        for node in ast.walk(tree(path))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and lines_of(node) > MOST_LINES
    ]
    assert long == []


def defined_names(path):
    """Names that a module makes at its top level."""
    for node in tree(path).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            yield from (alias.asname or alias.name for alias in node.names)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            yield from (part.id for part in ast.walk(node) if isinstance(part, ast.Name))


def missing_imports(path):
    """Names that a file imports of the library, and that are not there."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("VICRegistrationLib."):
            place = ROOT / "VICRegistration" / node.module.replace(".", "/")
            module = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
            known = {*defined_names(module), *(each.stem for each in place.glob("*.py"))}
            yield from (f"{path.name}: {node.module}.{alias.name}" for alias in node.names if alias.name not in known)


def test_what_a_script_imports_of_the_library_is_there():
    assert [found for path in SCRIPTS for found in missing_imports(path)] == []


def test_no_test_has_a_time_limit():
    assert [found for path in TESTS for found in time_limits(path)] == []


def test_no_test_patches_a_private_constant():
    assert [found for path in TESTS for found in patched_constants(path)] == []


@pytest.mark.parametrize(
    ("code", "rule"),
    [
        ("subprocess.run(command, timeout=60)", time_limits),
        ("while time.monotonic() < end: pass", time_limits),
        ("@pytest.mark.timeout(5)\ndef test_a(): pass", time_limits),
        ("monkeypatch.setattr(module, '_MOST', 3)", patched_constants),
        ("monkeypatch.setattr('package.module._MOST', 3)", patched_constants),
        ("module._MOST = 3", patched_constants),
    ],
)
def test_what_breaks_a_rule_is_found(code, rule, tmp_path, monkeypatch):
    monkeypatch.setattr("test_source_rules.ROOT", tmp_path)
    path = tmp_path / "some.py"
    path.write_text(code)
    assert list(rule(path)) != []
