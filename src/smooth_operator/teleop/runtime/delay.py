"""Delay of frames, without a common clock with the tracker."""

from __future__ import annotations

from collections import deque

from smooth_operator.teleop.sources.live import Arrival

_WINDOW_S = 10.0


class TrackerDelay:
    """Delay of each frame above the fastest of the last seconds.

    Two clocks that were never compared show only how the delay varies: the difference of arrival
    and stamp is the delay and a constant, whose smallest value lately stands for the fastest way.
    The window is short enough to follow clocks that drift apart. Stamps of a recording that is
    played at another speed are scaled to ours.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._lowest: deque[tuple[float, float]] = deque()  # (received, difference), both rising

    def see(self, arrival: Arrival) -> None:
        """Take note of a frame."""
        if arrival.session != self._session:
            self._session = arrival.session
            self._lowest.clear()
        difference = _difference(arrival)
        while self._lowest and self._lowest[-1][1] >= difference:
            self._lowest.pop()
        self._lowest.append((arrival.received, difference))
        while self._lowest[0][0] < arrival.received - _WINDOW_S:
            self._lowest.popleft()

    def above_fastest(self, arrival: Arrival) -> float:
        """[s]; of a frame that was seen."""
        return _difference(arrival) - self._lowest[0][1]


def _difference(arrival: Arrival) -> float:
    """Of the two clocks at an arrival, and the delay [s]."""
    return arrival.received - arrival.stamp / arrival.speed
