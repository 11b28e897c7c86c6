"""Real-time playback of stamped frames: which frame is due now."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


class PlaybackClock:
    """Maps wall time to frames of a recording; frames are dropped, time is never stretched.

    Args:
        times: (T,) strictly increasing times of the frames [s].
        speed: playback seconds per wall second, > 0.
        loop: start over after the last frame.
    """

    def __init__(
        self, times: Float[np.ndarray, " T"], speed: float = 1.0, loop: bool = True
    ) -> None:
        self._times = np.asarray(times, np.float64) - times[0]
        # the last frame is shown for as long as a usual one, so a loop has no hiccup
        period = float(np.median(np.diff(self._times))) if len(self._times) > 1 else 0.0
        self._duration = float(self._times[-1]) + period
        self._speed = speed
        self.loop = loop
        self._wall = 0.0
        self._time = 0.0

    @property
    def speed(self) -> float:
        """Playback seconds per wall second."""
        return self._speed

    def start(self, frame: int, now: float) -> None:
        """Let ``frame`` be the one that is due at wall time ``now`` [s]."""
        self._time, self._wall = float(self._times[frame]), now

    def set_speed(self, speed: float, now: float) -> None:
        """Change the speed from ``now`` [s] on, without a jump."""
        self._time += (now - self._wall) * self._speed
        self._wall, self._speed = now, speed

    def frame(self, now: float) -> tuple[int, bool]:
        """The frame that is due at wall time ``now`` [s], and whether playback has ended."""
        time = self._time + (now - self._wall) * self._speed
        if time >= self._duration:
            if not self.loop or self._duration <= 0.0:
                return len(self._times) - 1, True
            time %= self._duration
        return max(int(np.searchsorted(self._times, time, side="right")) - 1, 0), False
