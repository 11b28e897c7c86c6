"""A plugin of smooth-operator with one part of each kind."""

from pathlib import Path

HANDS = Path(__file__).parent / "hands"
"""Folder with the spec file of ``toy_gripper``."""
