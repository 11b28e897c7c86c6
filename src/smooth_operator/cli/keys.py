"""Single keys from the terminal while something runs."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping


@contextlib.contextmanager
def keys(actions: Mapping[str, Callable[[], None]]) -> Iterator[bool]:
    """Runs actions as keys are pressed, without waiting for a line.

    Args:
        actions: key -> what to do, on a thread of this function's.

    Yields:
        whether there is a terminal to press keys on; the terminal is put back at the end.
    """
    if not sys.stdin or not sys.stdin.isatty():
        yield False
        return
    done = threading.Event()

    def listen(read: Callable[[float], str]) -> None:
        while not done.is_set():
            action = actions.get(read(0.1))
            if action is not None:
                action()

    with _reader() as read:
        thread = threading.Thread(target=listen, args=(read,), name="keys", daemon=True)
        thread.start()
        try:
            yield True
        finally:
            done.set()
            thread.join(1.0)


@contextlib.contextmanager
def _reader() -> Iterator[Callable[[float], str]]:
    """How to wait a while for a key; the terminal hands them over one by one meanwhile."""
    if sys.platform == "win32":
        import msvcrt

        def read(seconds: float) -> str:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                if msvcrt.kbhit():
                    return msvcrt.getwch()
                time.sleep(0.01)
            return ""

        yield read
    else:
        import os
        import select
        import termios
        import tty

        terminal = sys.stdin.fileno()
        before = termios.tcgetattr(terminal)

        def read(seconds: float) -> str:
            ready, _, _ = select.select([terminal], [], [], seconds)
            return os.read(terminal, 1).decode(errors="ignore") if ready else ""

        try:
            tty.setcbreak(terminal)  # Ctrl-C stays a signal
            yield read
        finally:
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
