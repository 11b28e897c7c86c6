"""A lock on a bus, so that two programs never command one hand."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import IO

from smooth_operator.errors import SinkError
from smooth_operator.terminal import printable


class BusLock:
    """The right to use a bus, until ``release``; the system takes it back when the process dies.

    It holds among programs of this package on this machine. Drivers open serial ports exclusively,
    too, which keeps others out.

    Args:
        bus: what is locked: the path of a port, links followed, or an address.

    Raises:
        SinkError: another program, or this one, has it.
    """

    def __init__(self, bus: str) -> None:
        self.bus = bus
        name = os.path.realpath(bus) if bus.startswith(os.sep) else bus
        folder = Path(tempfile.gettempdir()) / "smooth-operator-buses"
        path = folder / f"{hashlib.sha256(name.encode()).hexdigest()[:16]}.lock"
        try:
            folder.mkdir(exist_ok=True)
            with contextlib.suppress(OSError):
                folder.chmod(0o1777)  # other users lock their buses here, too
            # In a folder that all users write to, a link could point at anybody's file.
            flags = (
                os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            )
            self._file: IO[bytes] | None = os.fdopen(os.open(path, flags, 0o666), "r+b")
            with contextlib.suppress(OSError):
                path.chmod(0o666)
        except OSError as error:
            raise SinkError(f"can't make the lock file {path}: {error.strerror}") from error
        try:
            _lock(self._file)
        except OSError as error:
            self._file.seek(1)
            owner = printable(self._file.read(20).decode(errors="replace").strip())
            self._file.close()
            raise SinkError(
                f"{bus} is in use by another run of smooth-operator"
                + (f" (process {owner})" if owner else "")
                + "; end that one first: two programs on one bus would fight over the hand"
            ) from error
        self._file.truncate(1)
        self._file.seek(1)
        self._file.write(str(os.getpid()).encode())
        self._file.flush()

    def release(self) -> None:
        """Give the bus back; a second call does nothing."""
        file, self._file = self._file, None
        if file is not None:
            file.close()  # the lock ends with it


def _lock(file: IO[bytes]) -> None:
    """Lock the first byte, without waiting.

    Raises:
        OSError: somebody has it.
    """
    file.seek(0, os.SEEK_END)
    if file.tell() == 0:
        file.write(b" ")
        file.flush()
    file.seek(0)
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
