"""The synthetic operator as a live source: ``synthetic``."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from smooth_operator.synthetic.gestures import GESTURES
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.synthetic.tracker import TrackerModel, WristMotion, check_range
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource, on_time
from smooth_operator.teleop.sources.stream import Hands, sides_of
from smooth_operator.types import HandFrame, Side

WORLD: Final = "synthetic"
_HANDS_AT: Final[dict[Side, np.ndarray]] = {
    "right": np.array([0.4, -0.2, 1.0]),
    "left": np.array([0.4, 0.2, 1.0]),
}


@dataclass(frozen=True)
class SyntheticSource(ThreadedSource):
    """Live source with a synthetic person in front of a synthetic tracker.

    Both hands belong to one person and mirror each other; their trackers lose different frames.

    Attributes:
        seed: seed of the person, the motion and the tracker's losses.
        rate: frame rate of each hand [Hz].
        side: ``right``, ``left`` or ``both``.
        gestures: names joined by ``+``, as ``pinch_index+spread``; by default all of them.
        speed: tempo of the operator, 1 is natural.
        noise: standard deviation of each coordinate [mm].
        frame_loss: share of frames that never come, in bursts.
        landmark_loss: share of landmarks that are missing, in bursts.
        rate_jitter: standard deviation of a frame's time over the period.
        duration: length of the motion [s]; None for an endless one.
        wrist: standard deviation of each coordinate of the wrist in the room [m], 1 m up and 0.4 m
            ahead; 0 is a tracker without a wrist. The landmarks do not move with it.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no gesture of a name.
    """

    seed: int = 0
    rate: float = 100.0
    side: Hands = "right"
    gestures: str | None = None
    speed: float = 1.0
    noise: float = 0.0
    frame_loss: float = 0.0
    landmark_loss: float = 0.0
    rate_jitter: float = 0.0
    duration: float | None = None
    wrist: float = 0.05

    def __post_init__(self) -> None:
        sides_of(self.side)
        self._operators()  # which check the rest
        check_range("wrist", self.wrist, 0.0, 0.3, "m")
        if self.duration is not None:
            check_range("duration", self.duration, 1.0 / self.rate, 1e9, "s")

    @property
    def label(self) -> str:
        """Name for a person, in a few words."""
        return "the built-in operator"

    def run(self, running: Running) -> None:
        """Post the frames when they are due."""
        hands = " and ".join(sides_of(self.side))
        running.health = SourceHealth("running", f"{hands} hand at {self.rate:g} Hz")
        clock = running.mailbox.clock
        wrists = self._wrists()
        for _, frame in on_time(self._due(), clock, running.stopping):
            if self.wrist:
                pose = wrists[frame.side].pose_at(frame.time)
                pose[:3] += _HANDS_AT[frame.side]
                frame = replace(frame, T_world_wrist=pose, world=WORLD)
            running.mailbox.post(frame)

    def _due(self) -> Iterator[tuple[float, HandFrame]]:
        streams = [operator.frames(self.duration) for operator in self._operators()]
        for frame in heapq.merge(*streams, key=lambda frame: frame.time):
            yield frame.time, frame

    def _wrists(self) -> dict[Side, WristMotion]:
        turn = 4.0 * self.wrist  # [rad] for [m]: 0.2 rad for 5 cm
        sides = sides_of(self.side)
        return {side: WristMotion(self.wrist, turn, self.seed + k) for k, side in enumerate(sides)}

    def _operators(self) -> list[SyntheticOperator]:
        names = tuple(self.gestures.split("+")) if self.gestures else GESTURES
        return [self._operator(side, names, k) for k, side in enumerate(sides_of(self.side))]

    def _operator(self, side: Side, gestures: tuple[str, ...], number: int) -> SyntheticOperator:
        return SyntheticOperator(
            seed=self.seed,
            side=side,
            rate_hz=self.rate,
            gestures=gestures,
            speed=self.speed,
            tracker=TrackerModel(
                noise=self.noise * 1e-3,
                rate_jitter=self.rate_jitter,
                frame_loss=self.frame_loss,
                landmark_loss=self.landmark_loss,
                seed=self.seed + number,
            ),
        )
