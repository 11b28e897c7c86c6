"""When frames may be answered: commands keep their pace though trackers don't keep theirs."""

from __future__ import annotations

import math
from typing import Final

PLAY: Final = 0.8
"""Shortest time between two frames that are answered, over the period: trackers are uneven."""
CATCH_UP: Final = 0.25
"""The same for a frame that comes on time after one that was late: its turn is now."""


class Turns:
    """Turns of one hand, a period apart.

    One that is taken late, by up to a period, leaves the next where it was, so that a frame which
    was held up does not hold up the one behind it. So frames that come faster than the pace are
    thinned out evenly, and those that come at the pace are all answered as they come.
    """

    def __init__(self) -> None:
        self._taken, self._next = -math.inf, math.inf

    def opens(self, period: float) -> float:
        """When the next frame may be answered [s].

        Args:
            period: of the loop [s].
        """
        early = self._taken + PLAY * period
        return min(early, max(self._next, self._taken + CATCH_UP * period))

    def take(self, now: float, period: float) -> None:
        """A frame is answered now [s]."""
        self._next = min(max(self._next, now - period), now) + period
        self._taken = now
