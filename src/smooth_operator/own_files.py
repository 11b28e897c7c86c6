"""Checks that no other user can write to a folder or file that holds programs or secrets.

The rule is that of OpenSSH for its keys: the file and its folder belong to this user, each folder
above to this user or root, and others can't write them, except for a sticky folder such as
``/tmp``. On Windows, only the kind and size of a file are checked.
"""

from __future__ import annotations

import functools
import logging
import os
import stat
import tempfile
from collections.abc import Iterator
from multiprocessing import parent_process
from pathlib import Path
from typing import Final

from smooth_operator.errors import DocumentError
from smooth_operator.user_folders import SWITCH

LOGGER: Final = logging.getLogger("smooth_operator.programs")

MOST_BYTES: Final = 512 << 20
"""Largest size of a folder of compiled programs [bytes]; the least recently used are removed."""

_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


def make_private(folder: Path) -> None:
    """Creates a folder and its missing parents with access for this user alone; OSError if the
    folder can't be created."""
    if not folder.is_dir():
        make_private(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def folder_problem(folder: Path) -> str:
    """Reason why another user can change a folder's content, with advice; empty if no one else can.
    Raises OSError if the folder, or one above it, can't be read.

    The check goes from the root down, because no other user can replace a folder in a safe one.
    """
    if not hasattr(os, "geteuid"):
        return ""
    folder = Path(os.path.realpath(folder, strict=True))
    for place in (*reversed(folder.parents), folder):
        status = os.lstat(place)
        own, shown = status.st_uid == os.geteuid(), repr(str(place))
        if not own and (place == folder or status.st_uid != 0):
            return f"{shown} belongs to another user (UID {status.st_uid})"
        sticky = place != folder and status.st_mode & stat.S_ISVTX
        if status.st_mode & _OTHERS_WRITE and not sticky:
            remedy = "remove it" if place == folder else "chmod go-w"
            mode = stat.S_IMODE(status.st_mode)
            return f"other users can write to {shown} (mode {mode:04o}; {remedy})"
        if not stat.S_ISDIR(status.st_mode):
            return f"{shown} is not a folder"
    return ""


def file_problem(status: os.stat_result, most_bytes: int, secret: bool = False) -> str:
    """Reason why a file with this status should not be used; empty if it is a regular file that
    belongs to this user and is not too long. If it is ``secret``, other users must not be able to
    read it."""
    if not stat.S_ISREG(status.st_mode):
        return "it is not a regular file"
    if hasattr(os, "geteuid"):
        if status.st_uid != os.geteuid():
            return f"it belongs to another user (UID {status.st_uid})"
        if status.st_mode & (_OTHERS if secret else _OTHERS_WRITE):
            return f"it can be {'read' if secret else 'written'} by other users"
    if status.st_size > most_bytes:
        return f"it has {status.st_size} bytes, more than {most_bytes}"
    return ""


def read_own_file(path: Path, most_bytes: int, secret: bool = False) -> bytes:
    """Reads a file of this user, without following links and without waiting for a pipe.

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


@functools.cache
def own_folder(folder: Path) -> Path | None:
    """Returns a folder with its links resolved, and creates it if necessary. Returns None if the
    folder is not writable or, with a warning, if another user can write to it."""
    try:
        make_private(folder)
        problem = folder_problem(folder)
        if not problem:
            with tempfile.TemporaryFile(dir=folder):
                return folder.resolve()
    except OSError:
        return None
    if parent_process() is None:  # workers do not repeat it
        LOGGER.warning(
            "compiled programs are not stored, so every start compiles them again: %s; set %s to "
            "a folder that only you can write to",
            problem,
            SWITCH,
        )
    return None


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    for each in folder.iterdir():
        status = each.lstat()
        if stat.S_ISREG(status.st_mode):
            yield each, status


def make_room(folder: Path, most_bytes: int = MOST_BYTES) -> None:
    """Removes the least recently used files until the folder is small enough."""
    for each, status in sorted(_files(folder), key=lambda pair: -pair[1].st_mtime):
        most_bytes -= status.st_size
        if most_bytes < 0:
            each.unlink(missing_ok=True)
