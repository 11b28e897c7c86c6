"""Folders and files that no other user can have written, for what is executed or kept secret.

The rule is the one that OpenSSH has for its keys: the file and its folder belong to this user, each
folder above to this user or root, and others can write none of them; above, a folder such as
``/tmp`` is allowed, where the sticky bit keeps others from renaming what is not theirs. Extended
access lists are not looked at. Windows has neither owner nor mode here: a folder in the user's
profile is guarded by its access list, and only the kind and the size of a file are checked.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from smooth_operator.errors import DocumentError

_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


def make_private(folder: Path) -> None:
    """Makes a folder and those above it that are missing, for this user alone.

    Raises:
        OSError: it can't be made.
    """
    if not folder.is_dir():
        make_private(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def folder_problem(folder: Path) -> str:
    """Who else can change what is in a folder, and what to do; empty if no other user can.

    Looked at from the root down: once a folder is known to be closed, no other user can exchange
    what the next look is at. Links in the path are followed first.

    Raises:
        OSError: the folder, or one above it, can't be looked at.
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
    """Why a file is not used; empty if it is this user's own, plain, and not too long.

    Args:
        status: status of the file that was opened (``os.fstat``), or of one in a closed folder.
        most_bytes: how long it may be.
        secret: others may not read it, either.
    """
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
    """The content of a file of this user; links are not followed, and a pipe is not waited for.

    Args:
        path: the file's path.
        most_bytes, secret: see ``file_problem``.

    Raises:
        OSError: there is no such file, it is a link, or it can't be read.
        DocumentError: see ``file_problem``.
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
