"""Columns of LeRobot data sets that the recorder, ``convert`` and ``dataset`` share: keys, types
and units.

A data set has some of the columns in ``COLUMNS``, in the order of its ``Layout``, and the columns
``INDICES``, which all LeRobot data sets have. ``columns`` makes those of ``convert`` and of the
robot ``smooth_hand``, the distribution ``smooth-hand-datasets`` those of ``dataset``; the columns
of the human hands are the same in all of them, see ``human``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator import poses

POSE_NAMES: Final = ("x", "y", "z", "qw", "qx", "qy", "qz")
WRIST_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "none": (),
    "rotation_6d": ("x", "y", "z", "r1", "r2", "r3", "r4", "r5", "r6"),
    "quaternion": POSE_NAMES,
}
"""Notation of a wrist's pose in the plug-ins -> names of the components."""


def joint_keys(joints: Sequence[str]) -> tuple[str, ...]:
    """Keys under which LeRobot stores joints in actions and observations."""
    return tuple(f"{name}.pos" for name in joints)


def pose_keys(names: Sequence[str] = POSE_NAMES) -> tuple[str, ...]:
    """Keys under which LeRobot stores a wrist pose in actions and observations."""
    return tuple(f"tcp.{name}" for name in names)


def wrist_pose(values: Sequence[float]) -> np.ndarray:
    """Makes a wrist pose from the values of its keys, whose rotation may be slightly inexact.

    Args:
        values: x y z [m], and a rotation vector [rad], a quaternion wxyz or the first two columns
            of a rotation matrix.

    Returns:
        (7,) x y z [m], unit quaternion wxyz.

    Raises:
        ValueError: the rotation is too far from one.
    """
    place, turn = np.split(np.asarray(values, np.float64), [3])
    if len(turn) == 3:
        return np.concatenate([place, poses.from_rotation_vectors(turn)])
    if len(turn) == 4:
        length = np.linalg.norm(turn)
        if not 0.1 < length < 10.0:
            raise ValueError(f"the action's quaternion is not a rotation: {turn.tolist()}")
        return np.concatenate([place, turn / length])
    x, y = turn[:3], turn[3:]
    length = np.linalg.norm(x)
    x = x / length if length > 0.1 else np.zeros(3)
    y = y - (x @ y) * x
    across = np.linalg.norm(y)
    if length <= 0.1 or across <= 0.1:
        raise ValueError(f"the action's rotation_6d is not a rotation: {turn.tolist()}")
    y = y / across
    return np.concatenate([place, poses.quaternions(np.stack([x, y, np.cross(x, y)], axis=-1))])


INDICES: Final = ("timestamp", "frame_index", "episode_index", "index", "task_index")

ENVIRONMENT_STATE: Final = "observation.environment_state"

COLUMNS: Final[Mapping[str, tuple[str, str]]] = {
    "observation.state": (
        "float32",
        "measured joint positions [rad] if the names are those of joints, otherwise landmarks [m]",
    ),
    ENVIRONMENT_STATE: ("float32", "rad, measured positions of all joints"),
    "action": ("float32", "rad, joint positions; m and quaternion wxyz, wrist"),
    "stamp": ("float64", "s, actual time of the frame"),
    **{
        f"{side}_{name}": about
        for side in ("right", "left")
        for name, about in (
            ("landmarks", ("float64", "m, human hand in the tracker's frame")),
            ("landmarks_valid", ("bool", "false where the tracker lost the landmark")),
            ("metacarpals", ("float64", "m, of the human hand")),
            ("orientations", ("float64", "quaternions wxyz of the landmarks")),
            ("human_wrist", ("float64", "m, quaternion wxyz, in the tracker's world")),
            ("human_wrist_valid", ("bool", "true if the pose of the human wrist was known")),
            ("human_forearm", ("float64", "direction of the forearm in the wrist's frame")),
        )
    },
    "wrist_command": ("float64", "m, quaternion wxyz, robot hand in the robot's base frame"),
    "wrist_engaged": ("bool", "true if the operator's wrist moved the robot's"),
    "wrist_valid": ("bool", "true if the pose of the operator's wrist was known"),
    "arm_positions": ("float64", "rad, commanded joint positions of the arm"),
    "arm_measured": ("float64", "rad, measured joint positions of the arm"),
    "arm_wrist": (
        "float64",
        "m, quaternion wxyz, robot hand in the arm's base frame, computed from arm_positions",
    ),
    "joint_positions": ("float64", "rad, the values of the column action in full precision"),
    "command_stamp": ("float64", "s, NaN in a frame without a command"),
    "status": ("int64", "status of the command; -1 in a frame without a command"),
    "latency_ms": ("float64", "ms, time from landmarks to command"),
    "stages_ms": ("float64", "ms, times of the stages that make up the latency"),
    "measured_positions": (
        "float64",
        "rad, the newest measured joint positions at the time of the command",
    ),
    "measured_stamp": ("float64", "s, time of that measurement"),
    "SIDE_valid": ("bool", "true if the command was computed from a hand that was seen"),
    "SIDE_wrist_valid": (
        "bool",
        "true if the wrist pose was known; otherwise another known pose is repeated",
    ),
    "SIDE_status": ("int64", "status of the command; -1 if the clip lacks this hand"),
    "SIDE_confidence": ("float32", "confidence of the tracker, 0 to 1; -1 if unknown"),
    "camera": ("float32", "m, quaternion wxyz, axes x right, y down, z forward"),
    "camera_valid": ("bool", "whether it was known"),
    "objects": ("float32", "m, quaternion wxyz, one object after another"),
    "objects_valid": ("bool", "whether each was known"),
}
"""Name -> type, and unit or meaning, of each column that is not an index, in order. ``SIDE``
is ``right`` or ``left``: ``dataset`` writes these columns for each hand."""

Layout: TypeAlias = dict[str, tuple[str, ...] | None]
"""Columns of a dataset or episode: name -> names of the components; None for one number."""


def column_of(name: str) -> tuple[str, str]:
    """Returns the type, and the unit or meaning, of a column."""
    sided = f"SIDE_{name.partition('_')[2]}"
    index = "float32" if name == "timestamp" else "int64"
    unit = "s, frame_index / fps" if name == "timestamp" else "index"
    return COLUMNS.get(name) or COLUMNS.get(sided) or (index, unit)


def dataset_features(layout: Layout) -> dict[str, dict[str, Any]]:
    """Makes the entry ``features`` of ``meta/info.json``: dtype, shape and names of each column."""
    return {
        name: {
            "dtype": column_of(name)[0],
            "shape": [1 if names is None else len(names)],
            "names": None if names is None else list(names),
        }
        for name, names in (layout | dict.fromkeys(INDICES)).items()
    }


def index_columns(
    count: int, *, number: int, first: int, task: int, fps: float
) -> dict[str, np.ndarray]:
    """Makes the columns ``INDICES`` of an episode of ``count`` frames.

    Args:
        count: number of frames.
        number: ``episode_index``.
        first: ``index`` of its first frame.
        task: ``task_index``.
    """
    frames = np.arange(count)
    return {
        "timestamp": (frames / fps).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(count, number),
        "index": frames + first,
        "task_index": np.full(count, task),
    }


def typed(columns: Mapping[str, np.ndarray], layout: Layout) -> dict[str, np.ndarray]:
    """Converts the columns of a layout to their types, in the order of the layout and without the
    indices."""
    # Values beyond float32 become infinite there, as they must; the float64 columns have them.
    with np.errstate(over="ignore"):
        return {name: columns[name].astype(column_of(name)[0]) for name in layout}
