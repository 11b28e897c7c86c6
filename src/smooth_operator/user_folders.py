"""Folders of this program among the user's caches and settings."""

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
    """Folder of this program in the user's cache, which need not exist: ``SWITCH``, or that of
    ``program_folder``."""
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
    """Folder of this program among the user's caches or settings; it need not exist."""
    windows, roaming, mac, xdg, dotted = _PLACES[kind]
    home = Path.home()
    if sys.platform == "win32":
        base = Path(os.environ.get(windows) or home / roaming)
    elif sys.platform == "darwin":
        base = home / mac
    else:
        base = Path(os.environ.get(xdg) or home / dotted)
    return base / "smooth-operator"
