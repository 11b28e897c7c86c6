"""Checks that no other user can write a folder or file, for programs and secrets.

The rule is that of OpenSSH for its keys: the file and its folder belong to this user, each folder
above to this user or root, and others can't write them, except for a sticky folder such as
``/tmp``. On Windows, only the kind and size of a file are checked.
"""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import Final, Literal

from smooth_operator.errors import DocumentError

_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


def make_private(folder: Path) -> None:
    """Create a folder and its missing parents for this user alone; OSError if the folder can't be
    created."""
    if not folder.is_dir():
        make_private(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def folder_problem(folder: Path) -> str:
    """Reason why another user can change a folder's content, with advice; empty if nobody can.
    OSError if the folder, or one above it, can't be read.

    The check goes from the root down, because no other user can replace a folder in a safe one.
    """
    if not hasattr(os, "geteuid"):
        return ""
    folder = Path(os.path.realpath(folder, strict=True))
    for place in (*reversed(folder.parents), folder):
        status = os.lstat(place)
        own, shown = status.st_uid == os.geteuid(), repr(str(place))
        if not own and (place == folder or status.st_uid != 0):
            return f"{shown} belongs to another user (number {status.st_uid})"
        sticky = place != folder and status.st_mode & stat.S_ISVTX
        if status.st_mode & _OTHERS_WRITE and not sticky:
            remedy = "remove it" if place == folder else "chmod go-w"
            mode = stat.S_IMODE(status.st_mode)
            return f"{shown} can be written by other users (mode {mode:04o}; {remedy})"
        if not stat.S_ISDIR(status.st_mode):
            return f"{shown} is not a folder"
    return ""


def file_problem(status: os.stat_result, most_bytes: int, secret: bool = False) -> str:
    """Reason not to use a file with this status; empty if it is a regular file of this user and not
    too long. If it is ``secret``, others must not be able to read it either."""
    if not stat.S_ISREG(status.st_mode):
        return "it is not a plain file"
    if hasattr(os, "geteuid"):
        if status.st_uid != os.geteuid():
            return f"it belongs to another user (number {status.st_uid})"
        if status.st_mode & (_OTHERS if secret else _OTHERS_WRITE):
            return f"it can be {'read' if secret else 'written'} by other users"
    if status.st_size > most_bytes:
        return f"it has {status.st_size} bytes, more than {most_bytes}"
    return ""


def read_own_file(path: Path, most_bytes: int, secret: bool = False) -> bytes:
    """Read a file of this user, without following links and without waiting for a pipe.

    Raises:
        OSError: there is no such file, it is a link, or it can't be read.
        DocumentError: ``file_problem`` returns a reason.
    """
    flags = (getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))
    handle = os.open(path, os.O_RDONLY | sum(flags))
    try:
        if problem := file_problem(os.fstat(handle), most_bytes, secret):
            raise DocumentError(problem)
        with open(handle, "rb", closefd=False) as file:
            return file.read(most_bytes)
    finally:
        os.close(handle)


SWITCH: Final = "SMOOTH_OPERATOR_CACHE"
"""Environment variable that names another folder, or ``off`` for no cache."""

OFF: Final = ("off", "0", "no", "false", "none")
"""Values of ``SWITCH`` for no cache."""


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
