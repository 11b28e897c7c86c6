"""Stamps of several trackers' clocks on the loop's one, so that a log can hold them all."""

from __future__ import annotations

import math
from typing import Final

from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import HandFrame

_STEP: Final = 2e-6
"""What separates stamps that would be the same or go back [s]."""

_FORGET: Final = 0.9995
"""How much of the latest lateness is remembered from one frame to the next."""


class StampMap:
    """Stamps for the log of one hand: by the loop's clock, and strictly increasing.

    A frame is stamped by its tracker, whose clock restarts with every start; a command that
    answers no frame has the loop's own time. Each start of the tracker is shifted by one constant,
    reception minus stamp of its first frame, so that differences of stamps within it are the
    tracker's own. A jump of the stamps counts as a start
    (``JUMP_S``), so that one bad stamp moves no others. Commands
    without a frame are put earlier by as much as the last frames came late, so that they do not
    get a later stamp than the next frame.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._shift = self._late = 0.0
        self._last = -math.inf

    def __call__(self, tick: Tick) -> tuple[float, HandFrame | None]:
        """The stamp of a tick's command, and the frame that is to have the same."""
        arrival = tick.arrival
        stamp = math.nan if arrival is None else arrival.stamp
        if arrival is None or not math.isfinite(stamp):
            return self._next(tick.time - self._late), None
        if arrival.session != self._session:
            self._session = arrival.session
            self._shift, self._late = arrival.received - stamp, 0.0
        stamp += self._shift
        self._late = max(arrival.received - stamp, _FORGET * self._late)
        return self._next(stamp), arrival.frame

    def _next(self, stamp: float) -> float:
        self._last = max(stamp, self._last + _STEP)
        return self._last
