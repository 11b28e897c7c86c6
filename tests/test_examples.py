"""The examples run on built-in data, are short, and use public names alone."""

from __future__ import annotations

import ast
import importlib
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))
MAX_LINES = 60


def not_public(source: str) -> Iterator[str]:
    """Names that a program imports from the package and that are not public.

    Public are the packages with a list of names, these names, and what is reached as an attribute
    of such a package: ``import smooth_operator.teleop as teleop; teleop.TeleopLoop``.
    """
    tree = ast.parse(source)
    packages: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "smooth_operator":
                    packages[alias.asname or alias.name] = alias.name
                    if not is_public(alias.name):
                        yield alias.name
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if module.split(".")[0] == "smooth_operator":
                names = [alias.name for alias in node.names]
                yield from (f"{module}.{n}" for n in names if not is_public(module, n))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            package = packages.get(ast.unparse(node.value))
            if package and not is_public(package, node.attr):
                yield f"{package}.{node.attr}"


def is_public(module: str, name: str | None = None) -> bool:
    package = importlib.import_module("smooth_operator")
    subpackages = {
        f"smooth_operator.{n}" for n in dir(package) if hasattr(getattr(package, n), "__all__")
    }
    if name and f"{module}.{name}" in subpackages:
        return True
    if module not in {"smooth_operator", *subpackages}:
        return False
    return name is None or name in importlib.import_module(module).__all__


def test_the_examples_are_numbered() -> None:
    numbers = [int(path.name.split("_")[0]) for path in EXAMPLES]
    assert numbers == sorted(set(numbers))
    assert numbers[0] == 1


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_uses_public_names(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert len(source.splitlines()) <= MAX_LINES
    assert list(not_public(source)) == []
    assert ast.get_docstring(ast.parse(source))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an empty folder; what it claims, it asserts. Compiled programs serve the next ones."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")


def test_names_that_are_not_public_are_found() -> None:
    source = """
import smooth_operator.teleop as teleop
import smooth_operator.methods.sbr
from smooth_operator import Hand, teleop, types
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.io import read_recording, jsonable
print(teleop.TeleopLoop, teleop.gadget, Hand.name)
"""
    assert sorted(not_public(source)) == [
        "smooth_operator.hands.catalogue.load_hand",
        "smooth_operator.io.jsonable",
        "smooth_operator.methods.sbr",
        "smooth_operator.teleop.gadget",
        "smooth_operator.types",
    ]
