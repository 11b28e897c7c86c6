"""Signals of the operating system that end a loop in order."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from smooth_operator.teleop.runtime.controls import Controls


@contextlib.contextmanager
def ended_by_signals(controls: Controls) -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM end the loop in order."""
    came = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        came.set()
        controls.quit()

    # Only the main thread may; elsewhere the caller has its own way to end.
    main = threading.current_thread() is threading.main_thread()
    before = {n: signal.signal(n, end) for n in (signal.SIGINT, signal.SIGTERM)} if main else {}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
