"""Faults of a tracker, injected on purpose for tests."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

from smooth_operator.errors import ConfigError
from smooth_operator.synthetic.settings import check_range

_SHARES: Final = ("drop", "missing", "duplicate", "reorder", "swap", "garbage")


@dataclass(frozen=True)
class GloveFaults:
    """Faults of a glove or its bridge; none by default. Shares are of the ticks, drawn at random.

    Attributes:
        drop: share of ticks whose messages are never sent.
        silence_every: every so often the glove falls silent [s]; 0 is never.
        silence: for so long [s].
        missing: share of ticks with missing nodes: a finger, or the whole hand, by turns.
        duplicate: share of ticks that repeat the stamp of the one before.
        reorder: share of ticks whose messages are sent after those of the next tick.
        swap: share of ticks with the hands' sides exchanged.
        garbage: share of ticks whose messages are cut off in the middle.
        restart_every: time between restarts of the glove [s]: another session, stamps from 0;
            0 is never.

    Raises:
        ConfigError: a figure is outside its range.
    """

    drop: float = 0.0
    silence_every: float = 0.0
    silence: float = 2.0
    missing: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    swap: float = 0.0
    garbage: float = 0.0
    restart_every: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            share = field.name in _SHARES
            check_range(
                field.name, getattr(self, field.name), 0.0, 1.0 if share else math.inf,
                "" if share else "s",
            )  # fmt: skip
        if 0.0 < self.silence_every <= self.silence:
            raise ConfigError(
                f"silence_every must be longer than the silence of {self.silence:g} s, not "
                f"{self.silence_every:g} s"
            )

    def silent_at(self, time: float) -> bool:
        """Whether it is silent at a time since the start [s]: at the end of each stretch."""
        if not self.silence_every:
            return False
        return time % self.silence_every >= self.silence_every - self.silence
