"""A sink of smooth-operator that leaves each command for the teleoperator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_teleoperator_smooth_operator.commands import Newest
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.teleop.sinks.zmq_sink import FORMAT, command_message
from smooth_operator.types import Side

_VALID_S = 0.2
"""How long a command may be acted upon [s], as over ZeroMQ."""


class MailboxSink(Sink):
    """Commands as the messages that ZeroMQ would carry, without ZeroMQ."""

    def __init__(self, newest: Newest) -> None:
        self._newest = newest
        self._sides: tuple[Side, ...] = ()

    @property
    def label(self) -> str:
        """``lerobot``."""
        return "lerobot"

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Remember the hands."""
        self._sides = tuple(hands)

    def send(self, tick: Tick) -> None:
        """Leave a command."""
        self._newest.take(command_message(tick, _VALID_S))

    def stalled(self, seconds: float) -> None:
        """Leave word that no command comes."""
        self._tell("stalled")

    def close(self) -> None:
        """Leave word that no more commands come."""
        self._tell("end")

    def _tell(self, what: str) -> None:
        for side in self._sides:
            self._newest.take({"side": side, "type": what, "format": FORMAT})
