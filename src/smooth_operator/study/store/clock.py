"""Clock of a store: durations do not depend on changes of the machine's clock.

The time of day jumps when a person or a time server sets it. A steady clock never does, but it
starts from zero with the machine. So a program takes the time of day at its start, and adds what
the steady clock has counted since. What is timed (a trial, free movement) is stored with a reading
of the steady clock, so that a program that is started later can continue it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

_STEP_S: Final = 1.0
"""A difference between two clocks that is called a step [s]; a time server slews smaller ones."""


def _steady() -> float:
    """Seconds that never jump, sleep of the machine included where the system counts it."""
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if boot is None else time.clock_gettime(boot)


def _boot() -> str:
    """An identifier of this start of this machine; empty where the system has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    except OSError:
        return ""


@dataclass(frozen=True)
class Elapsed:
    """A duration and the doubts about it.

    Attributes:
        seconds: negative where nothing but a clock that was set back explains it.
        doubt: why that may be wrong, or how the time of day disagrees, in a sentence; empty if
            there is nothing to say.
    """

    seconds: float
    doubt: str = ""


class Clock:
    """Moments of one program.

    Args:
        wall: the time of day [s since 1970].
        steady: a clock that never jumps [s].
        boot: of the machine; readings of another one can't be gone on from.
    """

    def __init__(
        self,
        wall: Callable[[], float] = time.time,
        steady: Callable[[], float] = _steady,
        boot: str | None = None,
    ) -> None:
        self._wall, self._steady = wall, steady
        self._boot = boot if boot is not None else _boot() or f"{time.time_ns():x}"
        self._begun = (wall(), steady())
        self._known_step = 0.0

    def now(self) -> datetime:
        """This moment, in UTC: later than all before, whatever the machine's clock does."""
        wall, steady = self._begun
        passed = timedelta(seconds=self._steady() - steady)
        return datetime.fromtimestamp(wall, UTC) + passed

    def seconds(self) -> float:
        """The steady clock [s]: for durations within this program."""
        return self._steady()

    def reading(self) -> str:
        """The steady clock, to be stored."""
        return f"{self._boot} {self._steady():.3f}"

    def since(self, at: datetime, reading: str) -> Elapsed:
        """The time since a moment.

        Args:
            at: when it was written down.
            reading: of the steady clock then; empty if there is none.
        """
        by_day = (self.now() - at).total_seconds()
        seconds = self._passed(reading)
        if seconds is None:
            text = "timed by the time of day, as the machine or the console was started again"
            return Elapsed(by_day, text)
        step = by_day - seconds
        if abs(step) < _STEP_S:
            return Elapsed(seconds)
        text = f"the machine's clock was set by {step:+.0f} s meanwhile; timed by a steady clock"
        return Elapsed(seconds, text)

    def _passed(self, reading: str) -> float | None:
        boot, _, value = reading.partition(" ")
        try:
            return self._steady() - float(value) if boot == self._boot else None
        except ValueError:
            return None

    def step(self) -> float:
        """By how much the machine's clock was set since this was asked last [s]; 0 if it wasn't."""
        wall, steady = self._begun
        off = self._wall() - wall - (self._steady() - steady)
        step = off - self._known_step
        if abs(step) < _STEP_S:
            return 0.0
        self._known_step = off
        return step
