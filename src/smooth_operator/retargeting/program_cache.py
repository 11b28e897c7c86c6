"""Programs in a folder of this user: the second process neither traces nor compiles.

``ProgramCache`` holds traced programs. ``jax_folder`` is another folder, in which JAX keeps machine
code once it is told so: the command tells it, a library user may (docs/reference/methods.md). Both
are used only where no other user can write (``own_files``), by any number of processes.
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

from smooth_operator.errors import DocumentError, OutputError
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
"""Most bytes in a folder; programs that were used last stay. One has 0.2 to 2 MB."""
MOST_BYTES_OF_ONE: Final = 256 << 20


class ProgramCache:
    """Named pieces of bytes in a folder, whole or not there.

    Args:
        folder: where; it must exist.
        most_bytes: largest size of all files together.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self.folder, self.most_bytes = folder, most_bytes

    def read(self, name: str) -> bytes | None:
        """The bytes that were written under a name; None if there are none, or they changed."""
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

    def write(self, name: str, data: bytes) -> None:
        """Writes an entry, and removes those unused the longest; a full disk costs time only."""
        from smooth_operator.atomic_files import atomic_write  # of the first start alone

        with contextlib.suppress(OutputError, OSError):
            with atomic_write(self.folder / name) as stream:
                os.chmod(stream.name, 0o600)
                stream.write(_digest(data) + data)
            make_room(self.folder, self.most_bytes)

    def drop(self, name: str, reason: object) -> None:
        """Removes an entry that can't be used; the log has the reason."""
        LOGGER.warning("the program %s is compiled again: %s", self.folder / name, reason)
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()

    def size(self) -> tuple[int, int]:
        """Number of entries, and their bytes."""
        sizes = [status.st_size for _, status in _files(self.folder)]
        return len(sizes), sum(sizes)


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    for each in folder.iterdir():
        status = each.lstat()
        if stat.S_ISREG(status.st_mode):
            yield each, status


def make_room(folder: Path, most_bytes: int = MOST_BYTES) -> None:
    """Removes the files of a folder that were not used the longest, down to a number of bytes."""
    for each, status in sorted(_files(folder), key=lambda pair: -pair[1].st_mtime):
        most_bytes -= status.st_size
        if most_bytes < 0:
            each.unlink(missing_ok=True)


def _digest(data: bytes) -> bytes:
    """A flipped bit may leave a program that can be read, and computes something else."""
    return hashlib.sha256(data).digest()


def program_cache() -> ProgramCache | None:
    """The cache of this user; None if it is switched off (``SWITCH``), or see ``own_folder``."""
    folder = None if is_off() else own_folder(user_cache() / "programs")
    return None if folder is None else ProgramCache(folder)


def jax_folder() -> Path | None:
    """This user's folder for machine code of this processor, with room for more; None if it is
    switched off (``SWITCH``), or see ``own_folder``."""
    folder = None if is_off() else own_folder(user_cache() / machine())
    if folder is not None:
        with contextlib.suppress(OSError):
            make_room(folder)
    return folder


def is_off() -> bool:
    """``SWITCH`` says that nothing is kept."""
    return os.environ.get(SWITCH, "").strip().lower() in OFF


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


@functools.cache
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
    if parent_process() is None:  # or each worker would say it again
        LOGGER.warning(
            "compiled programs are not kept, so each start compiles: %s; %s may name another "
            "folder that only you can write",
            problem,
            SWITCH,
        )
    return None
