"""Stores the newest command of each hand, and computes its age."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

FORMAT = 1
"""Version of the messages that this plug-in reads."""

ARM_PREFIX = "arm_"
"""Prefix of the names of an arm's joints, since hand joints may have the same names."""

_SPAN_S = 30.0
"""Time window in which the quickest message is found [s]; over longer times, two clocks drift."""


@dataclass(frozen=True)
class Command:
    """A command of one hand.

    Attributes:
        hand: name of the robot hand.
        names: (n) names of the model's joints and, with an arm, of its joints ``arm_joint1``, ...
        positions: (n) angles [rad].
        wrist: target of the wrist in the robot's base: x y z [m], quaternion w x y z; None
            if the message does not contain it.
        mode: mode of the loop: ``tracking``, ``holding``, ``paused``, ``stopped``, ...
        valid_for_s: time for which the command is valid [s].
        sent: time at which it was sent, estimated in terms of this process's clock [s].
        landmarks: (21, 3) the human hand that it was computed from [m], NaN where a landmark was
            lost; None without a hand.
        episode: how often each key for the episode was pressed: ``success``, ``end``, ``again``.
        operator_wrist: (7,) the human wrist: x y z [m], quaternion w x y z; None if it is unknown.
    """

    hand: str
    names: tuple[str, ...]
    positions: tuple[float, ...]
    wrist: tuple[float, ...] | None
    mode: str
    valid_for_s: float
    sent: float
    landmarks: np.ndarray | None = None
    operator_wrist: tuple[float, ...] | None = None
    episode: Mapping[str, int] = field(default_factory=dict)


class _Lateness:
    """Measures how much longer a message took than the quickest recent one.

    Sender and receiver have separate clocks, whose difference is unknown, so the quickest message
    is assumed to have no delay. Queued old messages are therefore not mistaken for new ones.
    """

    def __init__(self) -> None:
        self._least = [math.inf, math.inf]  # of this span of time, and of the one before
        self._since = -math.inf
        self._last_sent = -math.inf

    def of(self, sent: float, arrived: float) -> float:
        """Lateness [s], from the sender's and the receiver's clock."""
        if sent < self._last_sent:  # another session, perhaps with another clock
            self._least = [math.inf, math.inf]
            self._since = arrived
        self._last_sent = sent
        if arrived - self._since > _SPAN_S:
            self._least, self._since = [math.inf, self._least[0]], arrived
        took = arrived - sent
        self._least[0] = min(self._least[0], took)
        return took - min(self._least)


class Newest:
    """Stores the newest command of each hand; a thread adds messages, and readers never wait.

    Args:
        clock: clock of this process [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._commands: dict[str, Command] = {}
        self._silent: dict[str, str] = {}
        self._lateness: dict[str, _Lateness] = {}
        self._refused = ""
        self._changed = threading.Condition()

    def command(self, side: str) -> Command | None:
        """The newest command of a hand; None before the first command."""
        return self._commands.get(side)

    def silence(self, side: str) -> str:
        """Reason why no commands come, if the loop stated it; otherwise empty."""
        return self._silent.get(side, "")

    @property
    def sides(self) -> tuple[str, ...]:
        """Sides of the hands for which commands have been received."""
        return tuple(self._commands)

    @property
    def refused(self) -> str:
        """Error of the last message that could not be read; empty if all could be read."""
        return self._refused

    def wait(self, enough: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until ``enough`` returns True, up to a timeout; returns its last result."""
        with self._changed:
            return self._changed.wait_for(enough, timeout_s)

    def wake(self) -> None:
        """Make waiting threads check their condition again."""
        with self._changed:
            self._changed.notify_all()

    def receive(self, data: bytes) -> None:
        """Decode and store a message; if it can't be read, ignore it and remember the error."""
        try:
            message = json.loads(data)
        except ValueError as error:
            self._refused = f"a message is not JSON: {error}"
            return
        self.take(message)

    def take(self, message: Any) -> None:
        """Store a decoded message; if it can't be read, ignore it and remember the error."""
        try:
            self._take(message)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            self._refused = f"a message can't be read: {type(error).__name__}: {error}"
        self.wake()

    def _take(self, message: dict[str, Any]) -> None:
        kind, side = message["type"], message["side"]
        if message["format"] != FORMAT:
            raise ValueError(
                f"messages have format {message['format']}, not {FORMAT}; install the same "
                "version of the plug-in and of smooth-operator"
            )
        if kind in ("stalled", "end"):
            self._silent[side] = (
                "teleop sends no commands" if kind == "stalled" else "teleop has ended"
            )
        elif kind == "command":
            self._commands[side] = self._command(side, message)
            self._silent.pop(side, None)

    def _command(self, side: str, message: dict[str, Any]) -> Command:
        names = tuple(map(str, message["names"]))
        positions = tuple(map(float, message["positions"]))
        if "arm" in message:  # that carries the hand
            names += tuple(f"{ARM_PREFIX}{name}" for name in message["arm"]["names"])
            positions += tuple(map(float, message["arm"]["positions"]))
        if len(names) != len(positions) or not all(map(math.isfinite, positions)):
            raise ValueError(f"{len(names)} joints do not match the positions {positions}")
        operator = message.get("operator_wrist") or {}
        arrived = self._clock()
        lateness = self._lateness.setdefault(side, _Lateness()).of(float(message["time"]), arrived)
        return Command(
            str(message["hand"]),
            names,
            positions,
            _wrist(message.get("wrist")),
            str(message["mode"]),
            float(message["valid_for_s"]),
            arrived - lateness,
            _landmarks(message.get("landmarks")),
            _wrist(operator if operator.get("pose") else None),
            {str(name): int(count) for name, count in message.get("episode", {}).items()},
        )


def _landmarks(message: Any) -> np.ndarray | None:
    if message is None:
        return None
    return np.array([[math.nan] * 3 if point is None else point for point in message], np.float64)


def _wrist(message: Any) -> tuple[float, ...] | None:
    if message is None:
        return None
    # The loop holds it while the operator's wrist is lost or the clutch is open.
    pose = tuple(map(float, message["pose"]))
    length = math.sqrt(sum(value * value for value in pose[3:]))
    if len(pose) != 7 or not all(map(math.isfinite, pose)) or abs(length - 1.0) > 1e-3:
        raise ValueError(f"a wrist's pose must be 3 coordinates and a unit quaternion, not {pose}")
    return pose
