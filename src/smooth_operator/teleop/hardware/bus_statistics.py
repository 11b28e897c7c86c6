"""Counts and times of a worker's cycles on a bus."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

_KEPT: Final = 20_000


class BusStatistics:
    """What happened on a bus; written by its worker, read by anyone.

    Attributes:
        cycles: how many there were.
        wrong: exchanges that failed: no answer in time, wrong checksum, nonsense.
        slow: cycles that took longer than their period.
        lost: how often the device was gone.
        silences: how often commands stopped.
        not_finite: commands with a NaN or an infinity, in whose place the last one was held.
        latest: the last failure, a sentence; empty if there was none.
    """

    def __init__(self) -> None:
        self.cycles = self.wrong = self.slow = self.lost = self.silences = 0
        self.not_finite = 0
        self.latest = ""
        self._times = np.full(_KEPT, np.nan, np.float32)

    def add(self, seconds: float, period: float) -> None:
        """A cycle that took so long [s]."""
        self._times[self.cycles % _KEPT] = seconds * 1e3
        self.cycles += 1
        self.slow += seconds > period

    def summary(self) -> dict[str, Any]:
        """Plain values; times of the last cycles in ms."""
        times = self._times[np.isfinite(self._times)]
        found: dict[str, Any] = {
            "cycles": self.cycles,
            "wrong_answers": self.wrong,
            "slow_cycles": self.slow,
            "device_lost": self.lost,
            "silences": self.silences,
            "commands_not_finite": self.not_finite,
        }
        if len(times):
            p50, p99 = np.percentile(times, (50, 99))
            found["cycle_ms"] = {"p50": float(p50), "p99": float(p99), "max": float(times.max())}
        return found
