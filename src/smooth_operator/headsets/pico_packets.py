"""Decodes packets from the PICO app XRoboToolkit to hand frames.

The app connects to the PC service's TCP port 63901 and sends packets, little-endian:

======  ===============  =====================================================================
byte    type             content
======  ===============  =====================================================================
0       1 byte           0x3F
1       1 byte           command: 0x19 connection, 0x6C version, 0x23 heartbeat, 0x6D function
2       uint32           length n of the body
6       n bytes          body, text in UTF-8
6 + n   int64            Unix time [ms]
14 + n  1 byte           0xA5
======  ===============  =====================================================================

The body of the function ``Tracking`` is JSON whose ``value`` is a string of JSON (other clients of
the protocol send an object)::

    {"functionName": "Tracking", "value": "{\\"Hand\\": {\\"rightHand\\": {\\"isActive\\": 1,
        \\"HandJointLocations\\": [{\\"p\\": \\"x,y,z,qx,qy,qz,qw\\", \\"s\\": 15}, ...]}},
        \\"timeStampNs\\": 1732613438765715200, ...}"}

The 26 joints have OpenXR's order and axes: right-handed, x right, y up, z to the wearer.
``s`` has the bits of XrSpaceLocationFlags: 1 orientation valid, 2 position valid, 4 and 8 tracked.

Source: ``TrackingData.cs``, ``TcpHandler.cs`` and ``NetCMD.cs`` of
XR-Robotics/XRoboToolkit-Unity-Client, ``PackageHandle.cs`` of its Quest edition. The description of
the PC service calls the frame left-handed, but its z is opposite to Unity's, which makes it
right-handed. The axes ``unity`` are left-handed.
"""

from __future__ import annotations

import struct
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import DocumentError, RecordingError, brief
from smooth_operator.headsets.openxr_joints import JOINTS, Axes, openxr_frame
from smooth_operator.io import documents
from smooth_operator.types import HandFrame, Side

PORT: Final = 63_901
WORLD: Final = "pico"
"""Name of the world frame: the pose of the headset at the start of the app."""
MOST_BYTES: Final = 60_000
"""Size of the longest accepted body; all data that the app can track take half of it."""

HEAD: Final = 0x3F
END: Final = 0xA5
FUNCTION: Final = 0x6D

_HEADER: Final = struct.Struct("<BBI")
_TAIL: Final = struct.Struct("<qB")
_SIDES: Final[tuple[tuple[str, Side], ...]] = (("leftHand", "left"), ("rightHand", "right"))


def split_packets(buffer: bytearray) -> list[bytes]:
    """Removes complete packets from the front of a buffer and returns them; incomplete data stays
    in the buffer.

    Data that do not begin with a packet are returned as one piece, which ``read_packet`` refuses.
    """
    packets = []
    while buffer:
        size = _size(buffer)
        if size is None:
            size = len(buffer)
        elif size == 0 or size > len(buffer):
            break
        packets.append(bytes(buffer[:size]))
        del buffer[:size]
    return packets


def begins_packet(data: bytes | bytearray) -> bool:
    """True if some bytes (at least one) can be the beginning of a packet."""
    return _size(data) is not None


def _size(buffer: bytes | bytearray) -> int | None:
    """Size of the first packet [bytes]; 0 if it is not known yet; None if there is no packet."""
    if buffer[0] != HEAD:
        return None
    if len(buffer) < _HEADER.size:
        return 0
    length: int = _HEADER.unpack_from(buffer)[2]
    size = _HEADER.size + length + _TAIL.size
    if length > MOST_BYTES or (len(buffer) >= size and buffer[size - 1] != END):
        return None
    return size


def read_packet(data: bytes, axes: Axes = "openxr") -> tuple[HandFrame, ...]:
    """Reads the visible hands of a packet, left first. Their stamps are Unix times on the headset's
    clock, or None. Raises RecordingError if the data are not a packet, or if its hands can't be
    read."""
    size = _size(data) if data else None
    if size is None or size != len(data):
        raise RecordingError(
            "a packet must begin with 0x3F, be as long as its header states, and end with 0xA5; "
            f"this one has {len(data)} bytes and begins with {data[:8]!r}. Is another program "
            "sending to this port?"
        )
    if data[1] != FUNCTION:
        return ()
    message = _json(data[_HEADER.size : -_TAIL.size])
    if not isinstance(message, dict) or message.get("functionName") != "Tracking":
        return ()
    value = message.get("value")
    tracking = _json(value.encode()) if isinstance(value, str) else value
    if not isinstance(tracking, dict):
        raise RecordingError(f"'value' must be an object, not {brief(value)}")
    stamp = _stamp(tracking.get("timeStampNs"))
    hands = tracking.get("Hand", {})
    if not isinstance(hands, dict):
        raise RecordingError(f"'Hand' must be an object, not {brief(hands)}")
    frames = (_hand(hands[key], key, side, stamp, axes) for key, side in _SIDES if key in hands)
    return tuple(frame for frame in frames if frame is not None)


def _json(data: bytes) -> Any:
    try:
        return documents.parse_json(data)
    except DocumentError as error:
        raise RecordingError(f"the packet is not JSON: {error}") from error


def _stamp(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < 1e20:
        raise RecordingError(f"'timeStampNs' must be nanoseconds, not {brief(value)}")
    return float(value) / 1e9 if isinstance(value, float) else value / 1_000_000_000


def _hand(hand: Any, key: str, side: Side, stamp: float | None, axes: Axes) -> HandFrame | None:
    """Decodes a hand; None if the headset does not see it."""
    joints = hand.get("HandJointLocations") if isinstance(hand, dict) else None
    if not isinstance(joints, list) or len(joints) != JOINTS:
        raise RecordingError(
            f"'{key}' must have {JOINTS} 'HandJointLocations', not "
            f"{len(joints) if isinstance(joints, list) else brief(joints)}"
        )
    if not hand.get("isActive", True):
        return None
    poses, flags = _joints(joints, key)
    where = f"'{key}'"
    return openxr_frame(poses, flags, side, stamp, world=WORLD, where=where, axes=axes)


def _joints(
    joints: list[Any], key: str
) -> tuple[Float[np.ndarray, "26 7"], np.ndarray[Any, np.dtype[np.int64]]]:
    poses, flags = [], []
    for joint in joints:
        try:
            numbers = [float(word) for word in joint["p"].split(",")]
            flag = int(joint.get("s", 0))
        except (TypeError, KeyError, ValueError, AttributeError, OverflowError):
            numbers, flag = [], 0
        if len(numbers) != 7 or not 0 <= flag < 2**31:
            raise RecordingError(
                f"a joint of '{key}' must have 'p' with 7 numbers and 's', not {brief(joint)}"
            )
        poses.append(numbers)
        flags.append(flag)
    return np.array(poses), np.array(flags, np.int64)
