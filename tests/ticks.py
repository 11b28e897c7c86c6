"""Ticks as the loop makes them, and a sink that keeps them."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from made_hands import hand_points

from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Contact, HandState, Mode, Tick
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import HandFrame, JointCommand, Status


def landmarks(number: int = 0) -> np.ndarray:
    """A hand that moves [m]."""
    return hand_points(1, 7)[0] + 0.01 * np.sin(0.1 * number)


def make_tick(
    hand: Hand,
    number: int = 0,
    *,
    stamp: float | None = None,
    session: int = 0,
    mode: Mode = Mode.TRACKING,
    at: float | None = None,
    events: tuple[str, ...] = (),
    frame: bool = True,
) -> Tick:
    """A tick of a hand, by default one that answers a frame received 2 ms ago."""
    now = time.perf_counter() if at is None else at
    side = hand.spec.side
    low, high = hand.limits.T
    q = low + (high - low) * (0.5 + 0.4 * np.sin(0.05 * number))
    own = number * 0.01 if stamp is None else stamp
    arrival = Arrival(HandFrame(landmarks(number), own, side), now - 0.002, session)
    return Tick(
        side,
        hand.name,
        JointCommand(hand.full_configuration(q), hand.joint_names, own if frame else now),
        np.zeros(len(hand.joint_names)),
        mode,
        now,
        number,
        Status.OK if frame else None,
        arrival if frame else None,
        {"tracker": 0.5, "receive": 0.2, "solve": 1.25, "limit": 0.1} if frame else {},
        0.01 if frame else float("nan"),
        1.1 if frame else float("nan"),
        events,
    )


def felt(hand: Hand, levels: Any, *, age: float = 0.0, mode: Mode = Mode.TRACKING) -> Tick:
    """A tick with a measured contact, or with none."""
    contact = None if levels is None else Contact(np.array(levels), np.full(len(levels), np.nan))
    stamp = time.perf_counter() - age
    positions = np.zeros(len(hand.joint_names))
    state = HandState(
        hand.spec.side, hand.name, stamp, hand.joint_names, positions, contact=contact
    )
    return replace(make_tick(hand, mode=mode), state=state)


@dataclass
class KeptTicks(Sink):
    """A sink that records its calls, and raises the errors that a test asks for.

    Attributes:
        slow_s: time that a command takes [s].
        raises: method -> error that it raises.
        calls: methods that were called.
    """

    label: str = "kept"
    observes: bool = False
    slow_s: float = 0.0
    raises: dict[str, Exception] = field(default_factory=dict)
    calls: list[str] = field(default_factory=list)
    ticks: list[Tick] = field(default_factory=list)
    silences: list[float] = field(default_factory=list)
    config: Mapping[str, Any] = field(default_factory=dict)
    is_open: bool = False

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if name in self.raises:
            raise self.raises[name]

    def open(self, hands: Mapping[Any, Hand], config: Mapping[str, Any]) -> None:
        assert not self.is_open
        self._call("open")
        self.is_open, self.config = True, config

    def send(self, tick: Tick) -> None:
        assert self.is_open
        time.sleep(self.slow_s)
        self._call("send")
        self.ticks.append(tick)

    def stalled(self, seconds: float) -> None:
        assert self.is_open
        self._call("stalled")
        self.silences.append(seconds)

    def close(self) -> None:
        self.is_open = False
        self._call("close")


def record(path: Path, hand: Hand, ticks: Iterable[Tick], config: Mapping[str, Any] = {}) -> Any:
    """Writes the log of a hand's ticks; returns its sink."""
    from smooth_operator.teleop.sinks.record import RecordSink

    sink = RecordSink(path)
    sink.open({hand.spec.side: hand}, config)
    for tick in ticks:
        sink.send(tick)
    sink.close()
    return sink
