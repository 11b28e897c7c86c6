"""What HDF5 files of episodes hold besides hand and commands: wrist, arm, measured states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.episode_files.hdf5_arrays import (
    POSE_UNITS,
    Group,
    array_of,
    numbers,
    text_of,
    write_array,
)
from smooth_operator.episode_files.hdf5_tree import Hdf5Group, h5py_of
from smooth_operator.errors import RecordingError
from smooth_operator.formats.arm_track import ArmTrack
from smooth_operator.formats.states import StateTrajectory
from smooth_operator.formats.wrist_track import BASE, WristTrack


def write_wrist(group: Group, wrist: WristTrack) -> None:
    """Add the commanded wrist to the commands."""
    write_array(group, "wrist", wrist.poses, POSE_UNITS)
    group["wrist"].attrs["world"] = wrist.world
    write_array(group, "wrist_engaged", np.asarray(wrist.engaged, bool), None)
    write_array(group, "wrist_valid", np.asarray(wrist.valid, bool), None)


def read_wrist(group: Hdf5Group, count: int, path: Path) -> WristTrack | None:
    """The commanded wrist of as many commands; None where there is none."""
    if "wrist" not in group.arrays:
        return None
    poses = numbers(group, "wrist", (count, 7), path)
    engaged = array_of(group, "wrist_engaged", (count,), "b", path)
    valid = array_of(group, "wrist_valid", (count,), "b", path)
    world = text_of(group.arrays["wrist"].attributes.get("world"))
    return WristTrack(poses, engaged, valid, BASE if world is None else world)


def write_arm(group: Group, arm: ArmTrack) -> None:
    """Add the arm to the commands."""
    write_array(group, "arm", arm.positions, "rad")
    write_array(group, "arm_measured", arm.measured, "rad")
    write_array(group, "arm_wrist", arm.poses, POSE_UNITS)
    group["arm"].attrs["name"] = arm.name
    group["arm"].attrs["joint_names"] = ",".join(arm.joint_names)


def read_arm(group: Hdf5Group, count: int, path: Path) -> ArmTrack | None:
    """The arm of as many commands; None where there is none."""
    if "arm" not in group.arrays:
        return None
    attributes = group.arrays["arm"].attributes
    names = tuple((text_of(attributes.get("joint_names")) or "").split(","))
    shape = (count, len(names))
    return ArmTrack(
        text_of(attributes.get("name")) or "arm",
        names,
        numbers(group, "arm", shape, path),
        numbers(group, "arm_measured", shape, path),
        numbers(group, "arm_wrist", (count, 7), path),
    )


def write_states(group: Group, states: StateTrajectory) -> None:
    """Add the measured states of a robot hand."""
    write_array(group, "joint_positions", np.asarray(states.positions, np.float64), "rad")
    write_array(group, "stamps", np.asarray(states.stamps, np.float64), "s")
    texts = h5py_of().string_dtype()
    group.create_dataset("joint_names", data=list(states.names), dtype=texts)
    if states.actuators:
        group.create_dataset("actuator_names", data=list(states.actuators), dtype=texts)
    for name in ("currents", "touch"):
        values = getattr(states, name)
        if values is not None:
            write_array(group, name, np.asarray(values, np.float64), None)


def read_states(group: Hdf5Group, path: Path) -> StateTrajectory:
    """The measured states of a robot hand.

    Raises:
        RecordingError: an array is missing or does not fit.
    """
    positions = numbers(group, "joint_positions", (None, None), path)
    count = len(positions)
    optional: dict[str, Any] = {
        name: numbers(group, name, (count, None), path) if name in group.arrays else None
        for name in ("currents", "touch")
    }
    names, actuators = (
        tuple(map(str, group.arrays[key].texts or ())) if key in group.arrays else ()
        for key in ("joint_names", "actuator_names")
    )
    stamps = numbers(group, "stamps", (count,), path)
    try:
        return StateTrajectory(stamps, positions, names, actuators, **optional)
    except RecordingError as error:
        raise RecordingError(f"{path}: {group.name}: {error}") from error
