"""Folder of the user's hands, with spec files ``NAME.right.toml`` and ``NAME.left.toml``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

from smooth_operator.types import Side

SWITCH: Final = "SMOOTH_OPERATOR_HANDS"
"""Environment variable that names another folder for the user's hands."""


def user_hands_folder() -> Path:
    """Folder of the user's spec files; it need not exist.

    ``SWITCH``, or ``hands`` in this program's folder among the user's settings:
    ``~/.config/smooth-operator`` (or under ``XDG_CONFIG_HOME``) on Linux, ``~/Library/Application
    Support/smooth-operator`` on macOS, ``%APPDATA%\\smooth-operator`` on Windows.
    """
    path = os.environ.get(SWITCH, "").strip()
    if path:
        return Path(path).expanduser()
    home = Path.home()
    if sys.platform == "win32":
        base = Path(os.environ.get("APPDATA") or home / "AppData" / "Roaming")
    elif sys.platform == "darwin":
        base = home / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
    return base / "smooth-operator" / "hands"


def spec_name(name: str, side: Side) -> str:
    """File name of a hand's spec: ``NAME.SIDE.toml``."""
    return f"{name}.{side}.toml"


def model_folder(name: str, side: Side) -> Path:
    """Folder of the copy of a hand's model that ``hands add`` makes."""
    return user_hands_folder() / "models" / f"{name}.{side}"


def find_specs(folder: Path) -> dict[str, dict[Side, Path]]:
    """Spec files of a folder by name and side; empty if there is no such folder."""
    specs: dict[str, dict[Side, Path]] = {}
    sides: tuple[Side, ...] = ("right", "left")
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError:
        return specs
    for file in names:
        for side in sides:
            name = file.removesuffix(f".{side}.toml")
            if name and name != file:
                specs.setdefault(name, {})[side] = folder / file
    return specs
