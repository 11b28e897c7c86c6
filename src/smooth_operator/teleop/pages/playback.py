"""Playback of one retargeted recording, human and robot, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import HandModelError, RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import Trace
from smooth_operator.metrics.accuracy import PINCH_DISTANCE


@dataclass(frozen=True, eq=False)
class Playback:
    """A run, ready to be drawn.

    Attributes:
        title: shown at the top of the page.
        hand: the robot hand.
        trace: the run, in the palm frame.
        drawn: the same hand on a model with its meshes, with the same joints by name, in any order;
            simple shapes if left out. With it, a switch shows either.
        label: label above the robot; with several robots, the origin of its motion.

    Raises:
        RecordingError: there is no frame.
        HandModelError: the robot's positions are not finite.
    """

    title: str
    hand: Hand
    trace: Trace
    drawn: Hand | None = None
    label: str = "robot"

    def __post_init__(self) -> None:
        if not len(self.trace):
            raise RecordingError("there is nothing to play: the run has no frame")
        for name in ("joint_positions", "robot_tips", "robot_wrist"):
            if not np.isfinite(getattr(self.trace, name)).all():
                raise HandModelError(f"{name} holds NaN or infinity; hold the last good value")

    def __len__(self) -> int:
        return len(self.trace)

    @property
    def times(self) -> Float[np.ndarray, " T"]:
        """(T,) seconds since the first frame."""
        return np.asarray(self.trace.stamps - self.trace.stamps[0])

    @property
    def tips(self) -> list[int]:
        """Landmarks of the human fingertips that the robot's follow, thumb first."""
        return [TIPS[FINGERS.index(name)] for name in self.trace.fingers]

    def pinches(self) -> Bool[np.ndarray, "T G"]:
        """(T, F-1) True where the human pinches: gap under ``PINCH_DISTANCE``."""
        tips = self.trace.human_tips
        # NaN compares False: a lost hand never pinches
        gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
        return np.asarray(gaps < PINCH_DISTANCE)


def check_runs(runs: Sequence[Playback]) -> None:
    """Looks whether runs can be shown side by side.

    Raises:
        RecordingError: there is none, or they are not of the same frames and fingers.
    """
    if not runs:
        raise RecordingError("there is nothing to play: give one run or more")
    first = runs[0]
    for run in runs[1:]:
        if not np.array_equal(run.trace.stamps, first.trace.stamps):
            raise RecordingError(
                f"{run.label!r} has {len(run)} frames and {first.label!r} {len(first)}, or their "
                "time stamps differ: retarget the same frames of one recording with both"
            )
        mine, theirs = (", ".join(each.trace.fingers) for each in (run, first))
        if mine != theirs:
            raise RecordingError(
                f"{run.label!r} drives {mine}, but {first.label!r} {theirs}: give runs of the same "
                "fingers"
            )


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
