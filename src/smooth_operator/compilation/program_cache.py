"""Compiled programs in a folder of this user: the second process neither traces nor compiles.

The library uses it by itself; no setting of JAX or of the process changes. An entry holds machine
code, so it is read only where no other user can have written it (``own_files``), and its name says
the processor, the versions and the settings that it was made for. Any number of processes may use
the folder.
Figures: docs/reference/benchmarks.md, *Start*.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import platform
import stat
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from multiprocessing import parent_process
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import DocumentError, OutputError
from smooth_operator.result_cache.own_files import (
    file_problem,
    folder_problem,
    make_private,
    read_own_file,
)
from smooth_operator.result_cache.user_cache import OFF, SWITCH, user_cache

LOGGER: Final = logging.getLogger("smooth_operator.programs")

_DIGEST: Final = 32
MOST_BYTES: Final = 512 << 20
"""What a folder holds at most; programs that were used last stay. One is of about 2 MB."""
MOST_BYTES_OF_ONE: Final = 256 << 20


class ProgramCache:
    """Named pieces of bytes in a folder, whole or not there.

    Args:
        folder: where; it must exist.
        most_bytes: of all files together.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self.folder, self.most_bytes = folder, most_bytes

    def find(self, name: str) -> bytes | None:
        """What was kept under a name; None if there is nothing, or it is not as it was kept."""
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
            file.touch()  # used now
        return data

    def keep(self, name: str, data: bytes) -> None:
        """Writes an entry, and removes those unused the longest; a full disk costs time only."""
        with contextlib.suppress(OutputError, OSError):
            with atomic_write(self.folder / name) as stream:
                os.chmod(stream.name, 0o600)
                stream.write(_digest(data) + data)
            self._make_room()

    def drop(self, name: str, reason: object) -> None:
        """Removes an entry that can't be used, and says so in the log."""
        LOGGER.warning("the kept program %s is compiled again: %s", self.folder / name, reason)
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()

    def size(self) -> tuple[int, int]:
        """Number of entries, and their bytes."""
        sizes = [status.st_size for _, status in self._files()]
        return len(sizes), sum(sizes)

    def _files(self) -> Iterator[tuple[Path, os.stat_result]]:
        for each in self.folder.iterdir():
            status = each.lstat()
            if stat.S_ISREG(status.st_mode):
                yield each, status

    def _make_room(self) -> None:
        left = self.most_bytes
        for each, status in sorted(self._files(), key=lambda pair: -pair[1].st_mtime):
            left -= status.st_size
            if left < 0:
                each.unlink(missing_ok=True)


def _digest(data: bytes) -> bytes:
    """A flipped bit may leave a program that can be read, and computes something else."""
    return hashlib.sha256(data).digest()


def program_cache() -> ProgramCache | None:
    """The cache of this user; None if it is switched off (``SWITCH``), or see ``own_folder``."""
    if os.environ.get(SWITCH, "").strip().lower() in OFF:
        return None
    return _opened(user_cache() / "programs")


@functools.cache
def _opened(folder: Path) -> ProgramCache | None:
    own = own_folder(folder)
    return None if own is None else ProgramCache(own)


@functools.cache
def machine() -> str:
    """Digest of the processor's features and of jaxlib: compiled code fits no other.

    A home on a network disk serves several machines.
    """
    features = [platform.system(), platform.machine(), version("jaxlib")]
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            features += [next(each for each in lines if each.startswith(("flags", "Features")))]
    except (OSError, StopIteration):
        features += [platform.processor(), platform.node()]
    return hashlib.sha256("\n".join(features).encode()).hexdigest()[:16]


def own_folder(folder: Path) -> Path | None:
    """A folder for machine code, its links resolved; it is made if there is none.

    Returns:
        None if it can't be written, or if another user can write it, which is logged.
    """
    try:
        make_private(folder)
        problem = folder_problem(folder)
        if not problem:
            with tempfile.TemporaryFile(dir=folder):
                return folder.resolve()
    except OSError:
        return None
    _warn(problem)
    return None


@functools.cache  # the programs of frames and JAX's own may be under the same folder
def _warn(problem: str) -> None:
    if parent_process() is None:  # or each worker would say it again
        LOGGER.warning(
            "compiled programs are not kept, so each start compiles: %s; %s may name another "
            "folder that only you can write",
            problem,
            SWITCH,
        )


def remove_foreign(folder: Path) -> None:
    """Removes files of a folder for machine code that another user can have written.

    For a reader that opens them by itself: no other user can exchange them in a closed folder.

    Raises:
        OSError: one can't be removed.
    """
    for entry in folder.iterdir():
        status = entry.lstat()
        if not stat.S_ISDIR(status.st_mode) and (
            problem := file_problem(status, MOST_BYTES_OF_ONE)
        ):
            LOGGER.info("%s was removed: %s", entry, problem)
            entry.unlink(missing_ok=True)
