"""Readers of recordings made with headset apps; ``READERS`` lists them by name.

- Tracking Streamer (Vision Pro) saves ``tracking.jsonl``, one JSON object per line: ``timestamp``
  [s], ``leftHand`` and ``rightHand`` with the wrist in ARKit's world and 24 joints in the wrist's
  axes, each 16 numbers, column by column.
- Hand Tracking Streamer's lines as received (``nc -lu 9000 > hands.hts``); they have stamps if the
  app's debug option was on, otherwise they need a rate.

The readers skip frames without a new measurement of the hand.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import DocumentError, RecordingError, brief
from smooth_operator.formats.arrays import Allowance, TooLargeError
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.headsets.avp import JOINTS, avp_frame
from smooth_operator.headsets.hts_lines import HtsHands, parse_line
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.io import documents
from smooth_operator.types import HandFrame, HandRecording, Side

MOST_LINE: Final = 65_536
"""Size of the longest accepted line of JSON [bytes]; one with both hands has 8,000."""

_SIDES: Final[tuple[tuple[str, Side], ...]] = (("leftHand", "left"), ("rightHand", "right"))
_THUMB: Final = ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
_NAMES: Final = (
    "wrist",
    *(f"thumb{part}" for part in _THUMB),
    *(
        f"{finger}{part}"
        for finger in ("index", "middle", "ring", "little")
        for part in ("Metacarpal", *_THUMB)
    ),
)
_FRAME_BYTES: Final = 4096
"""Memory of a frame with its arrays [bytes]."""
_LABEL: Final = re.compile(rb"(?=(?:Right|Left) (?:wrist|landmarks)|Head pose)")
_NUMBER: Final = {int, float}  # without bool, a subclass of int


class _Collected:
    """Frames of both hands in a file, and a count of damaged lines."""

    def __init__(self, path: Path, wrist: bool = False) -> None:
        self._path = path
        self._frames: dict[Side, list[HandFrame]] = {"left": [], "right": []}
        self._moments: dict[Side, list[int]] = {"left": [], "right": []}
        self._together: set[Side] = set()  # hands of the current moment
        self._moment = 0
        self._repeats, self._repeated = Repeats(wrist), 0
        self._allowance = Allowance.of(path, path.stat().st_size)
        self._damaged = 0
        self._reason = ""

    def add(self, frame: HandFrame | None) -> None:
        if frame is None:
            return
        if frame.side in self._together:  # a second frame of this hand begins the next moment
            self._together.clear()
            self._moment += 1
        self._together.add(frame.side)
        new = self._repeats.new(frame)
        if new is None:
            self._repeated += 1
        else:
            frames = self._frames[frame.side]
            frames.append(new)
            self._moments[frame.side].append(self._moment)
            self._allowance.take(frame.side, len(frames) * _FRAME_BYTES)

    def damaged(self, error: Exception) -> None:
        """Counts a damaged line. An error about memory is raised for the whole file."""
        if isinstance(error, TooLargeError):
            raise error
        self._damaged += 1
        self._reason = str(error)

    def recordings(self, rate: float | None, form: str) -> dict[Side, HandRecording]:
        """Recordings of the hands in the file, each with its own frames, on one clock.

        Without stamps, hands between two frames of the same side belong to one moment.
        """
        sides = [side for side, frames in self._frames.items() if frames]
        if not sides:
            why = f"; {self._damaged} lines can't be read: {self._reason}" if self._damaged else ""
            raise RecordingError(f"{self._path}: it contains no hand{why}")
        if all(frame.stamp is not None for side in sides for frame in self._frames[side]):
            stamps = {side: np.array([f.time for f in self._frames[side]]) for side in sides}
        else:
            even = stamps_from_rate(self._moment + 1, rate, str(self._path))
            stamps = {side: even[self._moments[side]] for side in sides}
        return {side: self._made(side, stamps[side], form) for side in sides}

    def _made(self, side: Side, stamps: Float[np.ndarray, " T"], form: str) -> HandRecording:
        frames = self._frames[side]
        meta: dict[str, Any] = {"format": form}
        if self._repeated:
            meta["repeated_frames"] = self._repeated
        if self._damaged:
            meta["damaged_lines"] = self._damaged
        return HandRecording(
            np.stack([frame.landmarks for frame in frames]),
            stamps,
            side,
            valid=np.stack([frame.valid for frame in frames if frame.valid is not None]),
            metacarpals=_stacked(frames, "metacarpals"),
            orientations=_stacked(frames, "orientations"),
            T_world_wrist=_stacked(frames, "T_world_wrist"),
            world=frames[0].world,
            forearm=_stacked(frames, "forearm"),
            name=self._path.stem,
            meta=meta,
        )


def _stacked(frames: list[HandFrame], name: str) -> np.ndarray | None:
    values = [getattr(frame, name) for frame in frames]
    return None if any(value is None for value in values) else np.stack(values)


def read_avp_hands(
    path: Path, rate: float | None = None, side: Side | None = None
) -> dict[Side, HandRecording]:
    """Reads all hands of a ``tracking.jsonl``. Each hand has its own frames, and all use the same
    clock. The file has timestamps and states the sides, so ``rate`` and ``side`` are not used.
    Raises RecordingError if it contains no hand."""
    frames = _Collected(path, wrist=True)
    for message in _objects(path, frames):
        for key, hand_side in _SIDES:
            try:
                frames.add(_avp_hand(message, key, hand_side))
            except RecordingError as error:
                frames.damaged(error)
    return frames.recordings(rate, "avp")


def _avp_hand(message: dict[str, Any], key: str, side: Side) -> HandFrame | None:
    hand = message.get(key)
    if hand is None:
        return None
    if not isinstance(hand, dict):
        raise RecordingError(f"'{key}' must be an object, not {brief(hand)}")
    stamp = message.get("timestamp")
    if isinstance(stamp, bool) or not isinstance(stamp, (int, float)):
        raise RecordingError(f"'timestamp' must be seconds, not {brief(stamp)}")
    flat = np.full((JOINTS, 16), np.nan)
    for row, name in zip(flat, _NAMES, strict=True):
        if hand.get(name) is not None:
            row[:] = _numbers(hand[name], 16, name)
    matrices = np.swapaxes(flat.reshape(-1, 4, 4), 1, 2)
    wrist = matrices[0].copy()
    matrices[0] = np.eye(4)
    return avp_frame(matrices, wrist, side, float(stamp))


def read_hts_hands(
    path: Path, rate: float | None, side: Side | None = None
) -> dict[Side, HandRecording]:
    """Reads all hands from lines of Hand Tracking Streamer. Each hand has its own frames, and all
    use the same clock.

    Args:
        rate: frame rate [Hz] of a file without stamps.
        side: not used, since the lines state it.

    Raises:
        RecordingError: there is no hand in it, or it has no stamps and there is no rate.
    """
    frames, hands = _Collected(path), HtsHands()
    with path.open("rb") as stream:
        for whole in stream:
            # netcat writes no line breaks between datagrams
            for line in filter(bytes.strip, _LABEL.split(whole)):
                try:
                    frames.add(hands.add(parse_line(line), 0.0))
                except RecordingError as error:
                    frames.damaged(error)
    return frames.recordings(rate, "hts")


def _numbers(value: Any, count: int, what: str) -> Float[np.ndarray, " n"]:
    if not isinstance(value, list) or len(value) != count or not set(map(type, value)) <= _NUMBER:
        raise RecordingError(f"'{what}' must be {count} numbers, not {brief(value)}")
    numbers = np.array(value, np.float64)
    numbers[np.abs(numbers) >= 1e300] = np.nan
    return numbers


def _objects(path: Path, frames: _Collected) -> Iterator[dict[str, Any]]:
    """Yields the JSON objects of a file, one per line."""
    with path.open("rb") as stream:
        for line in stream:
            if not line.strip():
                continue
            try:
                message = documents.parse_json(line, most_bytes=MOST_LINE)
            except DocumentError as error:
                frames.damaged(error)
                continue
            if isinstance(message, dict):
                yield message
            else:
                frames.damaged(RecordingError(f"a line must be an object, not {brief(message)}"))
