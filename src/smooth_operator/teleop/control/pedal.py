"""Reads a foot pedal on Linux: the keys of one input device, whichever window has focus."""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, SourceError
from smooth_operator.teleop.control.switches import background

# Linux: include/uapi/linux/input.h, input-event-codes.h, Documentation/input/input.rst.
_EVENT: Final = struct.Struct("@llHHi")  # seconds, microseconds, type, code, value
_KEY: Final = 1  # the type EV_KEY
_PRESSED: Final = 1  # 0 is a release, 2 a repetition
_GRAB: Final = 0x40044590  # EVIOCGRAB
_AGAIN_S: Final = 1.0


@contextlib.contextmanager
def pedal(
    path: Path, press: Callable[[str], None], known: Collection[str], say: Callable[[str], None]
) -> Iterator[None]:
    """Passes on the keys of an input device, such as a foot pedal, while the block runs.

    The device types nothing elsewhere meanwhile. If it is unplugged, it is opened again as soon as
    it is back.

    Args:
        path: the device, such as ``/dev/input/by-id/usb-...-event-kbd``.
        press: called with ``pedal:CODE`` for each pressed key, on a thread of this function.
        known: inputs that have an action; the operator is told about others.
        say: shows a line to the operator.

    Raises:
        ConfigError: this is not Linux.
        SourceError: the device can't be opened.
    """
    if sys.platform != "linux":
        raise ConfigError(
            "--pedal reads a Linux input device; on this system, bind the key that the pedal "
            "types, such as --bind record=b, and keep the focus on the terminal or the page"
        )
    first = _open(path)

    def read(device: int, over: threading.Event) -> None:
        """Pass on keys until the device or the block ends."""
        while not over.is_set():
            if not select.select([device], [], [], 0.1)[0]:
                continue
            if not (data := os.read(device, _EVENT.size)):
                return
            *_, kind, code, value = _EVENT.unpack(data)  # the kernel gives whole events
            if (kind, value) == (_KEY, _PRESSED):
                if (name := f"pedal:{code}") not in known:
                    say(f"this pedal has no action; to give it one: --bind ACTION={name}")
                press(name)

    def work(over: threading.Event) -> None:
        device = first
        while True:
            with contextlib.suppress(OSError):
                read(device, over)
            os.close(device)
            if over.is_set():
                return
            say(f"{path}: the pedal was disconnected")
            while not over.wait(_AGAIN_S):
                with contextlib.suppress(SourceError):
                    device = _open(path)
                    say(f"{path}: the pedal is connected again")
                    break
            else:
                return

    with background("pedal", work):
        yield


def _open(path: Path) -> int:
    import fcntl

    try:
        device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise SourceError(
            f"the pedal {path} can't be opened: {error.strerror}; expected an input device such as "
            "/dev/input/by-id/usb-...-event-kbd, which members of the group input can read"
        ) from error
    with contextlib.suppress(OSError):  # another program has grabbed it, and may let it go
        fcntl.ioctl(device, _GRAB, 1)
    return device
