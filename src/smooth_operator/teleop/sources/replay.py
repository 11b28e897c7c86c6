"""A recording as a live source: ``replay:FILE``."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from smooth_operator.errors import ConfigError
from smooth_operator.formats.readers import read_recording
from smooth_operator.io.anatomy import layout_order
from smooth_operator.synthetic.tracker import check_range
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource, on_time
from smooth_operator.types import HandFrame, HandRecording

_DEFAULT_PERIOD_S = 0.01  # between the rounds of a recording of a single frame


@dataclass(frozen=True)
class Replay(ThreadedSource):
    """Plays a recording at its own pace.

    Stamps are those of the recording, also at another speed. In a loop each round is a session of
    its own, since the hand jumps from the last frame to the first, but stamps keep increasing: a
    round starts one frame period after the end of the previous one.

    Attributes:
        path: any file that ``smooth-operator retarget`` reads.
        speed: 1 is the recording's own pace, 2 is twice as fast.
        loop: repeat the recording without end.
        rate: frame rate of a file without stamps [Hz].
        side: side of the hand, for a file without one.
        layout: order of the landmarks in a plain array; None for the project's own.

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
        """Name for a person, in a few words."""
        return f"replay of {self.path.name}"

    def open(self) -> None:
        """Read the recording here, where its errors reach the caller."""
        recording = read_recording(self.path, rate=self.rate, side=self.side, layout=self.layout)
        object.__setattr__(self, "_recording", recording)

    def run(self, running: Running) -> None:
        """Post the frames when they are due."""
        recording: HandRecording = getattr(self, "_recording")  # noqa: B009  (set in open())
        running.health = SourceHealth("running", f"{len(recording)} frames of {self.path.name}")
        clock = running.mailbox.clock
        for _, (frame, session) in on_time(self._due(recording), clock, running.stopping):
            running.mailbox.post(frame, session=session, speed=self.speed)

    def _due(self, recording: HandRecording) -> Iterator[tuple[float, tuple[HandFrame, int]]]:
        """Time at which each frame is due [s], the frame and its round."""
        first = float(recording.stamps[0])
        single = len(recording) < 2
        period = recording.duration + (_DEFAULT_PERIOD_S if single else 1.0 / recording.rate_hz)
        for session in itertools.count() if self.loop else range(1):
            for frame in recording:
                later = replace(frame, stamp=frame.time + session * period)
                yield (later.time - first) / self.speed, (later, session)
