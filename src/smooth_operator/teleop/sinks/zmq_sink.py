"""Sink that publishes commands as JSON messages over ZeroMQ, for a robot's driver."""

from __future__ import annotations

import functools
import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from smooth_operator.errors import ConfigError, MissingExtraError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.io.jsonable import numbers
from smooth_operator.poses import is_valid
from smooth_operator.teleop.control.bindings import EPISODE_ACTIONS
from smooth_operator.teleop.sinks.sink import Link, ThreadedSink
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, Tick
from smooth_operator.types import Side
from smooth_operator.web.addresses import is_zmq_address

FORMAT: Final = 1
"""Version of the messages."""

_WAITING_MESSAGES: Final = 4
"""Largest number of messages that wait for a slow subscriber; older ones are outdated."""

_LINGER_MS: Final = 1000
"""Time that closing waits for pending messages, such as the end message [ms]."""


@dataclass(frozen=True)
class ZmqSink(ThreadedSink):
    """Publishes commands on a ZeroMQ socket (PUB); see ``docs/how-to/robot-driver.md``.

    It needs no subscriber, and subscribers may come and go. Each message states for how long it is
    valid; a driver that gets no newer message within that time must stop its robot.

    Attributes:
        address: address for subscribers; the default can be reached from this machine only.
        valid_for_s: time for which a command is valid [s].
        episode: action of ``EPISODE_ACTIONS`` -> how often the operator did it.

    Raises:
        ConfigError: a setting is out of its range.
    """

    address: str = "tcp://127.0.0.1:5556"
    valid_for_s: float = 0.2
    episode: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(EPISODE_ACTIONS, 0),
        init=False,
        repr=False,
        compare=False,
    )

    def __post_init__(self) -> None:
        check_address(self.address)
        if not 0.0 < self.valid_for_s <= 10.0:
            raise ConfigError(
                f"zmq: valid_for_s must be greater than 0 and at most 10 s, not {self.valid_for_s}"
            )

    @property
    def label(self) -> str:
        """The word ``zmq`` and the address."""
        return f"zmq {self.address}"

    @property
    def actions(self) -> Mapping[str, Callable[[], None]]:
        """Operator actions for the episode that a receiver, such as LeRobot, records."""
        return episode_actions(self.episode)

    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Opens the socket."""
        context, socket = open_publisher(self.address, "commands")
        names = {side: hand.name for side, hand in hands.items()}
        return _Publisher(context, socket, names, self.valid_for_s, self.episode)


def episode_actions(counts: dict[str, int]) -> dict[str, Callable[[], None]]:
    """Returns a function for each action in ``counts``; a call of it increases the count by one."""

    def count(name: str) -> None:
        counts[name] += 1

    return {name: functools.partial(count, name) for name in counts}


def check_address(address: str) -> None:
    """Raises ConfigError for a text that is not a ZeroMQ address."""
    if not is_zmq_address(address):
        raise ConfigError(
            f"zmq: {address!r} is not a ZeroMQ address; expected an address such as "
            "tcp://127.0.0.1:5556 or ipc:///run/hand"
        )


def open_publisher(address: str, what: str) -> tuple[Any, Any]:
    """Opens a ZeroMQ context, and a socket that publishes (PUB) at an address.

    Args:
        address: address for subscribers.
        what: the content of the messages, for errors.

    Raises:
        MissingExtraError: pyzmq is not installed.
        SinkError: the address can't be used.
    """
    try:
        import zmq
    except ImportError as error:
        raise MissingExtraError(f"sending {what} over ZeroMQ", "zmq") from error
    context = zmq.Context()
    socket = context.socket(zmq.PUB)
    socket.setsockopt(zmq.LINGER, _LINGER_MS)
    socket.setsockopt(zmq.SNDHWM, _WAITING_MESSAGES)
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        socket.close(0)
        context.term()
        raise SinkError(
            f"can't publish {what} at {address}: {error}; choose another address, or end the "
            "program that uses it"
        ) from error
    return context, socket


def command_message(tick: Tick, valid_for_s: float) -> dict[str, Any]:
    """Makes the message for a command; ``side`` comes first, so that subscribers can filter by
    it."""
    frame, wrist = None if tick.arrival is None else tick.arrival.frame, tick.wrist
    message: dict[str, Any] = {
        "side": tick.side,
        "type": "command",
        "format": FORMAT,
        "hand": tick.hand,
        "number": tick.number,
        "mode": tick.mode.value,
        "names": list(tick.command.joint_names),
        "positions": _finite(tick.command.joint_positions.tolist()),
        "velocities": _finite(tick.velocity.tolist()),
        "stamp": tick.command.stamp,
        "time": tick.time,
        "unix_time": time.time(),
        "valid_for_s": valid_for_s,
    }
    if wrist is not None:
        message["wrist"] = {
            "pose": _finite(wrist.pose.tolist()),
            "engaged": wrist.engaged,
            "valid": wrist.valid,
            "world": wrist.world,
        }
    if tick.arm is not None:
        message["arm"] = arm_message(tick.arm)
    if frame is not None:
        assert frame.valid is not None  # filled in by HandFrame
        points = zip(frame.landmarks, frame.valid, strict=True)
        message["landmarks"] = [numbers(point) if valid else None for point, valid in points]
    if frame is not None and frame.T_world_wrist is not None:
        pose = numbers(frame.T_world_wrist) if is_valid(frame.T_world_wrist) else None
        message["operator_wrist"] = {"pose": pose, "world": frame.world}
    return message


def arm_message(arm: ArmCommand) -> dict[str, Any]:
    """The part of a command message that concerns the arm, with its measured positions if there are
    any."""
    message: dict[str, Any] = {
        "name": arm.name,
        "names": list(arm.joint_names),
        "positions": _finite(arm.positions.tolist()),
        "velocities": _finite(arm.velocity.tolist()),
        "pose": _finite(arm.pose.tolist()),
        "state": arm.state,
    }
    if arm.measured is not None:
        message["measured"] = numbers(arm.measured)
    return message


def state_message(state: HandState) -> dict[str, Any]:
    """Makes the message for a measured state. ``topic`` comes first, so that subscribers can filter
    by it and do not mistake the message for a command."""
    message: dict[str, Any] = {
        "topic": "/state",
        "side": state.side,
        "type": "state",
        "format": FORMAT,
        "hand": state.hand,
        "time": state.stamp,
        "unix_time": time.time() - (time.perf_counter() - state.stamp),
        "names": list(state.names),
        "positions": numbers(state.positions),
    }
    for name in ("velocities", "currents", "temperatures", "touch"):
        values = getattr(state, name)
        if values is not None:
            message[name] = numbers(values)
    if state.contact is not None:
        message["contact"] = numbers(state.contact.levels)
        message["newtons"] = numbers(state.contact.newtons)
    if state.actuators:
        message["actuators"] = list(state.actuators)
    return message


def encode(message: Mapping[str, Any]) -> bytes:
    """Encodes a message as JSON without spaces. Refuses NaN, which JSON does not have."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def _finite(values: list[float]) -> list[float]:
    if not all(map(math.isfinite, values)):
        raise SinkError(f"a command with values that are not finite was not sent: {values}")
    return values


class _Publisher:
    """The open socket; only the sink's own thread uses it."""

    def __init__(
        self,
        context: Any,
        socket: Any,
        hands: Mapping[Side, str],
        valid_for_s: float,
        episode: Mapping[str, int],
    ) -> None:
        self._context, self._socket = context, socket
        self._hands, self._valid_for_s = hands, valid_for_s
        self._episode = episode
        self._states: dict[Side, HandState] = {}  # the last that was published

    def deliver(self, tick: Tick) -> None:
        """Publish a command, and the hand's measured state if it is new."""
        message = command_message(tick, self._valid_for_s)
        self._socket.send(encode({**message, "episode": dict(self._episode)}))
        state = tick.state
        if state is not None and state is not self._states.get(tick.side):
            self._states[tick.side] = state
            self._socket.send(encode(state_message(state)))

    def stalled(self, seconds: float) -> None:
        """Publish for each hand that the loop sends no commands."""
        self._tell("stalled", seconds=seconds)

    def close(self) -> None:
        """Publish the end message, and close the socket."""
        try:
            self._tell("end")
        finally:
            self._socket.close()
            self._context.term()

    def _tell(self, what: str, **more: float) -> None:
        for side, hand in self._hands.items():
            head = {"side": side, "type": what, "format": FORMAT, "hand": hand}
            self._socket.send(encode({**head, "unix_time": time.time(), **more}))
