"""Lock of a bus, so that two programs never command one hand."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import socket
import stat
import sys
import zlib
from pathlib import Path
from typing import Final

from smooth_operator.errors import SinkError, require
from smooth_operator.terminal import printable

_FLAGS: Final = sum(getattr(os, f"O_{name}", 0) for name in ("NOFOLLOW", "NONBLOCK", "BINARY"))
"""Flags of a lock file. In a folder that all users can write, a link could lead to any file, and
opening a pipe could hang."""

_SLOTS: Final = 1 << 16
"""Number of bytes that a lock covers on Windows; a shared lock covers one of them."""


def bus_name(bus: str) -> str:
    """Canonical name of a bus.

    Args:
        bus: a serial port (links are followed); ``tcp:HOST:PORT``; ``can:INTERFACE:CHANNEL``; or
            any ``KIND:PLACE``. A ``KIND`` alone may be any place of that kind.

    Returns:
        ``KIND:PLACE``, or ``KIND``.
    """
    kind, _, place = bus.partition(":")
    if kind == "tcp":
        host, _, port = place.rpartition(":")
        return f"tcp:{_address(host)}:{port.lstrip('0')}"
    if kind == "can":
        interface, _, channel = place.partition(":")
        adapter = channel.partition("@")[0]  # slcan's baud rate follows
        return serial if (serial := _serial(adapter)) else f"can:{interface.lower()}:{channel}"
    return _serial(bus) or bus


def _serial(port: str) -> str:
    """Name of a serial port; empty for anything else."""
    if not is_serial(port):
        return ""
    if "/" not in port:
        return "serial:" + port.upper().removeprefix("\\\\.\\")
    path = os.path.realpath(port)
    return "serial:" + (path.replace("/dev/tty.", "/dev/cu.") if sys.platform == "darwin" else path)


def _address(host: str) -> str:
    """Network address of a host, IPv4 if it has one; the host itself if it has none."""
    try:
        answers = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return host.lower()
    addresses = sorted((family != socket.AF_INET, str(to[0])) for family, _, _, _, to in answers)
    return addresses[0][1]


def lock_folder() -> Path:
    """Folder of the locks: the same for all users, independent of ``TMPDIR``."""
    if sys.platform == "win32":
        return Path(os.environ.get("PROGRAMDATA", r"C:\ProgramData"))
    shared = Path("/run/lock")  # which systemd's PrivateTmp leaves as it is
    try:
        mode = shared.stat().st_mode
    except OSError:
        mode = 0
    return shared if mode & stat.S_ISVTX and mode & stat.S_IWOTH else Path("/tmp")


class BusLock:
    """Lock of a bus until ``release``; the system releases it when the process dies.

    It works among programs of this package on this machine, for all users. Drivers also open
    serial ports exclusively, which excludes other programs.

    Args:
        bus: the bus; see ``bus_name``. A kind without a place is locked against every place of that
            kind.

    Raises:
        SinkError: another program, or this one, has the lock.
    """

    def __init__(self, bus: str) -> None:
        self.bus = bus
        self._files: list[int] = []
        name = bus_name(bus)
        kind, _, place = name.partition(":")
        try:
            self._lock(kind, name if place else "")
            if place:
                self._lock(name, "")
        except SinkError:
            self.release()
            raise

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
        while self._files:
            os.close(self._files.pop())  # the lock ends with it

    def _lock(self, name: str, sharer: str) -> None:
        """Lock the file of a name, without waiting; with ``sharer`` together with others."""
        path = lock_folder() / (
            f"smooth-operator-{hashlib.sha256(name.encode()).hexdigest()[:16]}.lock"
        )
        try:
            file = _open(path)
        except OSError as error:
            raise SinkError(
                f"can't use the lock file {path}: {error.strerror}; remove it if no program uses "
                f"{self.bus}"
            ) from error
        self._files.append(file)
        try:
            _lock_file(file, sharer)
        except OSError as error:
            os.lseek(file, 1, os.SEEK_SET)
            owner = printable(os.read(file, 20).decode(errors="replace").strip())
            process = f" (process {owner})" if owner else ""
            raise SinkError(
                f"{self.bus} is in use by another run of smooth-operator{process}; end that "
                "run first: two programs on one bus would send conflicting commands"
                if ":" in name
                else (
                    f"another run of smooth-operator{process} uses a hand that may be on "
                    f"{self.bus}; name the port or serial number of both hands, or end that run "
                    "first"
                )
            ) from error
        try:
            os.lseek(file, 0, os.SEEK_SET)
            os.write(file, b" " if sharer else f" {os.getpid()}".encode())
            os.ftruncate(file, os.lseek(file, 0, os.SEEK_CUR))
        except OSError:  # a file of another user can be locked, but not written
            return


def _open(path: Path) -> int:
    """Descriptor of a lock file, which is created if missing."""
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _FLAGS, 0o666)
        if hasattr(os, "fchmod"):
            os.fchmod(file, 0o666)  # whatever the umask is: other users lock it, too
    except FileExistsError:
        try:  # without O_CREAT, which fs.protected_regular refuses for another user's file
            file = os.open(path, os.O_RDWR | _FLAGS)
        except PermissionError:
            file = os.open(path, os.O_RDONLY | _FLAGS)
    status = os.fstat(file)
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        os.close(file)
        raise OSError(errno.EINVAL, "it is a link or not a file")
    return file


def _lock_file(file: int, sharer: str) -> None:
    """Lock a file, without waiting; ``sharer`` does so together with those of other names."""
    if sys.platform == "win32":
        import msvcrt

        # Bytes far behind the process number: a locked one can't be read there.
        slot = zlib.crc32(sharer.encode()) % _SLOTS if sharer else 0
        os.lseek(file, _SLOTS + slot, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1 if sharer else _SLOTS)
    else:
        import fcntl

        fcntl.flock(file, (fcntl.LOCK_SH if sharer else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def is_serial(port: str) -> bool:
    """True if a name is one of a serial port, a path or ``COM3``, and not an address."""
    return "/" in port or bool(re.fullmatch(r"(\\\\\.\\)?COM\d+", port, re.IGNORECASE))


def serial_ports() -> dict[str, str]:
    """Serial port of a USB adapter -> its description; empty without pyserial."""
    try:
        from serial.tools import list_ports
    except ImportError:
        return {}
    return {
        port.device: port.description or port.hwid
        for port in sorted(list_ports.comports(), key=lambda port: port.device)
        if port.vid is not None
    }


def only_port(driver: str, extra: str) -> str:
    """Finds the only USB serial port of this machine.

    Raises:
        MissingExtraError: pyserial is not installed.
        SinkError: there is none, or more than one.
    """
    require(f"the driver {driver}", extra, "serial")
    ports = serial_ports()
    if len(ports) == 1:
        return next(iter(ports))
    names = ", ".join(ports) or "none"
    raise SinkError(
        f"{driver}: name the serial port, such as {driver}:/dev/ttyUSB0; available ports: "
        f"{names}. Check cable and power if the hand is not among them"
    )
