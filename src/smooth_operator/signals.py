"""Ends the program cleanly on operating-system signals: Ctrl-C, kill, a closed terminal."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import stat
import sys
import threading
import time

TYPE_CHECKING = False  # as typing's, whose import Ctrl-C would interrupt with a traceback
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType
    from typing import Final

_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGBREAK")
ENDING: Final = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))
"""Ctrl-C, kill, a closed terminal, Ctrl-\\, and Windows' Ctrl-Break and closed window."""

_CLOSING: Final = (2, 5, 6)
"""Windows' events CTRL_CLOSE, CTRL_LOGOFF and CTRL_SHUTDOWN."""


class Ending:
    """Signal handler that ends the program: raises KeyboardInterrupt in the main thread, or calls
    ``quit``.

    A closed terminal sends several signals, and the clean-up that the first one starts must not be
    interrupted by the next one. Therefore, after the first signal, only another Ctrl-C raises.

    Attributes:
        came: True once a signal has arrived.
        quit: called in place of the exception; None to raise.
    """

    def __init__(self) -> None:
        self.came = False
        self.quit: Callable[[], object] | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if number == getattr(signal, "SIGHUP", None):
            _leave_closed_terminal()
        first, self.came = not self.came, True
        if self.quit is not None:
            self.quit()
        elif first or number == signal.SIGINT:
            raise KeyboardInterrupt


@contextlib.contextmanager
def ended_by_signals() -> Iterator[Ending]:
    """Handles signals that end the program while the block runs on the main thread.

    Signals that were ignored when the program started (``nohup``) stay ignored, except SIGINT.
    A nested block uses the same handler.
    """
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():  # which has its own way to end
        yield ending
        return
    if isinstance(outer := signal.getsignal(signal.SIGINT), Ending):
        before_quit, outer.came, outer.quit = outer.quit, False, None
        try:
            yield outer
        finally:
            outer.quit = before_quit
        return
    before = {
        number: signal.signal(number, ending)
        for number in ENDING
        if (handler := signal.getsignal(number)) is not None  # which would be none of Python's
        and (number == signal.SIGINT or handler is not signal.SIG_IGN)
    }
    try:
        with _closed_window():
            yield ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def leave_to_parent() -> None:
    """Ignores a terminal's signals in a child process, because the parent handles them."""
    for number in ENDING:
        if number != signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)


def _leave_closed_terminal() -> None:
    """Redirect the streams of a closed terminal to the null device: writing to them would raise."""
    for stream in (0, 1, 2):
        with contextlib.suppress(OSError):
            if stat.S_ISCHR(os.fstat(stream).st_mode) and not os.isatty(stream):
                nothing = os.open(os.devnull, os.O_RDWR)
                os.dup2(nothing, stream)
                os.close(nothing)


@contextlib.contextmanager
def _closed_window() -> Iterator[None]:
    """On Windows, handle the events of a closing console as SIGBREAK; otherwise do nothing."""
    if sys.platform == "win32":
        import ctypes

        def closed(event: int) -> bool:
            if event not in _CLOSING:
                return False
            _thread.interrupt_main(signal.SIGBREAK)
            time.sleep(30.0)  # the process ends when this returns, or after the system's own 5 s
            return True

        handler = ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)(closed)
        ctypes.windll.kernel32.SetConsoleCtrlHandler(handler, True)
        try:
            yield
        finally:
            ctypes.windll.kernel32.SetConsoleCtrlHandler(handler, False)
    else:
        yield
