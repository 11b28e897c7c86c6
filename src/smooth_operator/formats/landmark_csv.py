"""Reads landmarks from CSV: Project Aria's hand tracking, and plain tables.

Project Aria's ``hand_tracking_results.csv`` has one line per moment: ``tracking_timestamp_us``;
for each ``SIDE`` (left, right) ``SIDE_tracking_confidence`` (0 to 1; -1 without a hand) and
``tx_SIDE_landmark_N_device``, ``ty_...`` and ``tz_...`` [m] of the landmarks N from 0 to 20, in the
frame of the glasses. Further columns (the wrist, normals) are not read, because the glasses move.
Source: "MPS Output - Hand Tracking",
https://facebookresearch.github.io/projectaria_tools/docs/data_formats/mps/hand_tracking, and
``core/mps/HandTrackingReader.cpp`` of https://github.com/facebookresearch/projectaria_tools
(Apache-2.0).

A plain table has a header and one line for each hand and moment, with these columns:

=============================  ====================================================================
``timestamp``                  time [s]; without it the file needs a rate
``side``                       ``right`` or ``left``; without it one hand, a right one by default
``wrist_x``, ``wrist_y``, ...  x, y and z of the 21 landmarks by name [m] (``LANDMARKS``):
``pinky_tip_z``                ``thumb_cmc_x`` ... ``pinky_tip_z``; empty or ``nan`` if not seen
=============================  ====================================================================

The first columns must be ``timestamp`` and ``side``, if the table has them, and ``wrist_x``.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, RecordingError, brief, listed
from smooth_operator.formats.arrays import LOG_RATIO, Allowance
from smooth_operator.formats.checks import check_side, stamps_from_rate
from smooth_operator.formats.clip import SIDES
from smooth_operator.io.landmark_order import in_our_order
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.types import HandRecording, Side, as_side

_AXES: Final = ("x", "y", "z")
_PLAIN: Final = [f"{name}_{axis}" for name in LANDMARKS for axis in _AXES]
_ARIA_TIME: Final = "tracking_timestamp_us"
_CELL_BYTES: Final = 60
"""Memory for a cell as text and as a number [bytes]."""


class _Table:
    """Cells of a CSV file by the names of its header, without the spaces around them."""

    def __init__(self, path: Path) -> None:
        allowance = Allowance.of(path, path.stat().st_size, LOG_RATIO)
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
            lines = csv.reader(stream)
            try:
                header = [name.strip() for name in next(lines, [])]
                self._rows = []
                for row in lines:
                    if row:
                        self._rows.append(row)
                        allowance.take("the table", len(self._rows) * len(header) * _CELL_BYTES)
            except csv.Error as error:
                raise RecordingError(f"{path}: line {lines.line_num}: {error}") from error
        self._path = path
        self.columns = {name: at for at, name in enumerate(header)}
        if len(self.columns) != len(header):
            raise RecordingError(f"{path}: a column name occurs twice in the header")
        for number, row in enumerate(self._rows, 2):
            if len(row) != len(header):
                raise RecordingError(
                    f"{path}: row {number} has {len(row)} cells, but the header has {len(header)}; "
                    "the file is damaged or incomplete"
                )

    def __len__(self) -> int:
        return len(self._rows)

    def texts(self, name: str) -> list[str]:
        return [row[self.columns[name]].strip() for row in self._rows]

    def numbers(self, names: Sequence[str]) -> Float[np.ndarray, "T n"]:
        """Numbers of columns; NaN for empty cells. RecordingError if a column is missing, or a cell
        is not a number."""
        if missing := [name for name in names if name not in self.columns]:
            raise RecordingError(
                f"{self._path}: the table has no column {listed(missing, 3)}; it has "
                f"{listed(self.columns, 6)}"
            )
        places = [self.columns[name] for name in names]
        out = np.full((len(self._rows), len(names)), np.nan)
        for number, row in enumerate(self._rows):
            for column, place in enumerate(places):
                if text := row[place].strip():
                    try:
                        out[number, column] = float(text)
                    except ValueError:
                        raise RecordingError(
                            f"{self._path}: row {number + 2}, column {names[column]}: "
                            f"{brief(text)} is not a number"
                        ) from None
        return out


def read_landmark_csv_hands(
    path: Path, rate: float | None, side: Side | None = None
) -> dict[Side, HandRecording]:
    """Reads the hands in a plain table, by side.

    Args:
        rate: frame rate [Hz], for a table without ``timestamp``.
        side: side of the hand, for a table without ``side``; None for right.

    Raises:
        RecordingError: the table is damaged, or lacks a column.
    """
    table = _Table(path)
    points = table.numbers(_PLAIN).reshape(-1, len(LANDMARKS), 3)
    if "side" in table.columns:
        try:
            sides = np.array([as_side(text) for text in table.texts("side")], object)
        except ConfigError as error:
            raise RecordingError(f"{path}: {error}") from None
        assumed = False
    else:
        label, assumed = check_side((), side, str(path))
        sides = np.full(len(table), label, object)
    found = [each for each in SIDES if (sides == each).any()]
    if not found:
        raise RecordingError(f"{path}: the table has no rows")
    stamped = "timestamp" in table.columns
    stamps = table.numbers(["timestamp"])[:, 0] if stamped else np.empty(0)
    hands: dict[Side, HandRecording] = {}
    for each in found:
        rows = sides == each
        own = stamps[rows] if stamped else stamps_from_rate(int(rows.sum()), rate, str(path))
        meta = {"format": "landmark_csv", "side_assumed": assumed}
        hands[each] = HandRecording(points[rows], own, each, name=path.stem, meta=meta)
    return hands


def read_aria_hands(
    path: Path, rate: float | None = None, side: Side | None = None
) -> dict[Side, HandRecording]:
    """Reads the hands in Project Aria's table, by side. The table has timestamps and states the
    sides, so ``rate`` and ``side`` are not used. RecordingError if the table is damaged, lacks a
    column, or has no hand."""
    table = _Table(path)
    stamps = table.numbers([_ARIA_TIME])[:, 0] / 1e6
    hands: dict[Side, HandRecording] = {}
    for each in SIDES:
        names = [f"t{axis}_{each}_landmark_{n}_device" for n in range(21) for axis in _AXES]
        columns = table.numbers([f"{each}_tracking_confidence", *names])
        points = in_our_order(columns[:, 1:].reshape(-1, 21, 3), "aria")
        seen = columns[:, 0] > 0.0  # -1 and zeros without a hand
        if seen.any():
            valid = seen[:, None] & np.isfinite(points).all(axis=-1)
            meta: dict[str, Any] = {"format": "aria_csv"}
            hands[each] = HandRecording(
                points, stamps, each, valid=valid, name=path.stem, meta=meta
            )
    if not hands:
        raise RecordingError(f"{path}: it contains no hand with a confidence above 0")
    return hands
