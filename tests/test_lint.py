"""Lint, format and types hold. Types take a minute of one core, so they run among the tests."""

import importlib.util
import re
from importlib.metadata import version
from pathlib import Path

import pytest
from processes import python

PROJECT = Path(__file__).resolve().parents[1]

COMMANDS = ("mypy --no-error-summary", "ruff check -q", "ruff format -q --check")


@pytest.mark.parametrize("command", COMMANDS)
def test_the_code_is_clean(command):
    if importlib.util.find_spec(command.split()[0]) is None:
        pytest.skip(f"{command.split()[0]} is not installed (extra test)")
    # other releases have other rules and types
    lock = (PROJECT / "requirements.lock").read_text(encoding="utf-8")
    locked = dict(re.findall(r"^([\w-]+)==(\S+)", lock, re.MULTILINE))
    deciding = (command.split()[0], "numpy", "jax") if "mypy" in command else (command.split()[0],)
    others = [f"{n} {version(n)}" for n in deciding if version(n) != locked[n]]
    if others:
        pytest.skip(f"judged with the versions of requirements.lock, not with {', '.join(others)}")
    done = python("-m", *command.split(), cwd=PROJECT)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
