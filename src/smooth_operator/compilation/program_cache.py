"""Compiled programs in a folder of this user: the second process neither traces nor compiles.

The library uses it by itself; no setting of JAX or of the process changes. An entry holds machine
code, so it is only read from a folder that belongs to this user, and its name says the processor,
the versions and the settings that it was made for. Any number of processes may use the folder.
Figures: docs/reference/benchmarks.md, *Start*.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import platform
import secrets
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import OutputError
from smooth_operator.result_cache.user_cache import OFF, SWITCH, user_cache

LOGGER: Final = logging.getLogger("smooth_operator.programs")

_DIGEST: Final = 32
MOST_BYTES: Final = 512 << 20
"""What a folder holds at most; programs that were used last stay. One is of about 2 MB."""


class ProgramCache:
    """Named pieces of bytes in a folder, whole or not there.

    Args:
        folder: where; it must exist.
        most_bytes: of all files together.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self.folder, self.most_bytes = folder, most_bytes

    def find(self, name: str) -> bytes | None:
        """What was kept under a name; None if there is nothing, or it is damaged."""
        file = self.folder / name
        try:
            content = file.read_bytes()
        except OSError:
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
                stream.write(_digest(data) + data)
            self._make_room()

    def drop(self, name: str, reason: object) -> None:
        """Removes an entry that can't be used, and says so in the log."""
        LOGGER.warning("the kept program %s is compiled again: %s", self.folder / name, reason)
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()

    def size(self) -> tuple[int, int]:
        """Number of entries, and their bytes."""
        sizes = [each.stat().st_size for each in self._files()]
        return len(sizes), sum(sizes)

    def _files(self) -> Iterable[Path]:
        return (each for each in self.folder.iterdir() if each.is_file())

    def _make_room(self) -> None:
        left = self.most_bytes
        found = [(each.stat(), each) for each in self._files()]
        for status, each in sorted(found, key=lambda pair: -pair[0].st_mtime):
            left -= status.st_size
            if left < 0:
                each.unlink(missing_ok=True)


def _digest(data: bytes) -> bytes:
    """A flipped bit may leave a program that can be read, and computes something else."""
    return hashlib.sha256(data).digest()


def program_cache() -> ProgramCache | None:
    """The cache of this user; None if it is switched off (``SWITCH``) or can't be written."""
    if os.environ.get(SWITCH, "").strip().lower() in OFF:
        return None
    return _opened(user_cache() / "programs")


@functools.cache
def _opened(folder: Path) -> ProgramCache | None:
    return ProgramCache(folder) if is_own_folder(folder) else None


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


def is_own_folder(folder: Path) -> bool:
    """Whether a folder, which is made if there is none, belongs to this user and can be written."""
    probe = folder / f".{secrets.token_hex(4)}"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return False  # what someone else put there is not run
        probe.touch()
        probe.unlink()
    except OSError:
        return False
    return True
