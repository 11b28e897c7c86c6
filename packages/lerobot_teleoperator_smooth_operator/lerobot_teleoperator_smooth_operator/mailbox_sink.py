"""Sink that passes each command of a loop in this process to the teleoperator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lerobot_teleoperator_smooth_operator.commands import Newest
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.control.bindings import EPISODE_ACTIONS
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.teleop.sinks.zmq_sink import FORMAT, command_message, episode_actions
from smooth_operator.types import Side

_VALID_S = 0.2
"""Time for which a command is valid [s], as over ZeroMQ."""


class MailboxSink(Sink):
    """Sink that passes on commands as the messages that ZeroMQ would carry, but without ZeroMQ."""

    def __init__(self, newest: Newest) -> None:
        self._newest = newest
        self._sides: tuple[Side, ...] = ()
        self._episode = dict.fromkeys(EPISODE_ACTIONS, 0)

    @property
    def label(self) -> str:
        """The word ``lerobot``."""
        return "lerobot"

    @property
    def actions(self) -> Mapping[str, Callable[[], None]]:
        """The operator's actions on the episode, which become events of the teleoperator."""
        return episode_actions(self._episode)

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Store the hands."""
        self._sides = tuple(hands)

    def send(self, tick: Tick) -> None:
        """Pass on a command."""
        message = command_message(tick, _VALID_S)
        self._newest.take({**message, "episode": dict(self._episode)})

    def stalled(self, seconds: float) -> None:
        """Report that no commands come."""
        self._tell("stalled")

    def close(self) -> None:
        """Report that no more commands will come."""
        self._tell("end")

    def _tell(self, what: str) -> None:
        for side in self._sides:
            self._newest.take({"side": side, "type": what, "format": FORMAT})
