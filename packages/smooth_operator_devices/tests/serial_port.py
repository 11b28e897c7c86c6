"""The far end of a serial port, on a pseudo-terminal that a thread reads."""

import contextlib
import os
import select
import threading
from collections.abc import Callable


class SerialPort:
    """A pseudo-terminal: ``path`` is the port that a driver opens.

    Only the thread uses the descriptors, and closes them at its end, once. Were they closed from
    another thread, a read would take the bytes of whatever file gets their numbers next.

    Args:
        take: called with the bytes that came; on silence, with none, every 20 ms.
    """

    def __init__(self, take: Callable[[bytes], None]) -> None:
        import tty

        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._take = take
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Answer; called by ``take``."""
        os.write(self._master, data)

    def close(self) -> None:
        """Pull the cable; a second call does nothing."""
        self._closing.set()
        self._thread.join()

    def _serve(self) -> None:
        try:
            while not self._closing.is_set():
                ready, _, _ = select.select([self._master], [], [], 0.02)
                with contextlib.suppress(OSError):  # EIO: no client has opened it
                    self._take(os.read(self._master, 4096) if ready else b"")
        finally:
            os.close(self._slave)
            os.close(self._master)
