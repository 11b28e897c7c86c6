"""Folders of this program among the user's cache and settings folders."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final, Literal

SWITCH: Final = "SMOOTH_OPERATOR_CACHE"
"""Environment variable that names another folder, or ``off`` for no cache."""

OFF: Final = ("off", "0", "no", "false", "none")
"""Values of ``SWITCH`` for no cache."""


def is_off() -> bool:
    """True if the environment variable ``SWITCH`` disables the cache."""
    return os.environ.get(SWITCH, "").strip().lower() in OFF


def user_cache() -> Path:
    """This program's cache folder, which may not exist yet: the one that the environment variable
    ``SWITCH`` names, otherwise ``program_folder("cache")``."""
    path = os.environ.get(SWITCH, "").strip()
    if path and path.lower() not in OFF:
        return Path(path).expanduser()
    return program_folder("cache")


_PLACES: Final = {
    "cache": ("LOCALAPPDATA", "AppData/Local", "Library/Caches", "XDG_CACHE_HOME", ".cache"),
    "settings": (
        "APPDATA",
        "AppData/Roaming",
        "Library/Application Support",
        "XDG_CONFIG_HOME",
        ".config",
    ),
}
"""Kind -> variable and folder in the home on Windows, folder on macOS, both on Linux."""


def program_folder(kind: Literal["cache", "settings"]) -> Path:
    """This program's folder among the user's caches or settings; it may not exist yet."""
    windows, roaming, mac, xdg, dotted = _PLACES[kind]
    home = Path.home()
    if sys.platform == "win32":
        base = Path(os.environ.get(windows) or home / roaming)
    elif sys.platform == "darwin":
        base = home / mac
    else:
        base = Path(os.environ.get(xdg) or home / dotted)
    return base / "smooth-operator"
