"""Messages of hand landmarks from anywhere: numbers as bytes, or JSON.

A message is one of

- 21 x 3 numbers, little-endian float32 (252 bytes) or float64 (504 bytes), row by row;
- JSON: ``{"stamp": 12.5, "side": "right", "landmarks": [[x, y, z], ...], "valid": [true, ...]}``,
  where only ``landmarks`` is needed; or ``{"hands": [...]}`` with several of them; or the
  landmarks alone.

In place of 21 landmarks there may be 25 (MANUS, WebXR) or 26 (OpenXR), which are mapped. Nothing
here waits, keeps state or unpickles: bytes in, hand frames out, or an error that says why not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator import landmarks as schema
from smooth_operator.errors import ConfigError, DocumentError, RecordingError
from smooth_operator.formats.checks import PALM_RANGE_M, check_units
from smooth_operator.io import documents
from smooth_operator.io.anatomy import layout_order
from smooth_operator.teleop.sources.live import LATEST_STAMP_S
from smooth_operator.types import HandFrame, Side, as_side

MAX_BYTES: Final = 65_536
"""Longest message that is read. Both hands of the wordiest bridge need a third of it."""

_BINARY: Final = {
    count * 3 * size: (count, f"<f{size}") for count in schema.NODE_LAYOUTS for size in (4, 8)
}
_MIDDLE: Final = schema.index("middle_mcp")
_WHERE: Final = "the message"


@dataclass(frozen=True, eq=False)
class Reading:
    """One hand of a message.

    Attributes:
        frame: the hand; its stamp is the time of receipt where the message has none.
        stamped: whether the stamp is the tracker's own.
        session: what the tracker calls its present start, if it says so.
    """

    frame: HandFrame
    stamped: bool = False
    session: str | None = None


def read_payload(
    data: bytes, *, side: Side | None, received: float, layout: str | None = None
) -> tuple[Reading, ...]:
    """Read a message.

    Args:
        data: the message.
        side: which hand it is where it does not say; None refuses a message that does not say.
        received: when it came, the stamp where it has none [s].
        layout: order of the landmarks in a message of 21; None for the project's own.

    Raises:
        RecordingError: it can't be read: too long, of no known size, broken JSON, a wrong shape,
            no stamp in seconds, no side, landmarks in another unit (with the likely factor).
    """
    check_size(data)
    binary = _BINARY.get(len(data))
    if data[:1] in (b"{", b"["):
        try:
            message = parse_json(data)
        except RecordingError:
            if binary is None:  # of 128 messages of numbers, one starts with such a byte
                raise
        else:
            return _read_json(message, side, received, layout)
    if binary is None:
        sizes = ", ".join(str(size) for size in _BINARY)
        raise RecordingError(
            f"a message of {len(data)} bytes is neither JSON (an object or a list) nor 21 x 3 "
            f"numbers: float32 has 252 bytes, float64 504 (sizes that are read: {sizes})"
        )
    count, dtype = binary
    points = np.frombuffer(data, dtype).reshape(count, 3).astype(np.float64)
    frame = hand_frame(points, stamp=received, side=_known(side), layout=layout)
    return (Reading(frame),)


def check_size(data: bytes) -> None:
    """Refuse a message that is empty or too long.

    Raises:
        RecordingError: with the size and the bound.
    """
    if not data:
        raise RecordingError("the message is empty")
    if len(data) > MAX_BYTES:
        raise RecordingError(f"a message of {len(data)} bytes is too long; at most {MAX_BYTES}")


def parse_json(data: bytes | str) -> Any:
    """The value of a JSON text.

    Raises:
        RecordingError: it is not JSON.
    """
    try:
        return documents.parse_json(data)
    except DocumentError as error:
        raise RecordingError(f"{_WHERE} is not JSON: {error}") from error


def hand_frame(
    points: Float[np.ndarray, "n 3"],
    *,
    stamp: float,
    side: Side,
    valid: Any = None,
    orientations: Float[np.ndarray, "n 4"] | None = None,
    metacarpals: Float[np.ndarray, "4 3"] | None = None,
    layout: str | None = None,
) -> HandFrame:
    """A hand frame from a tracker's own points.

    Args:
        points: (21, 3), (25, 3) or (26, 3) positions [m]; NaN where missing. All exactly zero is a
            tracker's "no hand".
        stamp: [s].
        side: which hand.
        valid: flags of the points, or of the 21 landmarks.
        orientations: quaternions wxyz of the points; made unit quaternions.
        metacarpals: where the points do not hold them.
        layout: order of 21 points; None for the project's own.

    Raises:
        RecordingError: a wrong shape, or another unit than metres.
    """
    if len(points) not in schema.NODE_LAYOUTS:
        raise RecordingError(
            f"{_WHERE} has {len(points)} points; a hand has 21, or 25 (MANUS, WebXR), "
            "or 26 (OpenXR)"
        )
    picked, bases = schema.NODE_LAYOUTS[len(points)]
    rows = np.array(layout_order(layout) if len(points) == schema.NUM_LANDMARKS else picked)
    landmarks = points[rows]
    flags = np.isfinite(landmarks).all(axis=1)
    if valid is not None:
        flags &= _flags(valid, len(points), rows)
    if not landmarks.any():  # NaN counts as something here, and is invalid anyway
        flags[:] = False
    _check_palm(landmarks, flags)
    return HandFrame(
        landmarks,
        stamp,
        side,
        valid=flags,
        metacarpals=metacarpals if bases is None else points[list(bases)],
        orientations=None if orientations is None else _unit(orientations[rows]),
    )


def read_stamp(message: Mapping[str, Any]) -> float | None:
    """The stamp of a message [s], None where it has none.

    Raises:
        RecordingError: it is no finite number of seconds.
    """
    stamp = message.get("stamp", message.get("timestamp"))
    if stamp is None:
        return None
    if isinstance(stamp, bool) or not isinstance(stamp, (int, float)) or not _finite(stamp):
        raise RecordingError(f"the stamp must be a finite number of seconds, not {_short(stamp)}")
    if abs(stamp) < LATEST_STAMP_S:
        return float(stamp)
    units = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
    likely = next((u for u, factor in units.items() if abs(stamp) * factor < LATEST_STAMP_S), None)
    hint = f"; it looks like {likely} (multiply by {units[likely]:g})" if likely else ""
    raise RecordingError(f"the stamp must be in seconds, not {stamp:.6g}{hint}")


def read_side(label: Any, otherwise: Side | None) -> Side:
    """The side that a message names, or the one that is known otherwise.

    Raises:
        RecordingError: it names another, or none where none is known.
    """
    if label is None:
        return _known(otherwise)
    try:
        return as_side(str(label))
    except ConfigError:
        raise RecordingError(f"the side must be 'right' or 'left', not {_short(label)}") from None


def read_numbers(value: Any, what: str) -> Float[np.ndarray, "..."]:
    """Numbers of a JSON value as an array; null is NaN.

    Raises:
        RecordingError: there is something else in it, or its rows differ in length.
    """
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingError(f"{what} must be numbers in rows of one length: {error}") from error


def read_session(message: Mapping[str, Any]) -> str | None:
    """What a message calls the tracker's present start."""
    session = message.get("session")
    return None if session is None else str(session)[:64]


def _read_json(
    message: Any, side: Side | None, received: float, layout: str | None
) -> tuple[Reading, ...]:
    if isinstance(message, list):
        return (_read_hand({"landmarks": message}, side, received, layout),)
    hands = message.get("hands")
    if hands is None:
        return (_read_hand(message, side, received, layout),)
    if not isinstance(hands, list) or not all(isinstance(hand, dict) for hand in hands):
        raise RecordingError("'hands' must be a list of objects, one for each hand")
    shared = {key: message[key] for key in ("stamp", "timestamp", "session") if key in message}
    return tuple(_read_hand({**shared, **hand}, side, received, layout) for hand in hands)


def _read_hand(
    message: Mapping[str, Any], side: Side | None, received: float, layout: str | None
) -> Reading:
    found = next((key for key in ("landmarks", "joints") if key in message), None)
    if found is None:
        keys = ", ".join(map(_short, list(message)[:8])) or "nothing"
        raise RecordingError(f"{_WHERE} has no 'landmarks', but {keys}")
    points = read_numbers(message[found], f"'{found}'")
    if points.ndim == 1 and points.size % 3 == 0:
        points = points.reshape(-1, 3)
    if points.ndim != 2 or points.shape[1] != 3:
        raise RecordingError(f"'{found}' must be 21 rows of x, y, z, not shape {points.shape}")
    stamp = read_stamp(message)
    frame = hand_frame(
        points,
        stamp=received if stamp is None else stamp,
        side=read_side(message.get("side"), side),
        valid=message.get("valid"),
        orientations=_beside(message, "orientations", (len(points), 4)),
        metacarpals=_beside(message, "metacarpals", (4, 3)),
        layout=layout,
    )
    return Reading(frame, stamp is not None, read_session(message))


def _beside(message: Mapping[str, Any], key: str, shape: tuple[int, int]) -> np.ndarray | None:
    if message.get(key) is None:
        return None
    value = read_numbers(message[key], f"'{key}'")
    if value.shape != shape:
        raise RecordingError(f"'{key}' must have shape {shape}, not {value.shape}")
    return value


def _known(side: Side | None) -> Side:
    if side is None:
        raise RecordingError(
            f"{_WHERE} does not say which hand it is; send JSON with 'side', or take one hand only "
            "(side=right or side=left)"
        )
    return side


def _flags(valid: Any, count: int, rows: np.ndarray) -> np.ndarray:
    good = isinstance(valid, list) and all(isinstance(flag, (bool, int)) for flag in valid)
    if not good or len(valid) not in (count, len(rows)):
        raise RecordingError(f"'valid' must be {count} times true or false, not {_short(valid)}")
    flags: np.ndarray = np.array(valid, bool)
    return flags[rows] if len(flags) == count else flags


def _check_palm(landmarks: Float[np.ndarray, "21 3"], valid: np.ndarray) -> None:
    """Refuse another unit, where the palm is seen; a hand that is not seen has none."""
    if not (valid[schema.WRIST] and valid[_MIDDLE]):
        return
    palm = math.dist(landmarks[schema.WRIST].tolist(), landmarks[_MIDDLE].tolist())
    if not PALM_RANGE_M[0] <= palm <= PALM_RANGE_M[1]:
        check_units(landmarks[None], valid[None], _WHERE)  # it has the words


def _unit(quaternions: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit: np.ndarray = np.full_like(quaternions, np.nan)
    np.divide(quaternions, norms, out=unit, where=norms > 0.0)
    return unit


def _finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
