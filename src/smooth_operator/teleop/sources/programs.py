"""Sources that receive other programs' messages: landmarks, headset apps, MANUS glove bridges.

``udp`` and ``zmq`` receive landmarks. ``hts`` (Quest), ``pico`` and ``avp`` (Vision Pro; needs the
``avp`` extra) receive messages of headset apps. ``manus`` receives the 25 nodes of a raw skeleton,
in several forms.

The main form is that of ``ManusZmqBridge`` (the program that made the MANUS recordings), with three
more fields::

    RIGHT {"glove_id": 3064964832, "side": "right", "session": "a1", "stamp": 12.505,
           "nodes": [{"id": 0, "pos": [x, y, z], "quat": [w, x, y, z]}, ...]}

Other forms are: both hands in one message; nodes as 25 rows of x y z and a quaternion; the ROS 2
message ``ManusGlove`` as JSON (``raw_nodes`` with a ``pose`` each); and the lines of the Bidex
bridge, ``glove id, 25 x (x, y, z, qx, qy, qz, qw)`` separated by commas, for one hand or two.
``docs/how-to/manus.md`` has an example of each.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.headsets import avp, hts_lines, pico_packets
from smooth_operator.headsets.openxr_joints import Axes
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.io.landmark_order import layout_order
from smooth_operator.teleop.sources.inboxes import (
    GrpcInbox,
    Inbox,
    Message,
    Pattern,
    TcpInbox,
    Together,
    UdpInbox,
    ZmqInbox,
    split_lines,
)
from smooth_operator.teleop.sources.payload import (
    Forms,
    PayloadReader,
    Reading,
    check_size,
    hand_frame,
    parse_json,
    read_numbers,
    read_session,
    read_side,
    read_stamp,
    read_wrist,
    with_shared,
)
from smooth_operator.teleop.sources.stream import (
    Hands,
    OneSender,
    Reader,
    StreamSource,
    only_side,
)
from smooth_operator.types import Side
from smooth_operator.web.addresses import LOCAL


@dataclass(frozen=True)
class LandmarkStream(Forms, StreamSource):
    """Source with one hand per message, in the forms of ``smooth_operator.teleop.sources.payload``.

    Attributes:
        side: the side to use; messages without a side count as this side. With ``both``, each
            message must state its side.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no such layout.
    """

    side: Hands = field(default="right", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        layout_order(self.layout)

    def data_of(self, message: Message) -> bytes:
        """The part of a message that contains the hand."""
        data: bytes = message[0]
        return data

    def reader(self) -> Reader:
        """See ``StreamSource``."""
        payload = PayloadReader(only_side(self.side), self)
        return lambda message, received: payload.read(self.data_of(message), received)


@dataclass(frozen=True)
class UdpSource(LandmarkStream):
    """Source with one hand per datagram; see ``LandmarkStream``.

    UDP has no passwords, so anyone who can send to the port moves the hand. By default the source
    listens on this machine only.

    Attributes:
        port: port to listen on; 0 for any free one, which ``endpoint`` then contains.
        host: address to listen on; ``0.0.0.0`` for the whole network.
    """

    port: int = 5005
    host: str = "127.0.0.1"

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"UDP port {self.port}"

    def connect(self) -> Inbox:
        """Opens the port."""
        return UdpInbox(self.host, self.port)


@dataclass(frozen=True)
class ZmqSource(LandmarkStream):
    """Source with one hand per ZeroMQ message; see ``LandmarkStream``.

    A message may begin with a topic: a separate part, or the text that ``topic`` gives.

    Attributes:
        address: address of the publisher, which may start later.
        bind: listen on the address, for publishers that connect.
        topic: use only messages that start with this text.
        pattern: ``sub`` for a sender that publishes, ``pull`` for one that pushes.
    """

    address: str = "tcp://127.0.0.1:5557"
    bind: bool = False
    topic: str = ""
    pattern: Pattern = "sub"

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"ZeroMQ {self.address}"

    def connect(self) -> Inbox:
        """Opens the socket."""
        return ZmqInbox(
            "the source 'zmq'", self.address, bind=self.bind, pattern=self.pattern, topic=self.topic
        )

    def data_of(self, message: Message) -> bytes:
        """The last part of a message, without its topic."""
        data: bytes = message[-1]
        if len(message) == 1 and self.topic:
            data = data.removeprefix(self.topic.encode()).lstrip(b" ")
        return data


Transport: TypeAlias = Literal["both", "udp", "tcp"]
"""Transport protocol of the app."""

UDP_PORT: Final = 9000
TCP_PORT: Final = 8000
"""Default ports of the app."""


@dataclass(frozen=True)
class HtsSource(StreamSource):
    """Both hands from the Quest app Hand Tracking Streamer, over Wi-Fi or a cable.

    The app has no passwords, so anyone who can send to the ports moves the hand. By default the
    source listens on this machine only, for a cable (``adb reverse tcp:8000 tcp:8000``).

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network, as required for Wi-Fi.
        port: port to listen on; 0 for any free one; None for 9000 (UDP) and 8000 (TCP), the ports
            of the app.
        transport: ``udp``, ``tcp``, or ``both``.
        side: hands to use.

    Raises:
        ConfigError: a setting is outside its range.
    """

    label = "Hand Tracking Streamer"
    host: str = "127.0.0.1"
    port: int | None = None
    transport: Transport = "both"
    side: Hands = "both"

    @property
    def hint(self) -> str:
        """Advice before the first message."""
        if self.host in LOCAL:
            return ", from this computer only (by cable); for Wi-Fi use hts:0.0.0.0"
        return "; in the app, enter this computer's address, the port and the protocol"

    def connect(self) -> Inbox:
        """Takes the ports."""
        inboxes: list[Inbox] = []
        if self.transport != "tcp":
            port = UDP_PORT if self.port is None else self.port
            inboxes.append(_UdpLines(self.host, port, "hts:port=PORT"))
        if self.transport != "udp":
            port = TCP_PORT if self.port is None else self.port
            try:
                inboxes.append(TcpInbox(self.host, port, split_lines, hts_lines.begins_line, "hts"))
            except Exception:
                for inbox in inboxes:
                    inbox.close()
                raise
        return inboxes[0] if len(inboxes) == 1 else Together(inboxes)

    def reader(self) -> Reader:
        """Reads the lines, each of which may complete a hand."""
        sender, hands = OneSender(), hts_lines.HtsHands()

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, host, *connection = message
            line = hts_lines.parse_line(data)  # before the check: only a valid line has a sender
            sender.check(host, received)
            frame = hands.add(line, received)
            if frame is None:
                return ()
            # A new connection is a new start of the app.
            return (Reading(frame, b" ".join((host, *connection)).decode()),)

        return read


class _UdpLines(UdpInbox):
    """Inbox for lines in UDP datagrams."""

    def receive(self, timeout: float) -> list[Message]:
        """The lines of the newest datagrams."""
        return [
            (line, host)
            for data, host in super().receive(timeout)
            for line in data.split(b"\n")
            if line.strip()
        ]


@dataclass(frozen=True)
class PicoSource(StreamSource):
    """Both hands from the PICO app XRoboToolkit; this program replaces its PC service.

    The PC service must not run at the same time, since both use one port. The app has no passwords,
    so anyone who can connect moves the hand. By default the source listens on this machine only.

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network, as required for a headset.
        port: TCP port; the app connects only to 63901.
        side: hands to use.
        axes: axes of the joints: ``openxr``, right-handed, or ``unity``, left-handed.

    Raises:
        ConfigError: a setting is outside its range.
    """

    label = "XRoboToolkit (PICO)"
    host: str = "127.0.0.1"
    port: int = pico_packets.PORT
    side: Hands = "both"
    axes: Axes = "openxr"

    @property
    def hint(self) -> str:
        """Advice before the first message."""
        if self.host in LOCAL:
            return ", from this computer only; for a headset on the network use pico:0.0.0.0"
        return "; in the app, enter this computer's address, then switch on Hand and Send"

    def connect(self) -> Inbox:
        """Opens the port."""
        split, begins = pico_packets.split_packets, pico_packets.begins_packet
        return TcpInbox(self.host, self.port, split, begins, "pico")

    def reader(self) -> Reader:
        """Reads the packets."""
        sender, repeats = OneSender(), Repeats()

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, host, connection = message
            frames = pico_packets.read_packet(data, self.axes)  # a bad packet has no sender
            sender.check(host, received)
            session = f"{host.decode()} {connection.decode()}"
            return [
                Reading(frame, session) for frame in map(repeats.new, frames) if frame is not None
            ]

        return read


@dataclass(frozen=True)
class AvpSource(StreamSource):
    """Both hands from a Vision Pro with the app Tracking Streamer, over Wi-Fi.

    This program connects to the headset, and retries while the headset sleeps. The app sends
    neither times nor visibility. Therefore the stamp is the time of receipt, a hand that does not
    change counts as lost, and a wrist that does not change while the fingers move is not valid.

    Attributes:
        address: address of the headset, as the app shows it.
        port: port of the app.
        side: hands to use.

    Raises:
        ConfigError: a setting is outside its range.
    """

    address: str
    port: int = avp.PORT
    side: Hands = "both"

    def __post_init__(self) -> None:
        if not self.address.strip():
            raise ConfigError("avp needs the headset's address, which the app shows: avp:ADDRESS")
        if not 1 <= self.port <= 65_535:
            raise ConfigError(f"port must be 1 to 65535, not {self.port}")
        super().__post_init__()

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"Tracking Streamer (Vision Pro) at {self.address}"

    def connect(self) -> Inbox:
        """Starts to connect, even if the headset does not answer yet."""
        host = f"[{self.address}]" if ":" in self.address else self.address
        method, longest = avp.METHOD, avp.MOST_BYTES
        return GrpcInbox("the source 'avp'", "avp", f"{host}:{self.port}", method, longest)

    def reader(self) -> Reader:
        """Reads the messages."""
        repeats = Repeats(wrist=True)

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, connection = message
            return [
                Reading(frame, connection.decode())
                for frame in map(repeats.new, avp.read_hands(data))
                if frame is not None
            ]

        return read


NODES: Final = 25

_TOPIC = re.compile(rb"\s*([A-Za-z_/0-9]{0,64})\s*(?=[{\[])")
_CSV_HAND: Final = 1 + NODES * 7
_CSV_ANGLES: Final = 40  # the Bidex bridge's joint angles of both hands, between its skeletons
_XYZW: Final = [3, 0, 1, 2]
_IN_ORDER: Final = list(range(NODES))


def read_manus(
    data: bytes, *, gloves: Mapping[str, Side], side: Side | None
) -> tuple[Reading, ...]:
    """Reads the hands of a message; empty for a message with joint angles.

    Args:
        data: the message; several parts are joined with spaces.
        gloves: glove id in the bridge's notation -> side, for bridges that send no sides.
        side: side of a message with neither a side nor a glove in ``gloves``; None refuses it.

    Raises:
        RecordingError: the message can't be read; the error states the reason.
    """
    check_size(data)
    topic_match = _TOPIC.match(data)
    if topic_match is None:
        return _read_csv(data, gloves, side)
    topic = topic_match[1].decode().lower().rpartition("/")[2]
    expected: Side | None = topic if topic in ("right", "left") else side  # type: ignore[assignment]
    message = parse_json(data[topic_match.end() :])
    return tuple(read_glove(hand, gloves, expected) for hand in _hands(message))


def _hands(message: Any) -> Sequence[Mapping[str, Any]]:
    """One object per hand of a message, with the message's common fields added."""
    if not isinstance(message, dict):
        return with_shared(message, {})
    if "hands" in message or "gloves" in message:
        return with_shared(message.get("hands", message.get("gloves")), message)
    if not (keys := [key for key in message if key.lower() in ("right", "left")]):
        return [message]
    hands = [{"side": key, **message[key]} for key in keys if isinstance(message[key], dict)]
    return with_shared(hands, message)


def read_glove(
    message: Mapping[str, Any], gloves: Mapping[str, Side], side: Side | None
) -> Reading:
    """Reads one hand, a JSON object with ``nodes``; see ``read_manus``."""
    key = next((key for key in ("nodes", "raw_nodes", "data") if key in message), None)
    if key is None:
        raise RecordingError(
            f"the message has no 'nodes'; it has {', '.join(list(message)[:8]) or 'nothing'}"
        )
    positions, quaternions = _read_nodes(message[key], key, message.get("quaternion_order"))
    try:
        stamp = read_stamp(message)
    except RecordingError:
        if "stamp" in message:  # unlike 'timestamp', it is never the SDK's packed date
            raise
        stamp = None
    frame = hand_frame(
        positions,
        stamp=stamp,
        side=_side(message.get("side"), message.get("glove_id"), gloves, side),
        orientations=quaternions,
        **read_wrist(message),
    )
    return Reading(frame, read_session(message))


def _side(label: Any, glove: Any, gloves: Mapping[str, Side], otherwise: Side | None) -> Side:
    if str(glove).lower() in gloves:  # a bridge that is starting may send a wrong side
        return gloves[str(glove).lower()]
    if str(label).lower() in ("unknown", "none", ""):
        label = None
    if label is None and otherwise is None:
        raise RecordingError(
            f"the message does not contain the side of glove {glove!r}; set "
            f"right_glove={glove} or left_glove={glove}, or use only one hand: side=right"
        )
    return read_side(label, otherwise)


def _read_nodes(
    nodes: Any, key: str, order: Any
) -> tuple[Float[np.ndarray, "25 3"], Float[np.ndarray, "25 4"] | None]:
    """Positions and quaternions wxyz of the nodes, in the order of their ids."""
    if not isinstance(nodes, list) or not nodes:
        raise RecordingError(f"'{key}' must be a list of {NODES} nodes")
    if isinstance(nodes[0], dict):
        ids, rows = _read_objects(nodes, key)
    else:
        ids, rows = list(range(len(nodes))), read_numbers(nodes, f"'{key}'")
        if rows.ndim == 1 and rows.size in (NODES * 3, NODES * 7):
            rows = rows.reshape(NODES, -1)
            ids = list(range(NODES))
        if rows.ndim != 2 or len(rows) != NODES or rows.shape[1] not in (3, 7):
            raise RecordingError(
                f"'{key}' must be {NODES} rows of x, y, z and a quaternion, not shape {rows.shape}"
            )
        if str(order).lower() == "xyzw" and rows.shape[1] == 7:
            rows[:, 3:] = rows[:, 3:][:, _XYZW]
    if ids == _IN_ORDER:
        return _split(rows)
    places = [i for i, node in enumerate(ids) if 0 <= node < NODES]
    targets = [ids[i] for i in places]
    if len(set(targets)) != len(targets):
        raise RecordingError(f"'{key}' contains a node more than once: {ids}")
    if len(targets) < NODES:
        missing = sorted(set(range(NODES)) - set(targets))
        raise RecordingError(
            f"'{key}' must contain the nodes 0 to {NODES - 1}, but these are missing: {missing}"
        )
    sorted_rows = np.empty((NODES, rows.shape[1]))
    sorted_rows[targets] = rows[places]
    return _split(sorted_rows)


def _split(
    rows: Float[np.ndarray, "25 c"],
) -> tuple[Float[np.ndarray, "25 3"], Float[np.ndarray, "25 4"] | None]:
    """Positions and quaternions; None if no node has a quaternion."""
    quaternions = rows[:, 3:]
    tracked = quaternions.shape[1] == 4 and bool(np.isfinite(quaternions).any())
    return rows[:, :3], quaternions if tracked else None


def _read_objects(nodes: Sequence[Any], key: str) -> tuple[list[int], Float[np.ndarray, "n 7"]]:
    ids: list[int] = []
    rows: list[Any] = []
    try:
        for node in nodes:
            ids.append(int(node["id"] if "id" in node else node["node_id"]))
            if "pos" in node:
                place, turn = node["pos"] or (None,) * 3, node.get("quat") or (None,) * 4
                rows.append([*place, *turn])
            else:
                pose = node["pose"]
                place, turn = pose["position"], pose["orientation"]
                rows.append([*(place[k] for k in "xyz"), *(turn[k] for k in "wxyz")])
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise RecordingError(
            f"each node in '{key}' must have 'id', 'pos' (x, y, z) and 'quat' (w, x, y, z), or "
            f"'node_id' and 'pose'; one of them does not: {type(error).__name__}: {error}"
        ) from error
    read = read_numbers(rows, f"'pos' and 'quat' of the '{key}'")
    if read.shape != (len(nodes), 7):
        raise RecordingError(f"each node in '{key}' must have 3 + 4 numbers, not {read.shape[1:]}")
    return ids, read


def _read_csv(data: bytes, gloves: Mapping[str, Side], side: Side | None) -> tuple[Reading, ...]:
    fields = data.decode("ascii", "replace").strip().rstrip(",").split(",")
    if len(fields) == _CSV_ANGLES:
        return ()
    if len(fields) not in (_CSV_HAND, 2 * _CSV_HAND):
        raise RecordingError(
            f"the message is neither JSON nor {_CSV_HAND} or {2 * _CSV_HAND} fields separated by "
            f"commas; it has {len(fields)} fields"
        )
    readings = []
    for start in range(0, len(fields), _CSV_HAND):
        glove = fields[start].strip()
        rows = read_numbers(fields[start + 1 : start + _CSV_HAND], "the fields after the glove id")
        rows = rows.reshape(NODES, 7)
        frame = hand_frame(
            rows[:, :3],
            side=_side(None, glove, gloves, side if len(fields) == _CSV_HAND else None),
            orientations=rows[:, 3:][:, _XYZW],
        )
        readings.append(Reading(frame))
    return tuple(readings)


def glove_sides(right: str | None, left: str | None) -> dict[str, Side]:
    """Glove id in lower case -> side; raises ConfigError if both ids are the same."""
    if right is not None and right == left:
        raise ConfigError(f"right_glove and left_glove are both {right!r}")
    gloves: tuple[tuple[str | None, Side], ...] = ((right, "right"), (left, "left"))
    return {glove.lower(): side for glove, side in gloves if glove is not None}


@dataclass(frozen=True)
class ManusStream(StreamSource):
    """Source with one or two hands per message of a MANUS glove bridge.

    Attributes:
        address: address of the bridge, which may start later.
        side: hands to use. With one hand, messages without a side count as that hand.
        right_glove: id of the right glove, for a bridge that does not send sides.
        left_glove: id of the left glove.
        pattern: ``sub`` for bridges that publish, ``pull`` for those that push (Bidex).
        bind: listen on the address, for a bridge that connects.

    Raises:
        ConfigError: a setting is outside its range.
    """

    address: str = "tcp://127.0.0.1:8000"
    side: Hands = "both"
    right_glove: str | None = None
    left_glove: str | None = None
    pattern: Pattern = "sub"
    bind: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        glove_sides(self.right_glove, self.left_glove)

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"MANUS gloves at {self.address}"

    def connect(self) -> Inbox:
        """Opens the socket."""
        return ZmqInbox("the source 'manus'", self.address, bind=self.bind, pattern=self.pattern)

    def reader(self) -> Reader:
        """Returns a function that reads the messages of a bridge."""
        gloves, side = glove_sides(self.right_glove, self.left_glove), only_side(self.side)

        def read(message: Message, received: float) -> Sequence[Reading]:
            return read_manus(b" ".join(message), gloves=gloves, side=side)

        return read
