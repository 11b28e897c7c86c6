"""Clock of a store, whose durations don't depend on changes of the machine's clock.

The time of day jumps when a person or a time server sets it. A steady clock never jumps, but starts
at zero with the machine. A program takes the time of day at its start and adds the seconds that the
steady clock has counted since. Trials, pauses and free movement are stored with a reading of the
steady clock, so that a program that is started later can continue them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

_STEP_S: Final = 1.0
"""Smallest difference of two clocks that is called a step [s]; a time server corrects smaller
differences gradually."""


def _steady() -> float:
    """Seconds that never jump; includes sleep of the machine where the system counts it."""
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if boot is None else time.clock_gettime(boot)


def _boot() -> str:
    """Identifier of this start of the machine; empty where the system has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    except OSError:
        return ""


@dataclass(frozen=True)
class Elapsed:
    """Elapsed time and its uncertainty.

    Attributes:
        seconds: elapsed time; negative only where a clock was set back.
        doubt: sentence that says why the time may be wrong, or how the time of day disagrees;
            empty if both clocks agree.
    """

    seconds: float
    doubt: str = ""


class Clock:
    """Times and durations of one program.

    Args:
        wall: time of day [s since 1970].
        steady: clock that never jumps [s].
        boot: identifier of the start of the machine; readings of another start can't be used.
    """

    def __init__(
        self,
        wall: Callable[[], float] = time.time,
        steady: Callable[[], float] = _steady,
        boot: str | None = None,
    ) -> None:
        self._wall, self._steady = wall, steady
        self._boot = boot if boot is not None else _boot() or f"{time.time_ns():x}"
        self._start = (wall(), steady())
        self._reported_offset = 0.0

    def now(self) -> datetime:
        """Returns this moment in UTC, later than all before even if the machine's clock is set."""
        wall, steady = self._start
        return datetime.fromtimestamp(wall, UTC) + timedelta(seconds=self._steady() - steady)

    def seconds(self) -> float:
        """Returns the steady clock [s], for durations within this program."""
        return self._steady()

    def reading(self) -> str:
        """Returns the steady clock and the start of the machine as text for the store."""
        return f"{self._boot} {self._steady():.3f}"

    def since(self, at: datetime, reading: str) -> Elapsed:
        """Measures the time since a stored moment.

        Args:
            at: stored time of day.
            reading: stored reading of the steady clock; empty if there is none.
        """
        by_day = (self.now() - at).total_seconds()
        seconds = self._since_reading(reading)
        if seconds is None:
            text = "timed by the time of day, as the machine or the console was started again"
            return Elapsed(by_day, text)
        step = by_day - seconds
        if abs(step) < _STEP_S:
            return Elapsed(seconds)
        text = f"the machine's clock was set by {step:+.0f} s meanwhile; timed by a steady clock"
        return Elapsed(seconds, text)

    def _since_reading(self, reading: str) -> float | None:
        boot, _, value = reading.partition(" ")
        try:
            return self._steady() - float(value) if boot == self._boot else None
        except ValueError:
            return None

    def step(self) -> float:
        """Returns the step by which the machine's clock was set since the last call [s]."""
        wall, steady = self._start
        offset = self._wall() - wall - (self._steady() - steady)
        step = offset - self._reported_offset
        if abs(step) < _STEP_S:
            return 0.0
        self._reported_offset = offset
        return step
