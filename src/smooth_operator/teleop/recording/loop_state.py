"""What a log of the live loop says of each command, in addition to the command itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.teleop.recording.log_tables import Table, spread


@dataclass(frozen=True)
class LoopState:
    """The loop at one command.

    Attributes:
        number: of the tick, counted from 0.
        mode: what the loop did, as ``tracking`` or ``holding``.
        time: when the command was ready, by the loop's clock [s].
        received: when the frame that it answers came in, by the loop's clock [s]; None where the
            command answers none.
        tracker_stamp: stamp of that frame by the tracker's own clock [s].
        session: which start of the tracker it is of.
        tracking_loss: of the frame; NaN where none is answered.
        scale: robot size over human size; NaN where none is answered.
        events: what happened, a sentence each.
    """

    number: int
    mode: str
    time: float
    received: float | None = None
    tracker_stamp: float | None = None
    session: int | None = None
    tracking_loss: float = math.nan
    scale: float = math.nan
    events: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LoopTrack:
    """The loop over all commands of a log; T is their number.

    Attributes:
        numbers: (T,) of the ticks; -1 where the log does not say.
        modes: (T,) what the loop did; empty where the log does not say.
        times: (T,) when each command was ready, by the loop's clock [s].
        received: (T,) when the frame that it answers came in [s]; NaN where it answers none.
        tracker_stamps: (T,) the frame's stamp by the tracker's own clock [s], or NaN.
        tracking_loss: (T,) of the frame, or NaN.
        scale: (T,) robot size over human size, or NaN.
        events: index of a command -> what happened at it.
    """

    numbers: Int[np.ndarray, " T"]
    modes: tuple[str, ...]
    times: Float[np.ndarray, " T"]
    received: Float[np.ndarray, " T"]
    tracker_stamps: Float[np.ndarray, " T"]
    tracking_loss: Float[np.ndarray, " T"]
    scale: Float[np.ndarray, " T"]
    events: Mapping[int, tuple[str, ...]]

    @property
    def answers(self) -> Bool[np.ndarray, " T"]:
        """(T,) whether the command answers a frame."""
        return np.asarray(np.isfinite(self.received))


def read_loop_track(commands: Sequence[int], table: Table) -> LoopTrack | None:
    """Put together what the messages of ``/loop`` hold.

    Args:
        commands: sequence numbers of the commands.
        table: the messages.

    Returns:
        None where there is no message: the log is not of a live loop.

    Raises:
        ValueError, OverflowError: a field is wrong.
    """
    if not table:
        return None
    places = table.places(commands)
    modes, events = table.column("mode"), table.column("events")

    def numbers(key: str) -> np.ndarray:
        return spread(table.floats(key), places, np.nan)

    return LoopTrack(
        numbers=spread(np.array(table.column("number"), np.int64), places, -1),
        modes=tuple("" if row < 0 else modes[row] for row in places),
        times=numbers("time"),
        received=numbers("received"),
        tracker_stamps=numbers("tracker_stamp"),
        tracking_loss=numbers("tracking_loss"),
        scale=numbers("scale"),
        events={i: events[row] for i, row in enumerate(places) if row >= 0 and events[row]},
    )
