"""Load of the machine during a latency measurement."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Final

_STAT: Final = Path("/proc/stat")
_IDLE: Final = (3, 4)  # idle and iowait, among the numbers of the line "cpu"
_GUEST: Final = 8  # from here on counted a second time in user and nice


class Watch:
    """Watches the machine from when it is made."""

    def __init__(self) -> None:
        self._busy = _busy_seconds()
        self._own = time.process_time()
        self._started = time.monotonic()

    def others(self) -> float | None:
        """Share of all cores that other processes took meanwhile, 0 to 1.

        None where the system does not say, or too little time has passed for its clock ticks.
        """
        busy, elapsed = _busy_seconds(), time.monotonic() - self._started
        if busy is None or self._busy is None or elapsed < 0.1:
            return None
        own = time.process_time() - self._own
        share = (busy - self._busy - own) / (elapsed * (os.cpu_count() or 1))
        return float(min(max(share, 0.0), 1.0))

    @staticmethod
    def load() -> float | None:
        """Load average over the last minute; None where the system has none, as Windows."""
        try:
            return os.getloadavg()[0]
        except (AttributeError, OSError):
            return None


def _busy_seconds() -> float | None:
    """CPU time that all processes have taken since the system started [s]; Linux only."""
    try:
        first = _STAT.read_text(encoding="ascii").splitlines()[0].split()
        ticks = [int(number) for number in first[1:]][:_GUEST]
        busy = sum(n for i, n in enumerate(ticks) if i not in _IDLE)
        return busy / float(os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError, AttributeError):
        return None
