"""The distribution and its command."""

import tomllib
from pathlib import Path

from smooth_operator.cli.options import COMMANDS
from smooth_operator_benchmark.options import Bench

PROJECT = tomllib.loads(
    (Path(__file__).resolve().parents[1] / "pyproject.toml").read_text(encoding="utf-8")
)["project"]


def test_the_command_is_an_entry_point():
    points = PROJECT["entry-points"]["smooth_operator.commands"]
    assert points == {"bench": f"{Bench.__module__}:{Bench.__name__}"}
    assert COMMANDS.plugins["bench"].target == points["bench"]
    assert COMMANDS.load("bench") is Bench
