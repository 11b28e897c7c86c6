"""Messages of MANUS glove bridges: the 25 nodes of a raw skeleton, in several forms.

The main form is that of ``ManusZmqBridge`` (the program of the MANUS recordings), with three more
fields::

    RIGHT {"glove_id": 3064964832, "side": "right", "session": "a1", "stamp": 12.505,
           "nodes": [{"id": 0, "pos": [x, y, z], "quat": [w, x, y, z]}, ...]}

Other bridges send these forms: both hands in one message; nodes as 25 rows of x y z
and a quaternion; the ROS 2 message ``ManusGlove`` as JSON (``raw_nodes`` with a ``pose`` each); and
lines of ``glove id, 25 x (x, y, z, qx, qy, qz, qw)`` separated by commas, of one hand or two, as
the Bidex bridge pushes them. ``docs/how-to/manus.md`` has an example of each.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.teleop.sources.inboxes import Inbox, Message, Pattern, ZmqInbox
from smooth_operator.teleop.sources.payload import (
    Reading,
    check_size,
    hand_frame,
    parse_json,
    read_numbers,
    read_session,
    read_side,
    read_stamp,
    read_wrist,
)
from smooth_operator.teleop.sources.stream import (
    Hands,
    Reader,
    StreamSource,
    only_side,
    sides_of,
)
from smooth_operator.types import Side

NODES: Final = 25

_TOPIC = re.compile(rb"\s*([A-Za-z_/0-9]{0,64})\s*(?=[{\[])")
_CSV_HAND: Final = 1 + NODES * 7
_CSV_ANGLES: Final = 40  # the Bidex bridge's joint angles of both hands, between its skeletons
_XYZW: Final = [3, 0, 1, 2]
_IN_ORDER: Final = list(range(NODES))


def read_manus(
    data: bytes, *, gloves: Mapping[str, Side], side: Side | None, received: float
) -> tuple[Reading, ...]:
    """Read a message.

    Args:
        data: the message; several parts are joined with spaces.
        gloves: glove id, as the bridge prints it -> side, for bridges that send no sides.
        side: side of a message with neither a side nor a glove in ``gloves``; None refuses it.
        received: time of receipt [s], the stamp of a message without one.

    Returns:
        hands of the message; empty for one of joint angles alone.

    Raises:
        RecordingError: the message can't be read, with the reason.
    """
    check_size(data)
    topic_match = _TOPIC.match(data)
    if topic_match is None:
        return _read_csv(data, gloves, side, received)
    topic = topic_match[1].decode().lower().rpartition("/")[2]
    expected: Side | None = topic if topic in ("right", "left") else side  # type: ignore[assignment]
    message = parse_json(data[topic_match.end() :])
    return tuple(read_glove(hand, gloves, expected, received) for hand in _hands(message))


def _hands(message: Any) -> list[Mapping[str, Any]]:
    """Hands of a message, each with the common fields of the message."""
    hands: Any = message
    if isinstance(message, dict):
        shared = {k: message[k] for k in ("stamp", "timestamp", "session", "world") if k in message}
        if "hands" in message or "gloves" in message:
            hands = message.get("hands", message.get("gloves"))
        elif keys := [key for key in message if key.lower() in ("right", "left")]:
            hands = [
                {"side": key, **message[key]} for key in keys if isinstance(message[key], dict)
            ]
        else:
            return [message]
        if isinstance(hands, list):
            hands = [{**shared, **hand} if isinstance(hand, dict) else hand for hand in hands]
    if not isinstance(hands, list) or not all(isinstance(hand, dict) for hand in hands):
        raise RecordingError("several hands must come as a list of objects, one for each hand")
    return hands


def read_glove(
    message: Mapping[str, Any], gloves: Mapping[str, Side], side: Side | None, received: float
) -> Reading:
    """Read one hand, an object of JSON with ``nodes``; see ``read_manus``.

    Raises:
        RecordingError: it can't be read, with the reason.
    """
    key = next((key for key in ("nodes", "raw_nodes", "data") if key in message), None)
    if key is None:
        raise RecordingError(
            f"the message has no 'nodes', but {', '.join(list(message)[:8]) or 'nothing'}"
        )
    positions, quaternions = _read_nodes(message[key], key, message.get("quaternion_order"))
    try:
        stamp = read_stamp(message)
    except RecordingError:
        if "stamp" in message:  # ours; a bridge's 'timestamp' may be the SDK's packed date
            raise
        stamp = None
    frame = hand_frame(
        positions,
        stamp=received if stamp is None else stamp,
        side=_side(message.get("side"), message.get("glove_id"), gloves, side),
        orientations=quaternions,
        **read_wrist(message),
    )
    return Reading(frame, stamp is not None, read_session(message))


def _side(label: Any, glove: Any, gloves: Mapping[str, Side], otherwise: Side | None) -> Side:
    if str(glove).lower() in gloves:  # the user knows better than a bridge that is starting
        return gloves[str(glove).lower()]
    if str(label).lower() in ("unknown", "none", ""):
        label = None
    if label is None and otherwise is None:
        raise RecordingError(
            f"the message does not say which hand glove {glove!r} is on; name it: "
            f"right_glove={glove} or left_glove={glove}, or take one hand only: side=right"
        )
    return read_side(label, otherwise)


def _read_nodes(
    nodes: Any, key: str, order: Any
) -> tuple[Float[np.ndarray, "25 3"], Float[np.ndarray, "25 4"] | None]:
    """Positions and quaternions wxyz of the nodes, at the index of their id."""
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
        raise RecordingError(f"'{key}' holds a node more than once: {ids}")
    if len(targets) < NODES:
        missing = sorted(set(range(NODES)) - set(targets))
        raise RecordingError(f"'{key}' must hold the nodes 0 to {NODES - 1}, but lacks {missing}")
    sorted_rows = np.empty((NODES, rows.shape[1]))
    sorted_rows[targets] = rows[places]
    return _split(sorted_rows)


def _split(
    rows: Float[np.ndarray, "25 c"],
) -> tuple[Float[np.ndarray, "25 3"], Float[np.ndarray, "25 4"] | None]:
    """Positions and quaternions, None where no node has one."""
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
            f"each of the '{key}' must have 'id', 'pos' (x, y, z) and 'quat' (w, x, y, z), or "
            f"'node_id' and 'pose'; one has not: {type(error).__name__}: {error}"
        ) from error
    read = read_numbers(rows, f"'pos' and 'quat' of the '{key}'")
    if read.shape != (len(nodes), 7):
        raise RecordingError(f"each of the '{key}' must have 3 + 4 numbers, not {read.shape[1:]}")
    return ids, read


def _read_csv(
    data: bytes, gloves: Mapping[str, Side], side: Side | None, received: float
) -> tuple[Reading, ...]:
    fields = data.decode("ascii", "replace").strip().rstrip(",").split(",")
    if len(fields) == _CSV_ANGLES:
        return ()
    if len(fields) not in (_CSV_HAND, 2 * _CSV_HAND):
        raise RecordingError(
            f"the message is neither JSON nor {_CSV_HAND} or {2 * _CSV_HAND} fields separated by "
            f"commas, but {len(fields)}"
        )
    readings = []
    for start in range(0, len(fields), _CSV_HAND):
        glove = fields[start].strip()
        rows = read_numbers(fields[start + 1 : start + _CSV_HAND], "the fields after the glove id")
        rows = rows.reshape(NODES, 7)
        frame = hand_frame(
            rows[:, :3],
            stamp=received,
            side=_side(None, glove, gloves, side if len(fields) == _CSV_HAND else None),
            orientations=rows[:, 3:][:, _XYZW],
        )
        readings.append(Reading(frame))
    return tuple(readings)


def glove_sides(right: str | None, left: str | None) -> dict[str, Side]:
    """Glove id, in small letters -> side, for the gloves whose side the user names.

    Raises:
        ConfigError: both are one glove.
    """
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
        right_glove: id of the right glove, for a bridge that sends no sides.
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
        sides_of(self.side)
        glove_sides(self.right_glove, self.left_glove)

    @property
    def label(self) -> str:
        """Name for a person, in a few words."""
        return f"MANUS gloves at {self.address}"

    def connect(self) -> Inbox:
        """Open the socket."""
        return ZmqInbox("the source 'manus'", self.address, bind=self.bind, pattern=self.pattern)

    def reader(self) -> Reader:
        """Reads the messages of a bridge."""
        gloves, side = glove_sides(self.right_glove, self.left_glove), only_side(self.side)

        def read(message: Message, received: float) -> Sequence[Reading]:
            return read_manus(b" ".join(message), gloves=gloves, side=side, received=received)

        return read
