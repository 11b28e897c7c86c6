"""Live calibration: shows prompts to the operator and records the frames for each prompt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from smooth_operator.calibration.segments import Prompt, Segment
from smooth_operator.errors import RecordingError
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import HandRecording, Side

SIGHT_S = 0.3
"""Time without a frame after which the hand counts as out of sight and the prompt waits [s]."""


@dataclass(frozen=True)
class Moment:
    """What the operator is prompted to do at one moment.

    Attributes:
        prompt: the prompt.
        number: number of the prompt, from 0.
        phase: ``settle`` while the operator moves to the pose; ``hold`` while they hold it;
            ``wait`` while no hand is in sight.
        done: completed share of the calibration, 0 to 1.
        left_s: time left of this phase [s].
    """

    prompt: Prompt
    number: int
    phase: Literal["settle", "hold", "wait"]
    done: float
    left_s: float


class CalibrationSession:
    """Steps through the prompts as frames arrive. Its clock stops while no hand is visible.

    Args:
        side: side of the hand.
        prompts: the prompts, in order.
    """

    def __init__(self, side: Side, prompts: Sequence[Prompt]) -> None:
        self.side: Side = side
        self.prompts = tuple(prompts)
        self._frames: list[Arrival] = []
        self._held: list[int | None] = []  # for each frame, the prompt that it holds
        self._holding: int | None = None
        self._spent = 0.0
        self._last: float | None = None

    def see(self, arrival: Arrival) -> None:
        """Adds a frame. Ignores frames of the other hand and frames that are not newer."""
        newest = self._frames[-1].received if self._frames else -np.inf
        if arrival.frame.side == self.side and arrival.received > newest:
            self._frames.append(arrival)
            self._held.append(self._holding)

    def at(self, now: float) -> Moment | None:
        """Returns the prompt to show at a time.

        Args:
            now: time by the clock of the arrivals, not earlier than at the last call [s].

        Returns:
            None after the last prompt.
        """
        in_sight = bool(self._frames) and now - self._frames[-1].received <= SIGHT_S
        if self._last is not None and in_sight:
            self._spent += now - self._last
        self._last = now
        self._holding = None
        begins = 0.0
        for number, prompt in enumerate(self.prompts):  # noqa: B007  (used after the loop)
            holds, ends = begins + prompt.settle, begins + prompt.settle + prompt.hold
            if self._spent < ends:
                break
            begins = ends
        else:
            return None
        settling = self._spent < holds
        if in_sight and not settling:
            self._holding = number
        left = (holds if settling else ends) - self._spent
        phase: Literal["settle", "hold", "wait"] = "settle" if settling else "hold"
        total = sum(p.settle + p.hold for p in self.prompts)
        return Moment(prompt, number, phase if in_sight else "wait", self._spent / total, left)

    def recording(self) -> HandRecording:
        """All frames, stamped with the times at which they arrived; RecordingError if none has
        arrived."""
        if not self._frames:
            raise RecordingError(
                f"no frame of a {self.side} hand arrived from the tracker; check that the tracker "
                "is switched on, and which hand it sees"
            )
        frames = [arrival.frame for arrival in self._frames]
        nowhere = np.full(7, np.nan)
        wrists = [nowhere if f.T_world_wrist is None else f.T_world_wrist for f in frames]
        return HandRecording(
            np.stack([frame.landmarks for frame in frames]),
            np.array([arrival.received for arrival in self._frames]),
            self.side,
            np.stack([frame.valid for frame in frames if frame.valid is not None]),
            name="live calibration",
            T_world_wrist=np.stack(wrists),
            world=frames[0].world,
        )

    def segments(self) -> list[Segment]:
        """Ranges of the recording in which the operator held the prompted poses."""
        holds = []
        for number, prompt in enumerate(self.prompts):
            rows = [i for i, held in enumerate(self._held) if held == number]
            if rows:
                holds.append(Segment(prompt.name, rows[0], rows[-1] + 1, 1.0))
        return holds
