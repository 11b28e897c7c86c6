"""Lint, format and types hold. Types take a minute of one core, so they run among the tests."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]

COMMANDS = ("mypy --no-error-summary", "ruff check -q", "ruff format -q --check")


@pytest.mark.parametrize("command", COMMANDS)
def test_the_code_is_clean(command: str) -> None:
    if importlib.util.find_spec(command.split()[0]) is None:
        pytest.skip(f"{command.split()[0]} is not installed (extra test)")
    done = subprocess.run(
        [sys.executable, "-m", *command.split()],
        cwd=PROJECT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
