"""The columns of a dataset, their types and units, and an episode as columns and back.

LeRobot's own:

======================  =====================  ===================================================
``observation.state``   float32 (n,)           measured joint positions [rad], ``JOINT.pos``; where
                                               no hand was measured, (63,) landmarks [m], wrist.x,
                                               wrist.y, … pinky_tip.z; NaN where there is no value
``action``              float32 (n,)           joint positions [rad], ``JOINT.pos``; with a wrist
                                               (n + 7,), ``tcp.x``, … ``tcp.qz``; NaN in a frame
                                               that no command answers
``timestamp``           float32                ``frame_index / fps`` [s]
``frame_index``         int64                  within the episode
``episode_index``       int64
``index``               int64                  within the dataset
``task_index``          int64                  row of ``meta/tasks.parquet``
======================  =====================  ===================================================

What these can't hold, without loss:

======================  =====================  ===================================================
``stamp``               float64                time of the frame by the recording's own clock [s]
``landmarks``           float64 (63,)          as ``observation.state``
``landmarks_valid``     bool (21,)             False where the tracker lost the landmark
``left_hand``           bool                   which hand: True for a left one
``metacarpals``         float64 (12,)          metacarpal bases [m], index to pinky
``orientations``        float64 (84,)          quaternions wxyz, one per landmark
``human_wrist``         float64 (7,)           in its world: x y z [m], quaternion wxyz
``wrist_command``       float64 (7,)           of the robot hand, in the robot's base, the same
``wrist_engaged``       bool                   whether the operator's wrist moved it
``wrist_valid``         bool                   whether the operator's wrist was known
``arm_positions``       float64 (a,)           commanded joint positions of the arm [rad]
``arm_measured``        float64 (a,)           measured when the command was sent [rad]
``arm_wrist``           float64 (7,)           wrist of the hand at ``arm_positions``, in the base
``joint_positions``     float64 (n,)           as ``action``
``command_stamp``       float64                of the command [s]; NaN where there is none
``status``              int64                  code of the command's status; -1 where there is none
``latency_ms``          float64                from landmarks to command [ms]
``stages_ms``           float64 (k,)           parts of it [ms], by stage
``measured_positions``  float64 (n,)           measured joint positions [rad], newest at ``stamp``
``measured_stamp``      float64                when they were measured [s]
======================  =====================  ===================================================

A dataset has the columns that any of its episodes needs; an episode's row in ``meta/episodes``
says, in the column ``smooth_operator``, which of them are its own, with its name, configuration and
what the source said. LeRobot's own tools drop that column when they rewrite a dataset; the frames
can still be read. Its loader turns every float64 into float32, which is too coarse for ``stamp``
where that counts from 1970: read it with any Parquet reader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.formats.episode import Episode
from smooth_operator.landmarks import FINGERS, LANDMARKS

NO_COMMAND: Final = -1
"""Status of a frame that no command answers."""

LANDMARK_NAMES: Final = tuple(f"{name}.{axis}" for name in LANDMARKS for axis in "xyz")
_METACARPAL_NAMES: Final = tuple(f"{f}_metacarpal.{axis}" for f in FINGERS[1:] for axis in "xyz")
_ORIENTATION_NAMES: Final = tuple(f"{name}.{axis}" for name in LANDMARKS for axis in "wxyz")
POSE_NAMES: Final = ("x", "y", "z", "qw", "qx", "qy", "qz")
POSE_KEYS: Final = tuple(f"tcp.{name}" for name in POSE_NAMES)
"""Keys of a wrist's target in LeRobot, those of the teleoperator plug-in."""

INDICES: Final = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def feature(dtype: str, names: Sequence[str] | None = None) -> dict[str, Any]:
    """A feature of ``meta/info.json``: one number, or one for each of some names."""
    shape = [1 if names is None else len(names)]
    return {"dtype": dtype, "shape": shape, "names": None if names is None else list(names)}


def index_features() -> dict[str, dict[str, Any]]:
    """The features of ``INDICES``."""
    return {name: feature("float32" if name == "timestamp" else "int64") for name in INDICES}


def index_columns(
    count: int, *, number: int, first: int, task: int, fps: float
) -> dict[str, np.ndarray]:
    """The columns ``INDICES`` of an episode of ``count`` frames.

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


UNITS: Final = {
    "observation.state": "m, landmarks; rad, measured joint positions, where those are its names",
    "action": "rad, joint positions; m and quaternion wxyz, wrist",
    "timestamp": "s, frame_index / fps",
    "stamp": "s, true time of the frame",
    "landmarks": "m, as observation.state, without loss",
    "landmarks_valid": "false where the tracker lost the landmark",
    "left_hand": "which hand",
    "metacarpals": "m",
    "orientations": "quaternions wxyz",
    "human_wrist": "m, quaternion wxyz, in its world",
    "wrist_command": "m, quaternion wxyz, of the robot hand in the robot's base",
    "wrist_engaged": "whether the operator's wrist moved the robot's",
    "wrist_valid": "whether the operator's wrist was known",
    "arm_positions": "rad, commanded joint positions of the arm",
    "arm_measured": "rad, measured joint positions of the arm",
    "arm_wrist": "m, quaternion wxyz, of the robot hand at arm_positions, in the arm's base",
    "joint_positions": "rad, as action, without loss",
    "command_stamp": "s, NaN in a frame without a command",
    "status": "why the command is what it is; -1 in a frame without a command",
    "latency_ms": "ms, from landmarks to command",
    "stages_ms": "ms, parts of the latency",
    "measured_positions": "rad, measured, the newest at stamp",
    "measured_stamp": "s, when they were measured",
}
"""Unit or meaning of each column that is not an index."""


@dataclass(frozen=True)
class Layout:
    """Columns of a dataset, or of one episode.

    Attributes:
        hand: the episodes have a hand.
        metacarpals: with metacarpal bases.
        orientations: with orientations.
        joints: names of the joints; None without commands.
        stages: names of the timed stages of the loop.
        measured: names of the joints that the robot hand measured; None without.
        wrist: with the human wrist.
        wrist_command: with the commanded one.
        arm: names of the joints of the arm that carries the hand; None without.
    """

    hand: bool
    metacarpals: bool
    orientations: bool
    joints: tuple[str, ...] | None
    stages: tuple[str, ...]
    measured: tuple[str, ...] | None = None
    wrist: bool = False
    wrist_command: bool = False
    arm: tuple[str, ...] | None = None

    @classmethod
    def of(cls, episode: Episode) -> Layout:
        """Layout of one episode."""
        recording, commands = episode.recording, episode.commands
        return cls(
            recording is not None,
            recording is not None and recording.metacarpals is not None,
            recording is not None and recording.orientations is not None,
            None if commands is None else tuple(commands.joint_names),
            tuple(episode.stages_ms),
            None if episode.states is None else tuple(episode.states.names),
            recording is not None and recording.T_world_wrist is not None,
            episode.wrist is not None,
            None if episode.arm is None else episode.arm.joint_names,
        )

    def widened(self, other: Layout, names: tuple[str, str]) -> Layout:
        """Layout that serves both.

        Args:
            names: names of the two, for the message.

        Raises:
            RecordingError: one has a hand or commands and the other has none, or their joints
                differ; a dataset has one kind of observation and one of action.
        """
        for what, mine, theirs in (
            ("hand frames", self.hand, other.hand),
            ("commands", self.joints is not None, other.joints is not None),
            ("measured joints", self.measured is not None, other.measured is not None),
        ):
            if mine != theirs:
                has, lacks = names if mine else names[::-1]
                raise RecordingError(
                    f"{has} holds {what} and {lacks} holds none; the episodes of one LeRobot "
                    "dataset must be alike, so convert them into two"
                )
        if self.joints != other.joints:
            raise RecordingError(
                f"{names[0]} and {names[1]} hold commands for different joints "
                f"({', '.join(self.joints or ())} and {', '.join(other.joints or ())}); write the "
                "commands of each robot hand to its own LeRobot dataset"
            )
        if self.measured != other.measured:
            raise RecordingError(
                f"{names[0]} and {names[1]} measured different joints; write each robot hand to "
                "its own LeRobot dataset"
            )
        if self.arm != other.arm:
            raise RecordingError(
                f"{names[0]} and {names[1]} have different arms, or one has none; write each "
                "robot to its own LeRobot dataset"
            )
        more = tuple(stage for stage in other.stages if stage not in self.stages)
        return Layout(
            self.hand,
            self.metacarpals or other.metacarpals,
            self.orientations or other.orientations,
            self.joints,
            self.stages + more,
            self.measured,
            self.wrist or other.wrist,
            self.wrist_command or other.wrist_command,
            self.arm,
        )

    def features(self) -> dict[str, dict[str, Any]]:
        """The ``features`` of ``meta/info.json``: dtype, shape and names of each column."""
        features: dict[str, dict[str, Any]] = {}

        def add(name: str, dtype: str, names: tuple[str, ...] | None = None) -> None:
            features[name] = feature(dtype, names)

        if self.measured is not None:
            add("observation.state", "float32", _keys(self.measured))
        elif self.hand:
            add("observation.state", "float32", LANDMARK_NAMES)
        if self.joints is not None:
            pose = POSE_KEYS if self.wrist_command else ()
            add("action", "float32", (*_keys(self.joints), *pose))
        add("stamp", "float64")
        if self.hand:
            add("landmarks", "float64", LANDMARK_NAMES)
            add("landmarks_valid", "bool", LANDMARKS)
            add("left_hand", "bool")
        if self.metacarpals:
            add("metacarpals", "float64", _METACARPAL_NAMES)
        if self.orientations:
            add("orientations", "float64", _ORIENTATION_NAMES)
        if self.wrist:
            add("human_wrist", "float64", POSE_NAMES)
        if self.wrist_command:
            add("wrist_command", "float64", POSE_NAMES)
            add("wrist_engaged", "bool")
            add("wrist_valid", "bool")
        if self.arm is not None:
            add("arm_positions", "float64", self.arm)
            add("arm_measured", "float64", self.arm)
            add("arm_wrist", "float64", POSE_NAMES)
        if self.joints is not None:
            add("joint_positions", "float64", self.joints)
            add("command_stamp", "float64")
            add("status", "int64")
            add("latency_ms", "float64")
        if self.stages:
            add("stages_ms", "float64", self.stages)
        if self.measured is not None:
            add("measured_positions", "float64", self.measured)
            add("measured_stamp", "float64")
        return features | index_features()


def _keys(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Keys of joints in LeRobot, those of the robot and the teleoperator plug-in."""
    return tuple(f"{name}.pos" for name in joints)


def episode_columns(
    episode: Episode, layout: Layout, *, number: int, first: int, task: int, fps: int
) -> dict[str, np.ndarray]:
    """The columns of an episode.

    Args:
        number: ``episode_index``.
        first: ``index`` of its first frame.
        task: ``task_index``.

    Returns:
        (T,) or (T, k) of each of the layout's features, in its type.

    Raises:
        RecordingError: there is no frame; several commands answer the same, or out of order;
            outside of a live loop one answers none: a row has one frame and one command.
    """
    count = len(episode)
    if not count:
        raise RecordingError(f"{episode.name}: it holds no frames; leave it out")
    recording, commands = episode.recording, episode.commands
    columns: dict[str, np.ndarray] = {"stamp": episode.stamps}
    if recording is not None:
        assert recording.valid is not None  # filled in by HandRecording
        flat = recording.landmarks.reshape(count, -1)
        columns |= {"observation.state": flat, "landmarks": flat}
        columns["landmarks_valid"] = recording.valid
        columns["left_hand"] = np.full(count, recording.side == "left")
        for name, key, width in (
            ("metacarpals", "metacarpals", 12),
            ("orientations", "orientations", 84),
            ("human_wrist", "T_world_wrist", 7),
        ):
            value = getattr(recording, key)
            columns[name] = np.full((count, width), np.nan)
            if value is not None:
                columns[name] = value.reshape(count, -1)
    if commands is not None:
        rows, chosen = _rows(episode)

        def spread(values: Any, empty: float) -> np.ndarray:
            values = np.asarray(values)
            out = np.full((count, *values.shape[1:]), empty, values.dtype)
            out[rows] = values[chosen]
            return out

        positions = spread(np.asarray(commands.joint_positions, np.float64), np.nan)
        columns["joint_positions"] = positions
        columns["command_stamp"] = spread(np.asarray(commands.stamps, np.float64), np.nan)
        columns["latency_ms"] = spread(np.asarray(commands.latency_ms, np.float64), np.nan)
        columns["status"] = spread(np.asarray(commands.status, np.int64), NO_COMMAND)
        times = np.full((count, len(layout.stages)), np.nan)
        for i, stage in enumerate(layout.stages):
            if stage in episode.stages_ms:
                times[rows, i] = np.asarray(episode.stages_ms[stage])[chosen]
        columns["stages_ms"] = times
        wrist, none = episode.wrist, np.zeros(len(commands), bool)
        poses = np.full((len(commands), 7), np.nan) if wrist is None else wrist.poses
        target = columns["wrist_command"] = spread(poses, np.nan)
        parts = [positions, target] if layout.wrist_command else [positions]
        columns["action"] = np.concatenate(parts, axis=1)
        columns["wrist_engaged"] = spread(none if wrist is None else wrist.engaged, False)
        columns["wrist_valid"] = spread(none if wrist is None else wrist.valid, False)
        if episode.arm is not None:
            columns["arm_positions"] = spread(episode.arm.positions, np.nan)
            columns["arm_measured"] = spread(episode.arm.measured, np.nan)
            columns["arm_wrist"] = spread(episode.arm.poses, np.nan)
    if episode.states is not None:
        measured, when = episode.states.at(episode.stamps)
        columns |= {"observation.state": measured, "measured_positions": measured}
        columns["measured_stamp"] = when
    columns |= index_columns(count, number=number, first=first, task=task, fps=fps)
    # Values beyond float32 become infinite there, as they must; the float64 columns have them.
    with np.errstate(over="ignore"):
        return {
            name: columns[name].astype(feature["dtype"])
            for name, feature in layout.features().items()
        }


def _rows(episode: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Row of each command that has one, and which commands these are."""
    rows = episode.answered()
    frames = np.arange(len(rows))
    if episode.live:  # while the tracker is silent, a loop holds the hand
        frames = np.flatnonzero(rows >= 0)
        rows = rows[frames]
    lost, doubled = int((rows < 0).sum()), bool((np.diff(rows) <= 0).any())
    if lost or doubled:
        what = f"{lost} commands answer no frame" if lost else "several commands answer one frame"
        raise RecordingError(
            f"{episode.name}: {what}, and a row of a LeRobot dataset holds one frame and its one "
            "command; convert it to .mcap or .h5, which hold them apart"
        )
    return rows, frames
