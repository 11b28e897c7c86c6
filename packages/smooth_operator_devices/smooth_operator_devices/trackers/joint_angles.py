"""Hands from gloves and exoskeletons that measure joint angles, over UDP, ZeroMQ or ROS 2.

A message over UDP or ZeroMQ is JSON, and has one hand or both::

    {"side": "right", "stamp": 12.5, "angles": {"thumb_cmc_flexion": 10, "index_mcp": 35, ...}}
    {"stamp": 12.5, "hands": [{"side": "right", "angles": {...}}, {"side": "left", ...}]}

The names are those of ``smooth_operator.synthetic``: ``thumb_cmc_flexion``,
``thumb_cmc_abduction``, ``thumb_mcp``, ``thumb_ip``, and for index, middle, ring and pinky
``index_mcp_abduction``, ``index_mcp``, ``index_pip``, ``index_dip``. Flexion is positive, abduction
of a finger towards the thumb, flexion of the thumb's CMC towards the little finger, and its
abduction away from the palm; all are 0 in a flat hand. A DIP angle that is missing in a message is
2/3 of the PIP angle; any other missing angle is 0. ``null`` and NaN mean that the glove does not
know an angle. ``wrist`` and ``world`` are as in the messages of the source ``udp``. The format is
our own; over ROS 2 the message is ``sensor_msgs/JointState``. The landmarks are computed from the
angles with the hand of the built-in operator, scaled to the length ``size``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from smooth_operator.errors import ConfigError, RecordingError, SourceError, brief, listed
from smooth_operator.synthetic.hand_anatomy import (
    DIP_PER_PIP,
    JOINTS,
    HandAnatomy,
    draw_anatomy,
    mirror,
    pose_hand,
)
from smooth_operator.teleop.sources.inboxes import NEWEST, Inbox, Message, UdpInbox, ZmqInbox
from smooth_operator.teleop.sources.payload import (
    Reading,
    check_size,
    hand_frame,
    parse_json,
    read_session,
    read_side,
    read_stamp,
    read_wrist,
)
from smooth_operator.teleop.sources.stream import Hands, Reader, StreamSource, only_side
from smooth_operator.types import Side

Unit: TypeAlias = Literal["deg", "rad"]

_NAMES: Final = tuple(joint.name for joint in JOINTS)
_MOST: Final = math.pi  # no joint of a hand turns further [rad]
_SHARED: Final = ("side", "stamp", "timestamp", "session", "world")


@dataclass(frozen=True)
class JointAngles(StreamSource):
    """Source of hands whose glove gives joint angles, over UDP, ZeroMQ or ROS 2.

    Attributes:
        unit: unit of the angles, ``deg`` or ``rad``.
        side: hands to use; if it is one hand, also the side of messages without a side.
        port: UDP port to listen on; 0 for any free one.
        host: address to listen on; ``0.0.0.0`` for the whole network.
        address: address of a ZeroMQ publisher, instead of UDP.
        topic: topic of ``sensor_msgs/JointState`` in ROS 2, with ``{side}`` for right and left,
            instead of UDP.
        size: length of the hand from the wrist to the tip of the middle finger [m].

    Raises:
        ConfigError: a setting is outside its range, or both ``address`` and ``topic`` are set.
    """

    unit: Unit
    _: KW_ONLY
    side: Hands = "right"
    port: int = 5006
    host: str = "127.0.0.1"
    address: str | None = None
    topic: str | None = None
    size: float = 0.19

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.12 <= self.size <= 0.25:
            raise ConfigError(f"size must be 0.12 to 0.25 m, not {self.size:g}")
        if self.address is not None and self.topic is not None:
            raise ConfigError("angles: set an address (ZeroMQ) or a topic (ROS 2), not both")
        if self.topic is not None and self.side == "both" and "{side}" not in self.topic:
            raise ConfigError("angles: two hands need two topics: put {side} into the topic")

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"joint angles on {self.topic or self.address or f'UDP port {self.port}'}"

    def connect(self) -> Inbox:
        """Opens the socket or the subscriptions."""
        if self.address is not None:
            return ZmqInbox("the source 'angles'", self.address)
        if self.topic is None:
            return UdpInbox(self.host, self.port, f"angles:{self.unit},port=PORT")
        from smooth_operator_devices.ros2.messages import JointState
        from smooth_operator_devices.ros2.source import Ros2Inbox
        from smooth_operator_devices.ros2.transport import Endpoint, Transport

        transport = Transport(Endpoint("the source 'angles'", SourceError, None, None))
        try:
            for topic in self._topics():
                transport.subscribe(JointState, topic, NEWEST)
        except BaseException:
            transport.close()
            raise
        return Ros2Inbox(transport, f"{self.topic} ({transport.label})")

    def _topics(self) -> dict[str, Side]:
        from smooth_operator_devices.ros2.transport import topic_name

        return {topic_name(self.topic or "", "angles", side=side): side for side in self.sides}

    def reader(self) -> Reader:
        """Reads the messages."""
        anatomy = draw_anatomy(self.size, 0)
        if self.topic is None:
            side = only_side(self.side)
            return lambda message, received: [
                read_hand(hand, self.unit, side, anatomy)
                for hand in _hands(message[-1] if self.address else message[0])
            ]
        topics = self._topics()

        def read(message: Message, received: float) -> Sequence[Reading]:
            topic, state = message
            if isinstance(state, RecordingError):
                raise state
            stamp = state.header.stamp.sec + state.header.stamp.nanosec / 1e9
            angles = dict(zip(state.name, state.position, strict=False))
            hand = {"angles": angles, **({"stamp": stamp} if stamp else {})}
            return [read_hand(hand, self.unit, topics[topic], anatomy)]

        return read


def _hands(data: bytes) -> list[Mapping[str, Any]]:
    """Hands of a message, each with the common fields of the message."""
    check_size(data)
    message = parse_json(data)
    hands = message.get("hands", [message]) if isinstance(message, dict) else None
    if not isinstance(hands, list) or not all(isinstance(hand, dict) for hand in hands):
        raise RecordingError("the message must be an object with 'angles', or with 'hands', a list")
    return [{**{key: message[key] for key in _SHARED if key in message}, **hand} for hand in hands]


def read_hand(
    message: Mapping[str, Any], unit: Unit, side: Side | None, anatomy: HandAnatomy
) -> Reading:
    """Hand of an object with ``angles``.

    Args:
        side: side of the hand, for an object without a side.

    Raises:
        RecordingError: an angle has an unknown name, is not a number, or is too large for the unit.
    """
    of_side = read_side(message.get("side"), side)
    poses = pose_hand(anatomy, _angles(message.get("angles"), unit)[None])
    if of_side == "left":
        poses = mirror(poses)
    frame = hand_frame(
        poses.landmarks[0],
        stamp=read_stamp(message),
        side=of_side,
        orientations=poses.orientations[0],
        metacarpals=poses.metacarpals[0],
        **read_wrist(message),
    )
    return Reading(frame, read_session(message))


def _angles(given: Any, unit: Unit) -> np.ndarray:
    """Angles in the order of ``JOINTS`` [rad]; NaN for unknown ones."""
    if not isinstance(given, dict) or not given:
        raise RecordingError(f"'angles' must be an object of angles by name, not {brief(given)}")
    if unknown := [name for name in given if name not in _NAMES]:
        raise RecordingError(
            f"unknown joint {listed(unknown, 3)}; the names are {', '.join(_NAMES)}"
        )
    angles = np.zeros(len(_NAMES))
    for at, name in enumerate(_NAMES):
        value = given.get(name, 0.0)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise RecordingError(f"the angle {name!r} must be a number, not {brief(value)}")
        angles[at] = math.nan if value is None or abs(value) > 1e9 else value
        if name.endswith("_dip") and name not in given:
            angles[at] = DIP_PER_PIP * angles[at - 1]
    angles = np.deg2rad(angles) if unit == "deg" else angles
    if (np.abs(angles) > _MOST).any():
        name = _NAMES[int(np.nanargmax(np.abs(angles)))]
        raise RecordingError(
            f"the angle {name!r} is {brief(given.get(name))} {unit}, more than a joint can turn; "
            "set the unit that the glove sends: angles:deg or angles:rad"
        )
    return angles
