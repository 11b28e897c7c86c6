"""The columns of a LeRobot dataset, and the conversion of episodes to columns.

``schema.COLUMNS`` has the type, unit and meaning of each column. LeRobot's own are
``observation.state`` and ``action``, in float32, and the indices; the others hold, without loss,
the data that these can't hold. Values are NaN where there are none, and the status is -1 in a frame
that no command answers.

A dataset has the columns that any of its episodes needs; the column ``smooth_operator`` in an
episode's row of ``meta/episodes`` says which of them belong to the episode, and contains its name,
its configuration and the metadata of its source. LeRobot's own tools drop that column when they
rewrite a dataset; the frames can still be read. LeRobot's loader converts every float64 to float32,
which is too coarse for a ``stamp`` that counts from 1970: read that column with any Parquet reader.

The columns that ``lerobot-record`` writes for the robot ``smooth_hand`` can be made from a log as
well. Data sets of both merge with LeRobot's own tool: keys, units, sizes and type of the robot are
equal if the robot has its default settings (with the wrist: ``--robot.wrist=quaternion``; with the
environment state: ``--robot.environment_state=joints``). Each row is one moment of LeRobot's clock,
from the first to the last command with a measurement.

=================================  ============  =================================================
``observation.state``              float32 (m,)  measured positions of the actuated joints [rad]
``observation.environment_state``  float32 (n,)  on request: measured positions of all joints [rad]
``action``                         float32 (m,)  their newest command [rad]; with the wrist
                                                 (m + 7,), ``tcp.x``, … ``tcp.qz`` [m; wxyz]
=================================  ============  =================================================
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from smooth_operator.episode_files.lerobot.human import (
    LANDMARK_NAMES,
    human_columns,
    human_layout,
    human_parts,
    human_sides,
)
from smooth_operator.episode_files.lerobot.schema import (
    COLUMNS,
    ENVIRONMENT_STATE,
    POSE_NAMES,
    Layout,
    index_columns,
    joint_keys,
    pose_keys,
    typed,
)
from smooth_operator.errors import RecordingError
from smooth_operator.formats.episode import Episode
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.wrist_joints import with_wrist_joints

NO_COMMAND: Final = -1
"""Status of a frame without a command."""

ROBOT_TYPE: Final = "smooth_hand"
"""Name of the robot plug-in."""

ROBOT_FPS: Final = 30
"""Default frame rate of a robot's columns [Hz], the same as that of ``lerobot-record``."""


def layout_of(episode: Episode) -> Layout:
    """Returns the columns of an episode."""
    recording, commands, states = episode.recording, episode.commands, episode.states
    layout: Layout = {"stamp": None}
    if recording is not None:
        layout |= {"observation.state": LANDMARK_NAMES}
        layout |= human_layout(recording.side, human_parts(recording))
    if commands is not None:
        joints = tuple(commands.joint_names)
        layout |= {"action": joint_keys(joints), "joint_positions": joints}
        layout |= {"command_stamp": None, "status": None, "latency_ms": None}
        if episode.wrist is not None:
            layout["action"] = (*joint_keys(joints), *pose_keys())
            layout |= {"wrist_command": POSE_NAMES, "wrist_engaged": None, "wrist_valid": None}
        if episode.arm is not None:
            names = episode.arm.joint_names
            layout |= {"arm_positions": names, "arm_measured": names, "arm_wrist": POSE_NAMES}
        if episode.stages_ms:
            layout["stages_ms"] = tuple(episode.stages_ms)
    if states is not None:
        names = tuple(states.names)
        layout |= {"observation.state": joint_keys(names), "measured_positions": names}
        layout["measured_stamp"] = None
    return _ordered(layout)


def widened(layout: Layout, other: Layout, names: tuple[str, str]) -> Layout:
    """Returns the layout with the columns of both given layouts.

    Args:
        names: names of the two episodes, for the message.

    Raises:
        RecordingError: only one of them has a hand or commands, or their joints differ; a dataset
            has one kind of observation and one kind of action.
    """
    for own, others, what in (
        (human_sides(layout), human_sides(other), "hand frames"),
        ("joint_positions" in layout, "joint_positions" in other, "commands"),
        ("measured_positions" in layout, "measured_positions" in other, "measured joints"),
    ):
        if bool(own) != bool(others):
            has, lacks = names if own else names[::-1]
            raise RecordingError(
                f"{has} has {what} but {lacks} has none; the episodes of one LeRobot dataset "
                "must have the same columns, so convert them into two datasets"
            )
    first, second = layout.get("joint_positions"), other.get("joint_positions")
    for column, what in (
        (
            "joint_positions",
            (
                f"contain commands for different joints ({', '.join(first or ())} and "
                f"{', '.join(second or ())}); write the commands of each robot hand"
            ),
        ),
        (
            "measured_positions",
            "have measurements of different joints; write the data of each robot hand",
        ),
        (
            "arm_positions",
            "have different arms, or only one of them has an arm; write the data of each robot",
        ),
    ):
        if layout.get(column) != other.get(column):
            raise RecordingError(f"{names[0]} and {names[1]} {what} to its own LeRobot dataset")
    both = {**layout, **other}
    if "action" in both:
        both["action"] = max(layout["action"] or (), other["action"] or (), key=len)
    if "stages_ms" in both:
        stages = (*(layout.get("stages_ms") or ()), *(other.get("stages_ms") or ()))
        both["stages_ms"] = tuple(dict.fromkeys(stages))
    return _ordered(both)


def _ordered(layout: Layout) -> Layout:
    return {name: layout[name] for name in COLUMNS if name in layout}


def episode_columns(
    episode: Episode, layout: Layout, *, number: int, first: int, task: int, fps: int
) -> dict[str, np.ndarray]:
    """Makes the columns of an episode.

    Args:
        number: ``episode_index``.
        first: ``index`` of its first frame.
        task: ``task_index``.

    Returns:
        A (T,) or (T, k) array in its type for each of the layout's features; NaN or False in a
        column that only other episodes have.

    Raises:
        RecordingError: there is no frame; several commands belong to the same frame or are out of
            order; or, outside a live loop, a command belongs to no frame. A row has one frame and
            one command.
    """
    count = len(episode)
    if not count:
        raise RecordingError(f"{episode.name}: this episode contains no frames; remove it")
    recording, commands = episode.recording, episode.commands
    columns: dict[str, np.ndarray] = {"stamp": episode.stamps}
    if recording is not None:
        columns["observation.state"] = recording.landmarks.reshape(count, -1)
        columns |= human_columns(recording)
    if commands is not None:
        rows, chosen = _rows(episode)

        def spread(values: Any, empty: float) -> np.ndarray:
            values = np.asarray(values)
            out = np.full((count, *values.shape[1:]), empty, values.dtype)
            out[rows] = values[chosen]
            return out

        columns["joint_positions"] = spread(np.asarray(commands.joint_positions, float), np.nan)
        columns["command_stamp"] = spread(np.asarray(commands.stamps, np.float64), np.nan)
        columns["latency_ms"] = spread(np.asarray(commands.latency_ms, np.float64), np.nan)
        columns["status"] = spread(np.asarray(commands.status, np.int64), NO_COMMAND)
        if episode.stages_ms:
            stages = layout["stages_ms"] or ()
            columns["stages_ms"] = times = np.full((count, len(stages)), np.nan)
            for i, stage in enumerate(stages):
                if stage in episode.stages_ms:
                    times[rows, i] = np.asarray(episode.stages_ms[stage])[chosen]
        if episode.wrist is not None:
            columns["wrist_command"] = spread(episode.wrist.poses, np.nan)
            columns["wrist_engaged"] = spread(episode.wrist.engaged, False)
            columns["wrist_valid"] = spread(episode.wrist.valid, False)
        if episode.arm is not None:
            columns["arm_positions"] = spread(episode.arm.positions, np.nan)
            columns["arm_measured"] = spread(episode.arm.measured, np.nan)
            columns["arm_wrist"] = spread(episode.arm.poses, np.nan)
    if episode.states is not None:
        measured, when = episode.states.at(episode.stamps)
        columns |= {"observation.state": measured, "measured_positions": measured}
        columns["measured_stamp"] = when
    for name in layout.keys() - columns.keys() - {"action"}:
        names = layout[name]
        shape = (count,) if names is None else (count, len(names))
        empty = np.nan if COLUMNS[name][0] == "float64" else False
        columns[name] = np.full(shape, empty)
    if commands is not None:
        parts = [columns[name] for name in ("joint_positions", "wrist_command") if name in layout]
        columns["action"] = np.concatenate(parts, axis=1)
    indices = index_columns(count, number=number, first=first, task=task, fps=fps)
    return typed(columns, layout) | indices


def _rows(episode: Episode) -> tuple[np.ndarray, np.ndarray]:
    """Row of each command that has a frame, and the indices of these commands."""
    rows = episode.answered()
    frames = np.arange(len(rows))
    if episode.live:  # while the tracker is silent, a loop holds the hand
        frames = np.flatnonzero(rows >= 0)
        rows = rows[frames]
    lost, doubled = int((rows < 0).sum()), bool((np.diff(rows) <= 0).any())
    if lost or doubled:
        what = (
            f"{lost} commands do not belong to any frame"
            if lost
            else "several commands belong to one frame"
        )
        raise RecordingError(
            f"{episode.name}: {what}, but a row of a LeRobot dataset holds one frame and one "
            "command; convert it to .mcap or .h5, which store them separately"
        )
    return rows, frames


def robot_layout(episode: Episode, wrist: bool, environment_state: bool) -> Layout:
    """Returns the columns that ``lerobot-record`` writes for the robot hand of an episode.

    Args:
        wrist: True to include the commanded wrist.
        environment_state: True to include the positions of all joints.

    Raises:
        RecordingError: the episode lacks one of these, or its hand is on an arm.
    """
    config = episode.config or {}
    lacks = next(
        (
            what
            for what, there in (
                ("commands", episode.commands is not None),
                (
                    "measured joints; record with a sink that measures them, such as mujoco",
                    episode.states is not None,
                ),
                ("name of its robot hand", isinstance(config.get("hand"), str)),
                (
                    "a commanded wrist; use --columns robot to omit it",
                    not wrist or episode.wrist is not None,
                ),
            )
            if not there
        ),
        None,
    )
    if lacks is not None:
        raise RecordingError(
            f"{episode.name}: the columns of the robot can't be written, because the episode lacks "
            f"{lacks}"
        )
    if wrist and episode.arm is not None:
        raise RecordingError(
            f"{episode.name}: a log does not contain the measured wrist of a hand on an arm; "
            "use --columns robot, or record with lerobot-record"
        )
    assert episode.commands is not None and episode.states is not None  # noqa: PT018
    side = config.get("side", "right") if episode.recording is None else episode.recording.side
    hand = load_hand(config["hand"], side)
    if set(hand.spec.wrist_joints) <= set(episode.commands.joint_names):
        hand = with_wrist_joints(hand)
    for names in (episode.commands.joint_names, episode.states.names):
        missing = [name for name in hand.joint_names if name not in names]
        if missing:
            raise RecordingError(
                f"{episode.name}: it has no {', '.join(missing)} of the hand {hand.name}"
            )
    state = joint_keys(hand.actuated_names)
    layout: Layout = {
        "action": (*state, *(pose_keys() if wrist else ())),
        "observation.state": state,
    }
    if environment_state:
        layout[ENVIRONMENT_STATE] = tuple(f"environment.{n}.pos" for n in hand.joint_names)
    return layout


def robot_columns(
    episode: Episode, layout: Layout, *, number: int, first: int, task: int, fps: int
) -> dict[str, np.ndarray]:
    """Makes a (T,) or (T, k) array for each feature of a ``robot_layout``; see ``episode_columns``.
    Raises RecordingError if there is never both a command and a measurement."""
    commands, states = episode.commands, episode.states
    assert commands is not None and states is not None  # noqa: PT018
    joints = [name.removesuffix(".pos") for name in layout["observation.state"] or ()]
    picked = [commands.joint_names.index(name) for name in joints]
    action = np.asarray(commands.joint_positions, np.float64)[:, picked]
    if len(layout["action"] or ()) > len(joints):
        assert episode.wrist is not None
        action = np.concatenate([action, episode.wrist.poses], axis=1)
    valid = np.isfinite(action).all(axis=1)
    action, stamps = action[valid], np.asarray(commands.stamps, np.float64)[valid]
    measured = np.isfinite(states.positions).all(axis=1)
    if not len(stamps) or not measured.any():
        raise RecordingError(
            f"{episode.name}: it has no complete command or no complete measurement"
        )
    begin = max(float(stamps[0]), float(states.stamps[measured][0]))
    count = int(np.floor((float(stamps[-1]) - begin) * fps + 1e-6)) + 1
    if count < 1:
        raise RecordingError(f"{episode.name}: its commands end before its first measurement")
    moments = begin + np.arange(count) / fps
    newest = np.searchsorted(stamps, moments + 1e-9, side="right") - 1
    rows = np.searchsorted(states.stamps[measured], moments + 1e-9, side="right") - 1
    positions = states.positions[measured][rows]
    columns = {
        "action": action[newest],
        "observation.state": positions[:, [states.names.index(name) for name in joints]],
    }
    if (names := layout.get(ENVIRONMENT_STATE)) is not None:
        every = [name.removeprefix("environment.").removesuffix(".pos") for name in names]
        columns[ENVIRONMENT_STATE] = positions[:, [states.names.index(name) for name in every]]
    indices = index_columns(count, number=number, first=first, task=task, fps=fps)
    return typed(columns, layout) | indices
