"""The examples run on built-in data, are short, and use public names alone."""

import ast
import functools
import importlib
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_docs import PAGES, PROJECT, python_blocks

from smooth_operator import lazy_names

EXAMPLES = sorted((PROJECT / "examples").glob("*.py"))
MAX_LINES = 60
PUBLIC_MODULES = (
    "smooth_operator.errors",
    "smooth_operator.landmarks",
)
PLUGIN = sorted((PROJECT / "examples" / "plugin" / "toy_retargeting").glob("*.py"))
INTERNAL = {"joint_ranges.py": {"smooth_operator.cli.common_options.Common"}}
"""What the example plugin imports that is not public: the base of commands. Not to grow."""


def not_public(source: str) -> Iterator[str]:
    """Names that a program imports from the package and that are not public.

    Public are the packages with a list of names, these names, and what is reached as an attribute
    of such a package: ``import smooth_operator.teleop as teleop; teleop.TeleopLoop``.
    """
    imported: dict[str, str] = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [(alias.name, "") for alias in node.names]
            imported |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute):
            names = [(imported.get(ast.unparse(node.value), ""), node.attr)]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module or "", alias.name) for alias in node.names]
        else:
            continue
        for module, name in names:
            if module.split(".")[0] == "smooth_operator" and not is_public(module, name):
                yield f"{module}.{name}".rstrip(".")


def is_public(module: str, name: str) -> bool:
    if f"{module}.{name}" in {*packages(), *PUBLIC_MODULES}:
        return True
    if module not in {"smooth_operator", *packages(), *PUBLIC_MODULES}:
        return False
    return not name or name in importlib.import_module(module).__all__


@functools.cache
def packages() -> list[str]:
    """The public packages: those that the package itself names."""
    package = importlib.import_module("smooth_operator")
    stub = lazy_names.stub_imports(str(Path(package.__file__ or "").with_suffix(".pyi")))
    return [f"smooth_operator.{name}" for name, home in stub.items() if home == "smooth_operator"]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_uses_public_names(path):
    source = path.read_text(encoding="utf-8")
    assert len(source.splitlines()) <= MAX_LINES
    assert list(not_public(source)) == []
    assert ast.get_docstring(ast.parse(source))


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.weekly if "optuna" in path.stem else ())
        for path in EXAMPLES
    ],
    ids=lambda path: path.stem,
)
def test_an_example_runs(path, tmp_path, monkeypatch):
    """In an empty folder; what it claims, it asserts. Compiled programs serve the next ones."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")


def test_the_documentation_imports_public_names():
    found: dict[str, set[str]] = {}
    for page in PAGES:
        for _, code in python_blocks(page.read_text(encoding="utf-8")):
            if names := set(not_public(code)):
                found.setdefault(page.relative_to(PROJECT).as_posix(), set()).update(names)
    assert found == {}


def test_the_example_plugin_imports_public_names():
    used = {path.name: set(not_public(path.read_text(encoding="utf-8"))) for path in PLUGIN}
    assert {name: names for name, names in used.items() if names} == INTERNAL
