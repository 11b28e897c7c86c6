"""Built-in hands that research/benchmarks/compact_hand.py made: long tests try them weekly."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from smooth_operator.hands.registry import hand_names

_RECIPES = Path(__file__).parents[1] / "research" / "benchmarks" / "compact_hands.toml"
MADE = frozenset(tomllib.loads(_RECIPES.read_text(encoding="utf-8")))


def long_test_hands() -> list[Any]:
    """All built-in hands, for a parameter ``name``; those of ``MADE`` are marked weekly."""
    marks = {True: [pytest.mark.weekly], False: []}
    return [pytest.param(name, marks=marks[name in MADE]) for name in hand_names()]
