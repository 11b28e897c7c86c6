"""Built-in hands that research/benchmarks/compact_hand.py made: long tests try them weekly."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from smooth_operator.hands.registry import hand_names

_RECIPES = Path(__file__).parents[1] / "research" / "benchmarks" / "compact_hands.toml"
GRIPPERS = ("franka_hand", "robotiq_2f140", "robotiq_2f85", "so101")
"""Built-in grippers: two jaws that close on each other, which either human hand drives."""
MADE = frozenset(tomllib.loads(_RECIPES.read_text(encoding="utf-8")))


def long_test_hands() -> list[Any]:
    """All built-in hands but grippers, for a parameter ``name``; those of ``MADE`` are marked
    weekly."""
    marks = {True: [pytest.mark.weekly], False: []}
    names = [name for name in hand_names() if name not in GRIPPERS]
    return [pytest.param(name, marks=marks[name in MADE]) for name in names]
