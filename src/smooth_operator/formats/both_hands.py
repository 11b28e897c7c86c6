"""Checks the hands of a clip and merges their timestamps, for all readers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import (
    check_anatomy,
    check_recording,
    check_stamps,
    without_outliers,
)
from smooth_operator.formats.clip import SIDES
from smooth_operator.io.anatomy import MIRRORED
from smooth_operator.io.landmark_order import chirality
from smooth_operator.landmarks import WRIST, index
from smooth_operator.types import HandRecording, Side

_TOGETHER: Final = 0.4
"""Two hands belong to one frame if their timestamps differ by less than this share of a period."""
_JUDGED: Final = 50
"""Number of frames from which the order and the side are judged."""


def checked_hands(
    hands: Mapping[Side, HandRecording], where: str, expects: str, *, each_frame: bool = False
) -> dict[Side, HandRecording]:
    """Checks timestamps, units, order and side of each hand. Returns the hands that appear in the
    clip.

    A hand without a frame that has both wrist and middle knuckle is left out. Implausible landmarks
    are marked invalid, as in recordings of one hand.

    Args:
        hands: side -> recording from a file, all with the same timestamps.
        where: the file, for messages.
        each_frame: True if a model determined the side in each picture; then frames that show the
            other hand are marked invalid.

    Raises:
        RecordingError: no hand appears; a hand is not in metres; or, judging by its shape, a hand
            has another order or side than the file says.
    """
    checked: dict[Side, HandRecording] = {}
    for side in SIDES:
        hand = hands.get(side)
        if hand is None or not _appears(hand):
            continue
        label = f"{where}, {side} hand"
        check_anatomy(_some_of(hand), label, side=None)
        check_recording(hand, label)
        hand = without_outliers(hand)
        checked[side] = _of_its_side(hand) if each_frame else hand
    if not checked:
        raise RecordingError(
            f"{where}: no frame shows both the wrist and the middle finger's knuckle of a hand; "
            f"expected {expects}"
        )
    return checked


def one_hand(hands: Mapping[Side, HandRecording], side: Side | None, path: Path) -> HandRecording:
    """Returns the hand of a side, or for None the only hand in the file. Raises RecordingError if
    the file does not have that hand, or if it has both hands and ``side`` is None."""
    if side is None and len(hands) > 1:
        raise RecordingError(
            f"{path}: it contains both hands; choose one with --side right or --side left "
            "(in Python: side='right')"
        )
    chosen = next(iter(hands)) if side is None else side
    if chosen not in hands:
        raise RecordingError(f"{path}: it contains no {side} hand; leave out --side {side}")
    return hands[chosen]


def _appears(hand: HandRecording) -> bool:
    assert hand.valid is not None  # filled in by HandRecording
    return bool((hand.valid[:, WRIST] & hand.valid[:, index("middle_mcp")]).any())


def _some_of(hand: HandRecording) -> HandRecording:
    """Selects complete frames spread over a recording, only as many as needed, because judging is
    slow.
    """
    assert hand.valid is not None  # filled in by HandRecording
    whole = np.flatnonzero(hand.valid.all(axis=1))
    if len(whole) <= _JUDGED:
        return hand
    rows = whole[np.linspace(0, len(whole) - 1, _JUDGED).astype(int)]
    return HandRecording(hand.landmarks[rows], hand.stamps[rows], hand.side, meta=hand.meta)


def _of_its_side(hand: HandRecording) -> HandRecording:
    """Marks frames that show the other hand as invalid, and removes their wrist."""
    assert hand.valid is not None  # filled in by HandRecording
    whole = np.flatnonzero(hand.valid.all(axis=1))
    sign = 1.0 if hand.side == "right" else -1.0
    other = whole[sign * chirality(hand.landmarks[whole]) < MIRRORED]
    if not len(other):
        return hand
    valid, wrist = hand.valid.copy(), hand.T_world_wrist
    valid[other] = False
    if wrist is not None:
        wrist = wrist.copy()
        wrist[other] = np.nan
    meta = {**hand.meta, "other_side_frames": len(other)}
    return replace(hand, valid=valid, T_world_wrist=wrist, meta=meta)


def on_common_stamps(hands: Mapping[Side, HandRecording], where: str) -> dict[Side, HandRecording]:
    """Merges two hands that have separate timestamps, from the same clock, to common timestamps.

    Frames of the two hands that are less than 0.4 of a period apart become one, with the earlier
    stamp. Where a hand has no frame, its landmarks are NaN and not valid.

    Args:
        hands: side -> recording.
        where: the file, for messages.

    Raises:
        RecordingError: the stamps of a hand do not increase, or are not in seconds.
    """
    for side, hand in hands.items():
        check_stamps(hand.stamps, f"{where}, {side} hand")
    sides = list(hands)
    if len(sides) < 2 or np.array_equal(hands[sides[0]].stamps, hands[sides[1]].stamps):
        return dict(hands)
    stamps, rows = _merged(hands[sides[0]].stamps, hands[sides[1]].stamps)
    return {side: _spread(hands[side], stamps, row) for side, row in zip(sides, rows, strict=True)}


def _merged(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " T"], list[Int[np.ndarray, " k"]]]:
    """The common timestamps, and the rows of both hands' frames in them."""
    periods = [float(np.median(np.diff(s))) for s in (first, second) if len(s) > 1]
    near = _TOGETHER * min(periods, default=0.0)
    times = np.concatenate([first, second])
    order = np.argsort(times, kind="stable")
    of_second = order >= len(first)
    joins = np.zeros(len(order), bool)  # the frame is of the same moment as the one before it
    joins[1:] = (np.diff(times[order]) <= near) & (of_second[1:] != of_second[:-1])
    for i in np.flatnonzero(joins[1:] & joins[:-1]) + 1:  # of three in a row, two belong together
        joins[i] = joins[i] and not joins[i - 1]
    row = np.empty(len(order), np.int64)
    row[order] = np.cumsum(~joins) - 1
    return times[order][~joins], [row[: len(first)], row[len(first) :]]


def _spread(
    hand: HandRecording, stamps: Float[np.ndarray, " T"], rows: Int[np.ndarray, " n"]
) -> HandRecording:
    """Spreads a hand over more timestamps than it has frames; NaN in the others."""

    def spread(values: np.ndarray | None) -> Any:
        if values is None:
            return None
        empty = False if values.dtype == bool else np.nan
        wide = np.full((len(stamps), *values.shape[1:]), empty, values.dtype)
        wide[rows] = values
        return wide

    return replace(
        hand,
        landmarks=spread(hand.landmarks),
        stamps=stamps,
        valid=spread(hand.valid),
        metacarpals=spread(hand.metacarpals),
        orientations=spread(hand.orientations),
        T_world_wrist=spread(hand.T_world_wrist),
        forearm=spread(hand.forearm),
    )


def first_video(*places: Path) -> Path | None:
    """Returns the first of some paths that is a file; None if there is no such file."""
    return next((path for path in places if path.is_file()), None)
