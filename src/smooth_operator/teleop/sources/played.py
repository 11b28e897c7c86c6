"""Sources without a tracker: a recording (``replay:FILE``), and the synthetic operator."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.formats.readers import read_recording
from smooth_operator.io.landmark_order import layout_order
from smooth_operator.retargeting.known_gaps import known_gaps
from smooth_operator.settings import check_range
from smooth_operator.synthetic.gestures import GESTURES
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.synthetic.tracker import WristMotion, tracker_model
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource, on_time
from smooth_operator.teleop.sources.stream import Hands, sides_of
from smooth_operator.types import HandFrame, HandRecording, Side

_DEFAULT_PERIOD_S = 0.01  # between the rounds of a recording of a single frame


@dataclass(frozen=True)
class Replay(ThreadedSource):
    """Plays a recording with its own stamps, at any speed.

    When the recording repeats, the stamps keep increasing, and each repetition is a new session,
    since the hand jumps back to its start.

    Attributes:
        path: any file that ``smooth-operator retarget`` reads.
        speed: 1 plays at the recording's own speed, 2 twice as fast.
        loop: repeat the recording endlessly.
        rate: frame rate of a file without stamps [Hz].
        side: side of the hand, for a file that does not store it.
        layout: order of the landmarks in a plain array; None for this project's order.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no such layout.
    """

    path: Path
    speed: float = 1.0
    loop: bool = False
    rate: float | None = None
    side: Literal["right", "left"] | None = None
    layout: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        check_range("speed", self.speed, 0.01, 100.0)
        if self.side not in (None, "right", "left"):
            raise ConfigError(f"side must be 'right' or 'left', not {self.side!r}")
        layout_order(self.layout)

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"replay of {self.path.name}"

    def open(self) -> None:
        """Reads the recording; errors reach the caller."""
        recording = read_recording(self.path, rate=self.rate, side=self.side, layout=self.layout)
        object.__setattr__(self, "_recording", recording)

    def run(self, running: Running) -> None:
        """Posts the frames when they are due."""
        recording: HandRecording = getattr(self, "_recording")  # noqa: B009  (set in open())
        running.health = SourceHealth("running", f"{len(recording)} frames")
        clock = running.mailbox.clock
        for _, (frame, session) in on_time(self._due(recording), clock, running.stopping):
            running.mailbox.post(frame, session=session, speed=self.speed)

    def _due(self, recording: HandRecording) -> Iterator[tuple[float, tuple[HandFrame, int]]]:
        """Yields the time of each frame [s], the frame, and the number of the repetition."""
        first = float(recording.stamps[0])
        single = len(recording) < 2
        period = recording.duration + (_DEFAULT_PERIOD_S if single else 1.0 / recording.rate_hz)
        for session in itertools.count() if self.loop else range(1):
            for frame in recording:
                later = replace(frame, stamp=frame.time + session * period)
                yield (later.time - first) / self.speed, (later, session)


WORLD: Final = "synthetic"
_HANDS_AT: Final[dict[Side, np.ndarray]] = {
    "right": np.array([0.4, -0.2, 1.0]),
    "left": np.array([0.4, 0.2, 1.0]),
}


@dataclass(frozen=True)
class SyntheticSource(ThreadedSource):
    """Simulated operator in front of a simulated tracker.

    The two hands mirror each other, but their trackers lose different frames.

    Attributes:
        seed: seed of the operator's hand, the motion and the tracker's losses.
        tracker: ``glove``, ``headset`` or ``camera``; None for a perfect tracker.
        rate: frame rate of each hand [Hz]; None for the tracker's own.
        side: ``right``, ``left`` or ``both``.
        gestures: names joined by ``+``, such as ``pinch_index+spread``; None for all.
        speed: speed of the operator's motion; 1 is natural.
        frame_loss: share of lost frames, in bursts; None for the tracker's own.
        landmark_loss: share of missing landmarks, in bursts.
        rate_jitter: standard deviation of a frame's time, divided by the period; None for the
            tracker's own.
        duration: length of the motion [s]; None for an endless one.
        wrist: standard deviation of each coordinate of the wrist [m] about a point 1 m up and
            0.4 m ahead; 0 for a tracker without a wrist. The landmarks do not move with it.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no gesture with one of the names.
    """

    label = "the built-in operator"
    seed: int = 0
    rate: float | None = None
    side: Hands = "right"
    gestures: str | None = None
    speed: float = 1.0
    tracker: str | None = None
    frame_loss: float | None = None
    landmark_loss: float = 0.0
    rate_jitter: float | None = None
    duration: float | None = None
    wrist: float = 0.05

    def __post_init__(self) -> None:
        sides_of(self.side)
        self._operators()  # checks the other settings
        check_range("wrist", self.wrist, 0.0, 0.3, "m")
        if self.duration is not None:
            check_range("duration", self.duration, 1.0 / self._rate, 1e9, "s")

    @property
    def _rate(self) -> float:
        return tracker_model(self.tracker).rate_hz if self.rate is None else self.rate

    @property
    def pinch_gaps(self) -> Mapping[str, float]:
        """Gaps that the tracker is known to report in pinches; see ``source_gaps``."""
        return known_gaps(self.tracker)

    def run(self, running: Running) -> None:
        """Posts the frames when they are due."""
        hands = " and ".join(sides_of(self.side))
        running.health = SourceHealth("running", f"{hands} hand at {self._rate:g} Hz")
        clock = running.mailbox.clock
        turn = 4.0 * self.wrist  # [rad] for [m]: 0.2 rad for 5 cm
        wrists = {
            side: WristMotion(self.wrist, turn, self.seed + k)
            for k, side in enumerate(sides_of(self.side))
        }
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

    def _operators(self) -> list[SyntheticOperator]:
        return [
            SyntheticOperator(
                seed=self.seed,
                side=side,
                rate_hz=self.rate,
                gestures=tuple(self.gestures.split("+")) if self.gestures else GESTURES,
                speed=self.speed,
                tracker=tracker_model(
                    self.tracker,
                    self.seed + number,
                    frame_loss=self.frame_loss,
                    landmark_loss=self.landmark_loss,
                    rate_jitter=self.rate_jitter,
                ),
            )
            for number, side in enumerate(sides_of(self.side))
        ]
