"""One moment of both hands as the page sends it: a binary message, little-endian.

======  ===============  =======================================================================
byte    type             holds
======  ===============  =======================================================================
0       4 bytes          ``XRH1``
4       uint32           number of the XR frame, counted from 0 by the page; also those that it
                         did not send are counted
8       float64          stamp: the page's ``performance.now()`` [s]
16      uint32           hands that follow: 1 left, 2 right, 3 left then right, 0 none
20      uint32           reference space: 0 ``local``, 1 ``local-floor``
24      float32 x 200    for each hand 25 joints in WebXR's order, for each joint x, y, z [m],
                         quaternion x, y, z, w, radius [m]; NaN where the headset has none
======  ===============  =======================================================================

WebXR's frame is right-handed, y up, in metres; its origin is where the headset was at the start, on
the floor in ``local-floor``. The wrist's pose is that of the joint ``wrist``, in our axes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.landmarks import FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.poses import to_ours
from smooth_operator.teleop.sources.live import LATEST_STAMP_S
from smooth_operator.types import HandFrame, Side

MAGIC: Final = b"XRH1"
SPACES: Final = ("local", "local-floor")
"""Reference spaces of the page, by their number in a message."""
JOINTS: Final = 25
VALUES: Final = 8
HEADER: Final = struct.Struct("<4sIdII")
_HAND_BYTES: Final = JOINTS * VALUES * 4
MAX_BYTES: Final = HEADER.size + 2 * _HAND_BYTES
_SIDES: Final[tuple[tuple[int, Side], ...]] = ((1, "left"), (2, "right"))

_LANDMARKS: Final = np.array(FROM_WEBXR_25)
_METACARPALS: Final = np.array(METACARPALS_WEBXR_25)
_WXYZ: Final = np.array([6, 3, 4, 5])
_FAR: Final = 100.0  # [m] from where the headset started; no room is that large


@dataclass(frozen=True, eq=False)
class Packet:
    """One moment.

    Attributes:
        number: of the XR frame.
        stamp: by the page's clock [s].
        frames: those of the hands that the headset sees, left first.
    """

    number: int
    stamp: float
    frames: tuple[HandFrame, ...]


def read_packet(message: bytes) -> Packet:
    """A message of the page.

    Raises:
        RecordingError: it is none.
    """
    if len(message) < HEADER.size or message[:4] != MAGIC:
        raise RecordingError(f"expected a message that begins with {MAGIC!r}, got {message[:4]!r}")
    _, number, stamp, hands, space = HEADER.unpack_from(message)
    if not abs(stamp) < LATEST_STAMP_S:
        raise RecordingError(f"the stamp must be a finite number of seconds, not {stamp:.6g}")
    sides = [side for bit, side in _SIDES if hands & bit]
    if hands > 3 or len(message) != HEADER.size + len(sides) * _HAND_BYTES:
        raise RecordingError(
            f"expected {len(sides)} hands in {HEADER.size + len(sides) * _HAND_BYTES} bytes, "
            f"got {len(message)}"
        )
    values = np.frombuffer(message, "<f4", offset=HEADER.size).astype(np.float64)
    joints = values.reshape(len(sides), JOINTS, VALUES)
    world = f"webxr/{SPACES[space]}" if space < len(SPACES) else "webxr"
    frames = tuple(_frame(joints[i], stamp, side, world) for i, side in enumerate(sides))
    return Packet(number, stamp, frames)


def _frame(joints: Float[np.ndarray, "25 8"], stamp: float, side: Side, world: str) -> HandFrame:
    points = joints[:, :3]
    with np.errstate(invalid="ignore"):
        points = np.where((np.abs(points) < _FAR).all(axis=1, keepdims=True), points, np.nan)
        turns = joints[:, _WXYZ]
        size = np.linalg.norm(turns, axis=1, keepdims=True)
        turns = np.where(np.abs(size - 1.0) < 0.1, turns / np.where(size > 0, size, 1.0), np.nan)
    return HandFrame(
        points[_LANDMARKS],
        stamp,
        side,
        metacarpals=points[_METACARPALS],
        orientations=turns[_LANDMARKS],
        T_world_wrist=to_ours(np.concatenate([points[0], turns[0]])),
        world=world,
    )
