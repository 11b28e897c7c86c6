"""Decodes lines from the Quest app Hand Tracking Streamer (HTS) to hand frames.

The app sends two lines of text for each hand, and one for the head::

    Right wrist:, 0.2502, 1.0635, 0.2540, 0.194, -0.116, 0.094, -0.970
    Right landmarks:, 0.0000, 0.0000, 0.0000, -0.0275, -0.0197, 0.0362, ...
    Head pose:, 0.0101, 1.5012, -0.0203, 0.010, 0.020, 0.030, 0.999

A wrist or head is x y z [m] and a quaternion x y z w in Unity's world (left-handed, y up, z
forward); landmarks are 21 x 3 [m] in the wrist's axes, in the project's order, 0 0 0 for a missing
joint. The app's debug option adds ``| f = 17 | t = 5312345678`` before the colon: number of the
frame, and time of sending on the headset's clock [ns].

Source: ``CONNECTIONS.md`` and ``HandLandmarkStreamer.cs`` of wengmister/hand-tracking-streamer, and
the parser of wengmister/hand-tracking-sdk 1.1.0.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError, brief
from smooth_operator.formats.checks import check_palm
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.poses import WORLD_AXES, WRIST_AXES, to_ours
from smooth_operator.types import HandFrame, Side, as_side

WORLD: Final = "hts"
"""Name of the world frame: the headset's floor-level origin."""
MAX_LINE: Final = 4096
"""Size of the longest accepted line [bytes]; the app's lines have 600."""

Kind: TypeAlias = Literal["wrist", "landmarks", "pose"]

_BEGINNINGS: Final = ("right wrist", "right landmarks", "left wrist", "left landmarks", "head pose")
_LINE: Final = re.compile(
    r"\s*(?P<who>right|left|head)\s+(?P<kind>wrist|landmarks|pose)\s*(?P<meta>\|[^:]{0,200})?"
    r":\s*,?(?P<values>[^:]*)",
    re.IGNORECASE | re.ASCII,
)
_META: Final = re.compile(r"([a-z_]+)\s*=\s*(\d{1,20})\s*", re.IGNORECASE | re.ASCII)
_COUNT: Final[dict[Kind, int]] = {"wrist": 7, "landmarks": 3 * NUM_LANDMARKS, "pose": 7}
_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?([eE][+-]?\d+)?|NaN|Infinity|∞)", re.ASCII)
_WXYZ: Final = [0, 1, 2, 6, 3, 4, 5]
_TOGETHER_S: Final = 0.05  # longest time between the two lines of one hand


@dataclass(frozen=True, eq=False)
class HtsLine:
    """A parsed line of the app.

    Attributes:
        kind: kind of its values.
        side: side of the hand; None for the head.
        values: (7,) or (63,) values as sent.
        number: number of the headset's frame; None without the debug option.
        stamp: time of sending on the headset's clock [s]; None without the debug option.
    """

    kind: Kind
    side: Side | None
    values: Float[np.ndarray, " n"]
    number: int | None = None
    stamp: float | None = None


def begins_line(data: bytes | bytearray) -> bool:
    """True if some bytes can be the beginning of a line of the app, rather than of an HTTP
    request."""
    words = " ".join(data.decode("ascii", "replace").lower().split(None, 2)[:2])
    return any(each.startswith(words) or words.startswith(each) for each in _BEGINNINGS)


def parse_line(data: bytes | str) -> HtsLine:
    """Reads a line; raises RecordingError for a line that is cut off or not one of the app's."""
    if len(data) > MAX_LINE:
        raise RecordingError(f"a line of {len(data)} bytes is too long; at most {MAX_LINE}")
    text = data if isinstance(data, str) else data.decode("utf-8", "replace")
    match = _LINE.fullmatch(text.strip())
    if match is None or (match["who"].lower() == "head") != (match["kind"].lower() == "pose"):
        raise RecordingError(
            "a line must begin with 'Right wrist:', 'Right landmarks:', 'Left wrist:', "
            f"'Left landmarks:' or 'Head pose:', not {brief(text)}"
        )
    kind: Any = match["kind"].lower()
    meta = {key.lower(): int(value) for key, value in _META.findall(match["meta"] or "")}
    number = next((meta[key] for key in ("f", "frame", "frame_id") if key in meta), None)
    stamp = next((meta[key] for key in ("t", "ts", "timestamp") if key in meta), None)
    return HtsLine(
        kind,
        None if kind == "pose" else as_side(match["who"]),
        _values(match["values"], _COUNT[kind], f"{match['who']} {kind}"),
        number,
        None if stamp is None else stamp / 1_000_000_000,
    )


def _values(text: str, count: int, what: str) -> Float[np.ndarray, " n"]:
    words = [word.strip() for word in text.strip().strip(",").split(",")]
    if len(words) == 2 * count:  # decimal commas, as in "0,25, 1,06"
        words = [word.strip() for word in text.strip().strip(",").split(", ")]
    if len(words) != count:
        raise RecordingError(
            f"'{what}' must have {count} numbers, not {len(words)}: the line is truncated or "
            "damaged"
        )
    bad = next((word for word in words if _NUMBER.fullmatch(word) is None), None)
    if bad is not None:
        raise RecordingError(f"'{what}' must have {count} numbers, but one is {brief(bad)}")
    return np.array([float(word.replace(",", ".").replace("∞", "inf")) for word in words])


class HtsHands:
    """Joins a wrist line and a landmark line to a hand frame.

    The wrist comes first. It belongs to one line of landmarks with the same number or, if there are
    no numbers, to one that arrives within 50 ms.
    """

    def __init__(self) -> None:
        self._wrists: dict[Side, tuple[HtsLine, float]] = {}

    def add(self, line: HtsLine, received: float) -> HandFrame | None:
        """Adds a line with the time at which it was received [s].

        Returns:
            the hand if the line completes one, else None. Its stamp may be None; its pose is NaN
            without a wrist.

        Raises:
            RecordingError: the landmarks are not in metres.
        """
        if line.side is None:
            return None
        if line.kind == "wrist":
            self._wrists[line.side] = (line, received)
            return None
        wrist = self._wrists.pop(line.side, None)
        values = wrist[0].values if wrist is not None and _belong(*wrist, line, received) else None
        return _frame(line.values.reshape(-1, 3), values, line.side, line.stamp)


def _belong(wrist: HtsLine, at: float, landmarks: HtsLine, received: float) -> bool:
    if wrist.number is not None and landmarks.number is not None:
        return wrist.number == landmarks.number
    return received - at <= _TOGETHER_S


def _frame(
    points: Float[np.ndarray, "21 3"],
    wrist: Float[np.ndarray, "7"] | None,
    side: Side,
    stamp: float | None,
) -> HandFrame:
    """Converts the app's landmarks and its wrist, None if lost, to this project's conventions."""
    landmarks = points @ WRIST_AXES["unity"].T
    valid = np.isfinite(landmarks).all(axis=1)
    valid[1:] &= landmarks[1:].any(axis=1)  # 0 0 0 is a missing joint
    valid[0] &= bool(valid[1:].any())
    check_palm(landmarks, valid, "the landmarks")
    wrist_pose = np.full(7, np.nan) if wrist is None else wrist[_WXYZ]
    pose = to_ours(wrist_pose, WORLD_AXES["unity"], WRIST_AXES["unity"])
    return HandFrame(landmarks, stamp, side, valid=valid, T_world_wrist=pose, world=WORLD)
