"""Frames, commands, wrists, arm and measured joints of a log, from the columns of its topics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.formats.arm_track import ArmTrack
from smooth_operator.formats.bounds import ARRAYS_RATIO, FREE_BYTES
from smooth_operator.formats.checks import check_side
from smooth_operator.formats.states import StateTrajectory
from smooth_operator.formats.wrist_track import WristTrack
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.teleop.recording.log_tables import Table, spread
from smooth_operator.types import CommandTrajectory, HandRecording, Status

_MOST_STAGES: Final = 64  # each takes a number for every command
_MOST_ARM_JOINTS: Final = 64


def read_hands(table: Table, path: Path, truncated: bool) -> HandRecording | None:
    """The hand frames; None where there is none.

    Raises:
        ValueError: a field is wrong.
    """
    if not table:
        return None
    side, _ = check_side(set(table.column("side")), None, str(path))
    flags = table.column("valid")
    if any(len(row) != NUM_LANDMARKS for row in flags):
        raise ValueError(f"valid has {len(flags[0])} flags, not {NUM_LANDMARKS}")
    return HandRecording(
        _present(table, "landmarks", NUM_LANDMARKS, 3),
        table.stamps(),
        side,
        valid=np.frombuffer(b"".join(flags), np.uint8).reshape(-1, NUM_LANDMARKS) != 0,
        metacarpals=table.optional("metacarpals", 4, 3),
        orientations=table.optional("orientations", NUM_LANDMARKS, 4),
        name=path.stem,
        meta={"format": "log", "truncated": truncated, "side_assumed": False},
        **_world_wrists(table),
    )


def _world_wrists(table: Table) -> dict[str, Any]:
    """A recording has one world: frames whose wrist is in another than the first one's have
    none."""
    rows = table.optional("wrist", 7)
    if rows is None:
        return {}
    worlds = table.column("world")
    world = next(name for name, wrist in zip(worlds, table.column("wrist"), strict=True) if wrist)
    rows[[name != world for name in worlds]] = np.nan
    return {"T_world_wrist": rows, "world": world or None}


def read_commands(
    table: Table, timings: Table, statuses: Table
) -> tuple[CommandTrajectory | None, dict[str, np.ndarray]]:
    """The commands, and the stages of those that have a timing with the same sequence number.

    Raises:
        ValueError: a field is wrong, or the joints change.
    """
    if not table:
        return None, {}
    names = table.same("names", "the list of joint names")
    for one in (timings, statuses):
        if len(set(one.numbers)) != len(one):
            raise ValueError("two timings, or two statuses, have the same sequence number")
    latency = np.full(len(table), np.nan)
    stages: dict[str, np.ndarray] = {}
    times = timings.places(table.numbers)
    if timings:
        latency = spread(timings.floats("latency_ms"), times, np.nan)
        spent = timings.column("stages")
        for i in np.flatnonzero(times >= 0):
            for stage, time in spent[times[i]]:
                if stage not in stages:
                    if len(stages) == _MOST_STAGES:
                        raise ValueError(f"more than {_MOST_STAGES} stages of the loop")
                    stages[stage] = np.full(len(table), np.nan)
                stages[stage][i] = time
    places = statuses.places(table.numbers)
    if (places < 0).any():
        raise ValueError(f"command {table.numbers[int(np.argmin(places))]} has no status")
    codes = np.array(statuses.column("status"), np.int64)[places]
    for code in np.unique(codes).tolist():
        Status(code)
    trajectory = CommandTrajectory(
        joint_positions=table.matrix("positions", len(names)),
        joint_names=names,
        stamps=table.stamps(),
        latency_ms=latency,
        status=codes.astype(np.int8),
    )
    return trajectory, stages


def read_wrist_track(commands: Sequence[int], table: Table) -> WristTrack | None:
    """The commanded wrist at each command; None where there is no message.

    Args:
        commands: sequence numbers of the commands.
        table: of ``/wrist``.

    Raises:
        ValueError: a field is wrong, or the frame changes.
    """
    if not table:
        return None
    places = table.places(commands)
    return WristTrack(
        spread(_present(table, "pose", 7), places, np.nan),
        spread(np.array(table.column("engaged"), bool), places, False),
        spread(np.array(table.column("valid"), bool), places, False),
        table.same("world", "the frame of the commanded wrist"),
    )


def read_arm_track(commands: Sequence[int], table: Table) -> ArmTrack | None:
    """The commands of the arm at each command of the hand; None where there is no message.

    Raises:
        ValueError: a field is wrong, or the arm changes.
    """
    if not table:
        return None
    name = table.same("name", "the arm")
    joints = table.same("names", "the list of the arm's joints")
    if len(joints) > _MOST_ARM_JOINTS:
        raise ValueError(f"an arm of {len(joints)} joints")
    places = table.places(commands)
    found = (
        _present(table, "positions", len(joints)),
        table.matrix("measured", len(joints)),
        _present(table, "pose", 7),
    )
    positions, measured, poses = (spread(values, places, np.nan) for values in found)
    return ArmTrack(name, joints, positions, measured, poses)


def read_states(table: Table) -> StateTrajectory | None:
    """The measured joints; None where there is no message.

    Raises:
        ValueError: a field is wrong, or the names change.
    """
    if not table:
        return None
    names = table.same("names", "the list of measured joints")
    actuators = table.same("actuators", "the list of actuators")
    felt = [len(part) for part in table.column("touch")]
    # One long row must not be made of many short messages.
    if len(felt) * max(felt) > FREE_BYTES + ARRAYS_RATIO * sum(felt):
        raise ValueError("few of the measured states have touch, and too much of it")
    return StateTrajectory(
        table.stamps(),
        _present(table, "positions", len(names)),
        names,
        actuators,
        table.optional("currents", len(actuators)),
        table.optional("touch", max(felt) // 8),
    )


def _present(table: Table, name: str, *shape: int) -> np.ndarray:
    """A list that each message must have."""
    if all(shape) and not all(table.column(name)):
        raise ValueError(f"a message has no {name}")
    return table.matrix(name, *shape)
