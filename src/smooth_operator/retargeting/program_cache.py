"""Folder in which this user's traced programs are stored, so that later starts are faster.

Any number of processes can use it. No other user may be able to write to it (``own_files``).
Figures: docs/reference/benchmarks.md, *Start*.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Iterator
from multiprocessing import parent_process
from pathlib import Path
from typing import Final

from smooth_operator.errors import DocumentError
from smooth_operator.own_files import (
    OFF,
    SWITCH,
    folder_problem,
    make_private,
    read_own_file,
    user_cache,
)

LOGGER: Final = logging.getLogger("smooth_operator.programs")

_DIGEST: Final = 32
MOST_BYTES: Final = 512 << 20
"""Largest size of a folder [bytes]. The programs that were used last stay; one has 0.2 to 2 MB."""
MOST_BYTES_OF_ONE: Final = 256 << 20


class ProgramCache:
    """Named entries of bytes in a folder. An entry is complete or missing.

    Args:
        folder: an existing folder.
        most_bytes: largest size of all files together.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self.folder, self.most_bytes = folder, most_bytes

    def read(self, name: str) -> bytes | None:
        """Returns an entry; None if it is missing or damaged."""
        file = self.folder / name
        try:
            content = read_own_file(file, MOST_BYTES_OF_ONE)
        except FileNotFoundError:
            return None
        except (OSError, DocumentError) as error:
            self.drop(name, error)
            return None
        digest, data = content[:_DIGEST], content[_DIGEST:]
        if _digest(data) != digest:
            self.drop(name, "it is damaged")
            return None
        with contextlib.suppress(OSError):
            file.touch()  # the time of its last use
        return data

    def write(self, name: str, data: bytes) -> None:
        """Writes an entry, and removes the entries that were not used for longest. Errors of the
        disk are ignored."""
        with contextlib.suppress(OSError):
            handle, unfinished = tempfile.mkstemp(dir=self.folder)
            try:
                with open(handle, "wb") as stream:
                    stream.write(_digest(data) + data)
                os.replace(unfinished, self.folder / name)
            finally:
                Path(unfinished).unlink(missing_ok=True)
            make_room(self.folder, self.most_bytes)

    def drop(self, name: str, reason: object) -> None:
        """Removes an unusable entry, and logs the reason."""
        LOGGER.warning("the program %s is compiled again: %s", self.folder / name, reason)
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    for each in folder.iterdir():
        status = each.lstat()
        if stat.S_ISREG(status.st_mode):
            yield each, status


def make_room(folder: Path, most_bytes: int = MOST_BYTES) -> None:
    """Removes the files that were not used for longest, until the folder is small enough."""
    for each, status in sorted(_files(folder), key=lambda pair: -pair[1].st_mtime):
        most_bytes -= status.st_size
        if most_bytes < 0:
            each.unlink(missing_ok=True)


def _digest(data: bytes) -> bytes:
    """Checksum: a program with a flipped bit may be readable and compute wrong results."""
    return hashlib.sha256(data).digest()


def program_cache() -> ProgramCache | None:
    """The cache of this user; None if it is disabled (``SWITCH``) or has no safe folder."""
    folder = None if is_off() else own_folder(user_cache() / "programs")
    return None if folder is None else ProgramCache(folder)


def is_off() -> bool:
    """True if the environment variable ``SWITCH`` disables the cache."""
    return os.environ.get(SWITCH, "").strip().lower() in OFF


@functools.cache
def own_folder(folder: Path) -> Path | None:
    """Returns a folder with its links resolved, and creates it if necessary; None if it is not
    writable, or, with a warning, if another user can write to it."""
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
