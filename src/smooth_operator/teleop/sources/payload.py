"""Reads messages with hand landmarks from other programs, as bytes or JSON.

A message is one of

- 21 x 3 numbers, little-endian float32 (252 bytes) or float64 (504 bytes), row by row;
- JSON: ``{"stamp": 12.5, "side": "right", "landmarks": [[x, y, z], ...], "valid": [true, ...]}``,
  where only ``landmarks`` is required; or ``{"hands": [...]}`` with several hands; or the
  landmarks alone.

Instead of 21 landmarks, a message may have 25 (MANUS, WebXR) or 26 (OpenXR). Instead of a row
x y z, a landmark may be an object, a row with a quaternion, or a 4 x 4 matrix. ``wrist`` is the
pose of the wrist in the frame ``world``. 26 rows with quaternions also contain the wrist's pose, in
OpenXR's axes (y up). A message with ``wrist`` and without landmarks is the pose of a tracker.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator import landmarks as schema
from smooth_operator.errors import ConfigError, DocumentError, RecordingError
from smooth_operator.formats.checks import check_palm
from smooth_operator.io import documents
from smooth_operator.io.landmark_order import in_our_order, layout_order
from smooth_operator.poses import is_rigid, quaternions, to_ours
from smooth_operator.teleop.sources.live import LATEST_STAMP_S
from smooth_operator.types import HandFrame, Side, as_side

MAX_BYTES: Final = 65_536
"""Size of the largest accepted message [bytes]; both hands of the most verbose bridge need a third
of it."""

_BINARY: Final = {
    count * 3 * size: (count, f"<f{size}") for count in schema.NODE_LAYOUTS for size in (4, 8)
}
_SHARED: Final = ("stamp", "timestamp", "session", "world")
TRACKER_WORLD: Final = "tracker"
"""Name of a wrist's world frame if the message does not name it."""

_OPENXR_WRIST: Final = schema.FROM_OPENXR_26[0]
_WHERE: Final = "the message"


@dataclass(frozen=True, eq=False)
class Reading:
    """One hand that was read from a message.

    Attributes:
        frame: the hand; its stamp is the tracker's own, or None.
        session: the tracker's name for its current session, if it sends one.
    """

    frame: HandFrame
    session: str | None = None


@dataclass(frozen=True, kw_only=True)
class Forms:
    """Settings that say which format messages have.

    Attributes:
        layout: order of the landmarks in a message of 21, by its name in ``LAYOUTS``.
        stamp_unit: unit of the stamps in JSON.
        quaternion: order of the quaternion in rows of 7.
        matrix: order of 4 x 4 matrices, row by row or column by column; ``auto`` decides by the
            place of 0 0 0 1.
    """

    layout: str = "mediapipe"
    stamp_unit: StampUnit = "s"
    quaternion: QuaternionOrder = "wxyz"
    matrix: MatrixOrder = "auto"


PACE_WINDOW_S: Final = 1.0
"""Time over which the rate of the stamps is measured [s]."""
_FEWEST: Final = 10  # messages in it


class PayloadReader:
    """Reads the messages of one stream; takes the arguments of ``read_payload``."""

    def __init__(self, side: Side | None, forms: Forms) -> None:
        self._side, self._forms = side, forms
        self._windows: dict[Side, tuple[float, float, int]] = {}
        self._wrong: dict[Side, str] = {}

    def read(self, data: bytes, received: float) -> tuple[Reading, ...]:
        """Reads the hands of the next message.

        Raises:
            RecordingError: as ``read_payload``; or over the last window the stamps ran about 10^3,
                10^6 or 10^9 times too fast or too slowly, so they are in another unit. The message
                names the setting.
        """
        readings = read_payload(data, self._side, self._forms)
        for frame in (reading.frame for reading in readings):
            if frame.stamp is not None:
                self._check_pace(frame.side, frame.stamp, received)
        return readings

    def _check_pace(self, side: Side, stamp: float, received: float) -> None:
        start, at, count = self._windows.setdefault(side, (stamp, received, 0))
        self._windows[side] = (start, at, count + 1)
        if received - at >= PACE_WINDOW_S and count >= _FEWEST:
            self._wrong[side] = self._judge((stamp - start) / (received - at))
            del self._windows[side]
        if self._wrong.get(side):
            raise RecordingError(self._wrong[side])

    def _judge(self, pace: float) -> str:
        for unit, parts in _PARTS.items():
            times = parts / _PARTS[self._forms.stamp_unit]
            if unit != self._forms.stamp_unit and 0.5 * times < pace < 2.0 * times:
                return (
                    f"the timestamps run {pace:.3g} times as fast as the clock of this "
                    f"computer: they look like {_NAMES[unit]}; set stamp_unit={unit} for the "
                    "source"
                )
        return ""


def read_payload(data: bytes, side: Side | None, forms: Forms = Forms()) -> tuple[Reading, ...]:
    """Reads the hands of a message.

    Args:
        side: side of the hand if the message has none; None refuses such a message.
        forms: form of the messages.

    Raises:
        RecordingError: the message can't be read. The error states the reason and, if the unit
            seems wrong, the likely factor.
    """
    check_size(data)
    binary = _BINARY.get(len(data))
    if data[:1] in (b"{", b"["):
        try:
            message = parse_json(data)
        except RecordingError:
            if binary is None:  # one of 128 messages of numbers starts with such a byte
                raise
        else:
            return _read_json(message, side, forms)
    if binary is None:
        sizes = ", ".join(str(size) for size in _BINARY)
        raise RecordingError(
            f"a message of {len(data)} bytes is neither JSON (an object or a list) nor 21 x 3 "
            f"numbers (252 bytes as float32, 504 as float64; accepted sizes: {sizes})"
        )
    count, dtype = binary
    points = np.frombuffer(data, dtype).reshape(count, 3).astype(np.float64)
    return (Reading(hand_frame(points, side=_checked_side(side), layout=forms.layout)),)


def check_size(data: bytes) -> None:
    """Raises RecordingError for a message that is empty or too long."""
    if not data:
        raise RecordingError("the message is empty")
    if len(data) > MAX_BYTES:
        raise RecordingError(f"a message of {len(data)} bytes is too long; at most {MAX_BYTES}")


def parse_json(data: bytes | str) -> Any:
    """Parses JSON; raises RecordingError if the text is not JSON."""
    try:
        return documents.parse_json(data)
    except DocumentError as error:
        raise RecordingError(f"{_WHERE} is not JSON: {error}") from error


def hand_frame(
    points: Float[np.ndarray, "n 3"],
    *,
    side: Side,
    stamp: float | None = None,
    valid: Any = None,
    orientations: Float[np.ndarray, "n 4"] | None = None,
    metacarpals: Float[np.ndarray, "4 3"] | None = None,
    layout: str | None = None,
    wrist: Float[np.ndarray, "7"] | None = None,
    world: str | None = None,
    forearm: Float[np.ndarray, "3"] | None = None,
) -> HandFrame:
    """Makes a hand frame from the points of a tracker.

    Args:
        points: (n, 3) positions [m] with n = 21, 25, 26 or 27; NaN for missing ones. If all are
            zero, the tracker sees no hand.
        stamp: stamp of the frame [s], or None.
        valid: flags of the points, or of the 21 landmarks.
        orientations: quaternions wxyz of the points, of any length.
        metacarpals: metacarpal bases, if they are not among the points.
        layout: order of 21 points; None for this project's order.
        wrist, world: ``HandFrame.T_world_wrist`` and its world frame.
        forearm: ``HandFrame.forearm``.

    Raises:
        RecordingError: the shape is wrong, or the unit is not metres.
    """
    if len(points) not in schema.NODE_LAYOUTS:
        raise RecordingError(
            f"{_WHERE} has {len(points)} points; a hand has 21, or 25 (MANUS, WebXR), "
            "26 (OpenXR) or 27 (with the forearm)"
        )
    picked, bases = schema.NODE_LAYOUTS[len(points)]
    ordered = len(points) == schema.NUM_LANDMARKS
    rows = np.array(layout_order(layout) if ordered else picked)
    landmarks = in_our_order(points, layout) if ordered else points[rows]
    flags = np.isfinite(landmarks).all(axis=1)
    if valid is not None:
        flags &= _flags(valid, len(points), rows)
    if not landmarks.any():  # also True for NaN, which is invalid anyway
        flags[:] = False
    check_palm(landmarks, flags, _WHERE)
    return HandFrame(
        landmarks,
        stamp,
        side,
        valid=flags,
        metacarpals=metacarpals if bases is None else points[list(bases)],
        orientations=None if orientations is None else _unit(orientations[rows]),
        T_world_wrist=wrist,
        world=world,
        forearm=forearm,
    )


def pose_frame(
    wrist: Float[np.ndarray, "7"], stamp: float | None, side: Side, world: str
) -> HandFrame:
    """Makes a frame without landmarks, for a tracker that provides only a pose."""
    nowhere = np.full((schema.NUM_LANDMARKS, 3), np.nan)
    return HandFrame(nowhere, stamp, side, T_world_wrist=wrist, world=world)


def read_side(label: Any, otherwise: Side | None) -> Side:
    """Reads the side from a message, or returns ``otherwise``; RecordingError if the side is wrong
    or missing."""
    if label is None:
        return _checked_side(otherwise)
    try:
        return as_side(str(label))
    except ConfigError:
        raise RecordingError(f"the side must be 'right' or 'left', not {short(label)}") from None


def read_session(message: Mapping[str, Any]) -> str | None:
    """Reads the tracker's name for its current session from a message."""
    session = message.get("session")
    return None if session is None else str(session)[:64]


def _read_json(message: Any, side: Side | None, forms: Forms) -> tuple[Reading, ...]:
    if isinstance(message, list):
        return (_read_hand({"landmarks": message}, side, forms),)
    hands = message.get("hands")
    if hands is None:
        return (_read_hand(message, side, forms),)
    return tuple(_read_hand(hand, side, forms) for hand in with_shared(hands, message))


def with_shared(hands: Any, message: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Adds the common fields of a message to each of its hands; raises RecordingError if these are
    not a list of objects."""
    if not isinstance(hands, list) or not all(isinstance(hand, dict) for hand in hands):
        raise RecordingError("several hands must be sent as a list of objects, one for each hand")
    shared = {key: message[key] for key in _SHARED if key in message}
    return [{**shared, **hand} for hand in hands]


def _read_hand(message: Mapping[str, Any], side: Side | None, forms: Forms) -> Reading:
    field_name = next((key for key in ("landmarks", "joints") if key in message), None)
    tracked, session = read_wrist(message), read_session(message)
    known: dict[str, Any] = {
        "stamp": read_stamp(message, forms.stamp_unit),
        "side": read_side(message.get("side"), side),
    }
    if field_name is None and tracked:
        return Reading(pose_frame(**known, **tracked), session)
    if field_name is None:
        keys = ", ".join(map(short, list(message)[:8])) or "nothing"
        raise RecordingError(f"{_WHERE} has neither 'landmarks' nor 'wrist'; it has {keys}")
    points, turned = read_points(
        message[field_name], f"'{field_name}'", quaternion=forms.quaternion, matrix=forms.matrix
    )
    orientations = _beside(message, "orientations", (len(points), 4))
    if not tracked and turned is not None and len(points) == 26:
        joint = np.concatenate([points[_OPENXR_WRIST], turned[_OPENXR_WRIST]])
        tracked = {"wrist": to_ours(joint), "world": _world(message)}
    frame = hand_frame(
        points,
        **known,
        valid=message.get("valid"),
        orientations=turned if orientations is None else orientations,
        metacarpals=_beside(message, "metacarpals", (4, 3)),
        layout=forms.layout,
        forearm=_beside(message, "forearm", (3,)),
        **tracked,
    )
    return Reading(frame, session)


def read_wrist(message: Mapping[str, Any]) -> dict[str, Any]:
    """Reads ``wrist`` and ``world`` from a message, as arguments of ``hand_frame``; empty without a
    wrist."""
    wrist = _beside(message, "wrist", (7,))
    return {} if wrist is None else {"wrist": wrist, "world": _world(message)}


def _world(message: Mapping[str, Any]) -> str:
    world = message.get("world")
    return TRACKER_WORLD if world is None else str(world)[:64]


def _beside(message: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray | None:
    if message.get(key) is None:
        return None
    value = read_numbers(message[key], f"'{key}'")
    if value.shape != shape:
        raise RecordingError(f"'{key}' must have shape {shape}, not {value.shape}")
    return value


def _checked_side(side: Side | None) -> Side:
    if side is None:
        raise RecordingError(
            f"{_WHERE} does not contain a side; send JSON with 'side', or use only one hand "
            "(side=right or side=left)"
        )
    return side


def _flags(valid: Any, count: int, rows: np.ndarray) -> np.ndarray:
    good = isinstance(valid, list) and all(isinstance(flag, (bool, int)) for flag in valid)
    if not good or len(valid) not in (count, len(rows)):
        raise RecordingError(
            f"'valid' must be {count} values that are true or false, not {short(valid)}"
        )
    flags: np.ndarray = np.array(valid, bool)
    return flags[rows] if len(flags) == count else flags


def _unit(quaternions: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit: np.ndarray = np.full_like(quaternions, np.nan)
    np.divide(quaternions, norms, out=unit, where=norms > 0.0)
    return unit


QuaternionOrder: TypeAlias = Literal["wxyz", "xyzw"]
"""Order of the quaternion in a row of 7, after x y z."""
MatrixOrder: TypeAlias = Literal["auto", "rows", "columns"]
"""Order of a 4 x 4 matrix: row by row (the row 0 0 0 1 last) or column by column."""

_AXES: Final = ("x", "y", "z")
_LAST: Final = np.array([0.0, 0.0, 0.0, 1.0])
_CLOSE: Final = 1e-3  # tolerance of the last row, since trackers send float32 and rounded text


def read_points(
    value: Any,
    what: str,
    *,
    quaternion: QuaternionOrder = "wxyz",
    matrix: MatrixOrder = "auto",
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"] | None]:
    """Reads points, and their orientations if the message has them.

    Args:
        value: JSON value: n rows of x y z; objects with x, y and z (MediaPipe); rows of x y z and a
            quaternion; 4 x 4 matrices, each as rows or as 16 numbers; or all numbers in one row.
            Null stands for a missing row.
        what: name of the value, for messages.
        quaternion: order of the quaternion in rows of 7.
        matrix: order of the matrices.

    Returns:
        (n, 3) positions [m], NaN for missing ones, and (n, 4) quaternions wxyz or None.

    Raises:
        RecordingError: the value has none of these forms, or a matrix is not a rigid transform.
    """
    if isinstance(value, list) and any(isinstance(row, dict) for row in value):
        return _of_objects(value, what), None
    rows = read_numbers(_with_missing(value), what)
    if rows.ndim == 1 and rows.size % 3 == 0:
        return rows.reshape(-1, 3), None
    if rows.ndim == 2 and rows.shape[1] == 3:
        return rows, None
    if rows.ndim == 2 and rows.shape[1] == 7:
        order = (3, 4, 5, 6) if quaternion == "wxyz" else (6, 3, 4, 5)
        return rows[:, :3], rows[:, order]
    if rows.ndim == 2 and rows.shape[1] == 16:
        rows = rows.reshape(-1, 4, 4)
    if rows.ndim == 3 and rows.shape[1:] == (4, 4):
        return points_of_matrices(rows, what, matrix)
    raise RecordingError(
        f"{what} must be 21 rows of x, y, z (or of x, y, z and a quaternion, objects with x, y, z, "
        f"or 4 x 4 matrices), not shape {rows.shape}"
    )


def points_of_matrices(
    matrices: Float[np.ndarray, "n 4 4"], what: str, order: MatrixOrder = "auto"
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Positions and quaternions wxyz of transforms; NaN where a matrix has NaN. RecordingError if 0
    0 0 1 is not in the row or column that ``order`` says, or a matrix is not rigid."""
    whole = np.isfinite(matrices).all(axis=(1, 2))
    complete = matrices[whole]
    by_rows, by_columns = (
        bool((np.abs(last - _LAST) < _CLOSE).all()) for last in (complete[:, 3], complete[:, :, 3])
    )
    if order == "columns" or (order == "auto" and by_columns and not by_rows):
        matrices, placed = np.swapaxes(matrices, 1, 2), by_columns
    else:
        placed = by_rows
    if not placed:
        where = {
            "auto": "neither the last row nor the last column",
            "rows": "not the last row (matrix=rows)",
            "columns": "not the last column (matrix=columns)",
        }[order]
        raise RecordingError(
            f"{what} must be rigid transforms with 0 0 0 1 in the last row (row by row) or "
            f"in the last column (column by column), but {where} has them; set matrix=rows or "
            "matrix=columns, or omit it"
        )
    rotation = matrices[:, :3, :3]
    if not is_rigid(matrices[whole]).all():
        mirrored = is_rigid(matrices[whole] * np.array([-1.0, 1.0, 1.0, 1.0])).all()
        raise RecordingError(
            f"{what} must be rotations and positions, but a matrix is scaled or skewed"
            if not mirrored
            else f"{what} must be in a right-handed frame, but a matrix is a mirror image"
        )
    turned = np.full((len(matrices), 4), np.nan)
    turned[whole] = quaternions(rotation[whole])
    return np.where(whole[:, None], matrices[:, :3, 3], np.nan), turned


def read_numbers(value: Any, what: str) -> Float[np.ndarray, "..."]:
    """Converts a JSON value to an array, null to NaN; raises RecordingError if it can't."""
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingError(f"{what} must be numbers in rows of equal length: {error}") from error


def short(value: Any) -> str:
    """Formats a value as at most 60 characters, for messages."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _of_objects(value: list[Any], what: str) -> Float[np.ndarray, "n 3"]:
    rows = []
    for item in value:
        if item is None:
            rows.append([None] * 3)
        elif isinstance(item, dict) and all(axis in item for axis in _AXES):
            rows.append([item[axis] for axis in _AXES])
        else:
            raise RecordingError(
                f"{what} must be numbers: objects with x, y and z, not {short(item)}"
            )
    return read_numbers(rows, what)


def _with_missing(value: Any) -> Any:
    """The value with each null row replaced by a row of nulls."""
    if not (isinstance(value, list) and None in value):
        return value
    model = next((row for row in value if isinstance(row, list)), None)
    if model is None:
        return value
    return [_blank(model) if row is None else row for row in value]


def _blank(row: list[Any]) -> list[Any]:
    return [_blank(item) if isinstance(item, list) else None for item in row]


StampUnit: TypeAlias = Literal["s", "ms", "us", "ns"]
"""Unit of timestamps, for the setting ``stamp_unit``."""

_PARTS: Final[dict[StampUnit, int]] = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
_NAMES: Final = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}


def read_stamp(message: Mapping[str, Any], unit: StampUnit = "s") -> float | None:
    """Reads ``stamp`` or ``timestamp`` of a message [s]; None without a stamp. RecordingError if
    the stamp is not a finite number, or is far too large for a time in this unit; the error names
    the setting ``stamp_unit``."""
    stamp = message.get("stamp", message.get("timestamp"))
    if stamp is None:
        return None
    if isinstance(stamp, bool) or not isinstance(stamp, (int, float)) or not _finite(stamp):
        raise RecordingError(
            f"the timestamp must be a finite number of seconds, not {short(stamp)}"
        )
    seconds = float(stamp / _PARTS[unit])  # Python divides a whole number of ns exactly
    if abs(seconds) < LATEST_STAMP_S:
        return seconds
    likely = next((u for u, n in _PARTS.items() if abs(stamp) / n < LATEST_STAMP_S), None)
    hint = (
        f"; it looks like {_NAMES[likely]} (multiply by {1 / _PARTS[likely]:g}); send "
        f"seconds, or set stamp_unit={likely} for the source"
        if likely
        else "; set stamp_unit=s, ms, us or ns for the source, whichever the tracker sends"
    )
    expected = "in seconds" if unit == "s" else f"in {unit} (stamp_unit={unit})"
    raise RecordingError(f"the timestamp must be {expected}, not {stamp:.6g}{hint}")


def _finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False
