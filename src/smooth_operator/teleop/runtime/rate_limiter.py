"""Rate limiter of a hand's commands.

Frames are answered as they come, the pace is kept where none come, and the rate is never exceeded.
"""

from __future__ import annotations

import math
from typing import Final

SHORTEST: Final = 0.25
"""Shortest time between two commands, over the period."""
BORROWED: Final = 1.0 - SHORTEST
"""How much earlier than in an even pace a frame may be answered, over the period: its turn is taken
from the commands after it. It keeps frames that come between two commands of the pace from
waiting."""
KEPT: Final = 0.5
"""How much of the time that a command came late may be made up for, over the period: a frame that
was late does not delay those after it."""
WAITS: Final = 0.1
"""Longest wait of a frame for its turn, over the period: one that would wait for longer is replaced
by the next one, if no turn is lost by that. A tracker at the rate that has lost its phase, such as
after a stall, so gets it back for one frame, and does not keep that wait for the rest of the run.
"""
LONGEST: Final = 2.0
"""Longest time between two commands, over the period."""
EXTRA: Final = 1 + BORROWED + KEPT
"""Commands over the rate: within any time t there are at most rate x t + 2.25."""


class RateLimiter:
    """When the commands of one hand leave.

    Commands have turns, a period apart. A frame may take one early and a command may take one late,
    within bounds that don't add up: in any time t there are at most ``t / period + EXTRA``
    commands, two are at least ``SHORTEST`` periods apart, and over a run the rate is never
    exceeded. This is the generic cell rate algorithm (ITU-T I.371), in which frames may come early
    and commands that only keep the pace may not.

    All times are by one clock [s]. Nothing here has a clock or sleeps.

    Args:
        period: time between two commands [s]; may be changed at any time.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._last = -math.inf  # when the latest command left
        self._turn = -math.inf  # when the next one does, at an even pace

    def begin(self, now: float) -> None:
        """The loop starts: a frame may be answered now."""
        self._turn = now + BORROWED * self.period

    @property
    def opens(self) -> float:
        """Until when nothing may leave, but for an emergency stop [s]."""
        period = self.period
        return max(self._turn - BORROWED * period, self._last + SHORTEST * period)

    def answers(self, received: float, following: float | None) -> float:
        """When a frame is to be answered, if no newer one comes until then [s].

        A frame that comes after the turn has begun is answered as it comes. One that came before,
        by more than ``WAITS``, is replaced by the next frame if that comes so soon after the
        beginning that no turn is lost.
        So of a tracker that is faster than the pace, the frames that are answered are fresh.

        Args:
            received: when it came [s].
            following: when the next frame is expected [s]; None if unknown.
        """
        opens, latest = self.opens, self._last + LONGEST * self.period
        if received >= opens:
            return received
        waits = opens - received > WAITS * self.period
        if (
            following is None
            or not 0 <= following - opens <= (1.0 if waits else KEPT) * self.period
        ):
            return opens
        patience = SHORTEST * (following - received)  # trackers are uneven
        return min(following + patience, latest) if following <= latest else opens

    def keeps(self, following: float | None) -> float:
        """When a command is due though no frame has come [s].

        Args:
            following: when the next frame is expected [s]; None if unknown. If that is about
                now the command waits for it a little, rather than leave just before it.
        """
        period, at = self.period, self._turn
        if following is not None and at - SHORTEST * period <= following <= at + KEPT * period:
            latest = max(at, self._last + LONGEST * period)
            at = min(following + SHORTEST * period, latest)
        return max(at, self.opens)

    def take(self, now: float) -> None:
        """A command leaves now [s]."""
        period = self.period
        turn = max(self._turn, now - KEPT * period) + period
        # An emergency stop, which waits for no turn, delays what comes after it only so far.
        self._turn, self._last = min(turn, now + LONGEST * period), now
