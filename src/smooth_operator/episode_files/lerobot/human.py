"""The columns of a LeRobot data set that hold the human hands.

``smooth-operator-lerobot-record``, ``convert``, ``dataset`` and ``retarget --dataset`` write them,
each for the hands that it has; ``SIDE`` is ``right`` or ``left``. No policy takes them as
input by default, since their names begin with neither ``observation`` nor ``action``.

``SIDE_landmarks`` has 63 numbers a frame, wrist.x, wrist.y, … pinky_tip.z, ``SIDE_metacarpals``
12, from index to pinky, and ``SIDE_orientations`` 84, four for each landmark. A hand has the
optional parts that its recording has. ``schema.COLUMNS`` has types, units and meanings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator import poses
from smooth_operator.episode_files.lerobot.schema import POSE_NAMES, Layout
from smooth_operator.episode_files.lerobot.tables import numbers
from smooth_operator.formats.clip import SIDES
from smooth_operator.landmarks import FINGERS, LANDMARKS
from smooth_operator.types import HandRecording, Side

LANDMARK_NAMES: Final = tuple(f"{name}.{axis}" for name in LANDMARKS for axis in "xyz")
_OPTIONAL: Final[Mapping[str, tuple[str, tuple[str, ...], tuple[int, ...]]]] = {
    "metacarpals": (
        "metacarpals",
        tuple(f"{finger}_metacarpal.{axis}" for finger in FINGERS[1:] for axis in "xyz"),
        (4, 3),
    ),
    "orientations": (
        "orientations",
        tuple(f"{name}.{axis}" for name in LANDMARKS for axis in "wxyz"),
        (21, 4),
    ),
    "human_wrist": ("T_world_wrist", POSE_NAMES, (7,)),
    "human_forearm": ("forearm", ("x", "y", "z"), (3,)),
}
"""Column without its side -> attribute of a recording, names of the components, shape of a row."""
OPTIONAL_PARTS: Final = tuple(_OPTIONAL)
"""Parts that a hand may lack."""


def human_sides(columns: Iterable[str]) -> tuple[Side, ...]:
    """Returns the sides of the human hands that a data set with these columns holds."""
    return tuple(side for side in SIDES if f"{side}_landmarks" in columns)


def human_layout(side: Side, parts: Iterable[str] = ()) -> Layout:
    """Returns the columns of a hand.

    Args:
        parts: the optional ones: ``OPTIONAL_PARTS``.
    """
    layout: Layout = {"landmarks": LANDMARK_NAMES, "landmarks_valid": LANDMARKS}
    layout |= {name: _OPTIONAL[name][1] for name in parts}
    if "human_wrist" in layout:
        layout["human_wrist_valid"] = None
    return {f"{side}_{name}": names for name, names in layout.items()}


def human_parts(recording: HandRecording) -> tuple[str, ...]:
    """Returns the optional parts that a recording has; see ``human_layout``."""
    return tuple(n for n, part in _OPTIONAL.items() if getattr(recording, part[0]) is not None)


def human_columns(recording: HandRecording) -> dict[str, np.ndarray]:
    """Makes the (T,) or (T, k) columns of a recording. Values that are NaN in the recording stay
    NaN."""
    count, side = len(recording), recording.side
    assert recording.valid is not None  # filled in by HandRecording
    columns = {"landmarks": recording.landmarks, "landmarks_valid": recording.valid}
    for name in human_parts(recording):
        columns[name] = getattr(recording, _OPTIONAL[name][0])
    columns = {name: values.reshape(count, -1) for name, values in columns.items()}
    if recording.T_world_wrist is not None:
        columns["human_wrist_valid"] = np.asarray(poses.is_valid(recording.T_world_wrist))
    return {f"{side}_{name}": values for name, values in columns.items()}


def read_human(
    table: Any, side: Side, file: Path, absent: Iterable[str] = ()
) -> dict[str, np.ndarray]:
    """Reads a hand from a table of frames.

    Args:
        file: the file of the table, for messages.
        absent: optional parts to leave out although the data set has their columns.

    Returns:
        (T, …) values of ``landmarks``, ``valid``, and of the attributes of a ``HandRecording`` that
        the table has; a wrist is NaN where it is not valid.

    Raises:
        RecordingError: a column is missing or has another type.
    """

    def values(name: str, *shape: int) -> np.ndarray:
        rows = numbers(table, f"{side}_{name}", int(np.prod(shape)), file)
        return rows.reshape(len(rows), *shape)

    found = {
        "landmarks": values("landmarks", 21, 3).astype(np.float64),
        "valid": values("landmarks_valid", 21).astype(bool),
    }
    for name, (attribute, _, shape) in _OPTIONAL.items():
        if f"{side}_{name}" in table.column_names and name not in absent:
            found[attribute] = values(name, *shape).astype(np.float64)
    if "T_world_wrist" in found and f"{side}_human_wrist_valid" in table.column_names:
        known = values("human_wrist_valid", 1).astype(bool)
        found["T_world_wrist"] = np.where(known, found["T_world_wrist"], np.nan)
        if not known.any():
            del found["T_world_wrist"]
    return found
