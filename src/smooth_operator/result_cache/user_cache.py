"""Folder of this program in the user's cache."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

SWITCH: Final = "SMOOTH_OPERATOR_CACHE"
"""Environment variable that names another folder, or ``off`` for no cache."""

OFF: Final = ("off", "0", "no", "false", "none")
"""Values of ``SWITCH`` for no cache."""


def user_cache() -> Path:
    """Folder of this program in the user's cache; it need not exist.

    ``SWITCH``, or ``~/.cache/smooth-operator`` (or under ``XDG_CACHE_HOME``) on Linux,
    ``~/Library/Caches/smooth-operator`` on macOS, ``%LOCALAPPDATA%\\smooth-operator`` on Windows.
    """
    path = os.environ.get(SWITCH, "").strip()
    if path and path.lower() not in OFF:
        return Path(path).expanduser()
    home = Path.home()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return base / "smooth-operator"
