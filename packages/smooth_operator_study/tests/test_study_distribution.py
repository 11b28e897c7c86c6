"""The distribution: its command, and the libraries that it needs."""

import ast
import importlib
import re
import sys
import tomllib
from pathlib import Path

from smooth_operator.cli.options import COMMANDS
from smooth_operator_study.commands.options import Study

HOME = Path(__file__).resolve().parents[1]
SOURCE = HOME / "smooth_operator_study"
PROJECT, CORE = (
    tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for folder in (HOME, HOME.parents[1])
)


def test_the_command_is_an_entry_point():
    points = PROJECT["entry-points"]["smooth_operator.commands"]
    assert points == {"study": f"{Study.__module__}:{Study.__name__}"}
    assert COMMANDS.plugins["study"].target == points["study"]
    assert COMMANDS.load("study") is Study


def test_every_module_loads_and_its_libraries_are_declared():
    brought = CORE["dependencies"] + CORE["optional-dependencies"]["teleop"]
    needs = {re.split(r"[\[<>=~]", need)[0] for need in (*PROJECT["dependencies"], *brought)}
    known = sys.stdlib_module_names | needs | {"smooth_operator", "smooth_operator_study"}
    for path in SOURCE.rglob("*.py"):
        parts = path.relative_to(HOME).with_suffix("").parts
        importlib.import_module(".".join(parts).removesuffix(".__init__"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert not node.level, path
                names = [node.module or ""]
            assert {name.split(".")[0] for name in names} <= known, path
