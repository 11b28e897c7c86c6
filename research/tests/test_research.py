"""The distribution: every module loads, and its commands are those that the package names."""

import importlib
import tomllib
from pathlib import Path

import pytest

from smooth_operator.cli import main
from smooth_operator.cli.options import COMMANDS
from smooth_operator_research.code import research_digest, statements
from smooth_operator_research.paper.experiment import experiment_code
from smooth_operator_research.physics import suite
from smooth_operator_research.study_simulation import run

RESEARCH = Path(__file__).resolve().parents[1]
SOURCE = RESEARCH / "src"
MODULES = sorted(
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
    for path in SOURCE.rglob("*.py")
)


@pytest.mark.parametrize("name", MODULES)
def test_a_module_loads(name):
    importlib.import_module(name)


def test_the_commands_are_those_that_the_package_expects():
    project = tomllib.loads((RESEARCH / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = set(project["entry-points"]["smooth_operator.commands"])
    others = {"bench", "dataset", "hardware", "study"}  # of other distributions
    assert names == COMMANDS.elsewhere.keys() - others
    assert names <= COMMANDS.plugins.keys()


@pytest.mark.parametrize(
    "words", ["paper", "ablate", "physics", "cross-hand", "study simulate", "bench --physics"]
)
def test_a_command_has_help(words, capsys):
    assert main([*words.split(), "--help"]) == 0
    usage = words.replace("bench --physics", "physics")
    assert f"usage: smooth-operator {usage}" in capsys.readouterr().out


def test_the_code_that_results_depend_on_has_a_digest():
    """A folder that has moved is an error where it is named, also before a long run."""
    assert experiment_code()
    assert research_digest(*suite._CODE)
    assert run._code()


def test_statements_leave_out_comments_and_docstrings(tmp_path):
    path = tmp_path / "code.py"

    def code(text):
        path.write_text(text)
        return statements(path)

    plain = code("LIMIT = 1\n\ndef f(x):\n    return x + LIMIT\n")
    assert plain == code(
        '"""Module."""\nLIMIT = 1\n"""Limit."""\ndef f(x):  # why\n'
        '    """Adds."""\n    return (\n        x + LIMIT\n    )\n'
    )
    assert plain != code("LIMIT = 2\n\ndef f(x):\n    return x + LIMIT\n")
