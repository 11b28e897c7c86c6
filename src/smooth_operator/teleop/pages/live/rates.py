"""Events per second, from a count that is read occasionally."""

from __future__ import annotations


class RateMeter:
    """Measures the rate of a count over a window of time.

    Args:
        window: least time over which it is measured [s].

    Attributes:
        rate: of the last whole window [Hz]; None before there is one.
    """

    def __init__(self, window: float) -> None:
        self.rate: float | None = None
        self._window = window
        self._start: tuple[int, float] | None = None

    def count(self, number: int, time: float) -> None:
        """Take note of the count.

        Args:
            number: how many there have been.
            time: of that, by a clock that never goes back [s].
        """
        if self._start is None:
            self._start = number, time
        elif time - self._start[1] >= self._window:
            self.rate = round((number - self._start[0]) / (time - self._start[1]), 1)
            self._start = number, time
