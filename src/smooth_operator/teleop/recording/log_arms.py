"""The arm in a log: its commands as messages, and read back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from smooth_operator.formats.arm_track import ArmTrack
from smooth_operator.teleop.recording.log_wrists import decode_pose
from smooth_operator.teleop.recording.messages import number, numbers, pose
from smooth_operator.teleop.sinks.tick import ArmCommand

_MOST: Final = 64
"""Joints of an arm, at most."""


def arm_message(stamp: float, arm: ArmCommand) -> dict[str, Any]:
    """The command of an arm as a message of ``/arm``; ``stamp`` is that of the command [s]."""
    message: dict[str, Any] = {
        "stamp": stamp,
        "name": arm.name,
        "names": arm.joint_names,
        "positions": numbers(arm.positions),
        "velocities": numbers(arm.velocity),
        "pose": pose(arm.pose),
        "state": arm.state,
        "clearance": number(arm.clearance),
        "position_error": number(arm.position_error),
        "rotation_error": number(arm.rotation_error),
    }
    if arm.measured is not None:
        message["measured"] = numbers(arm.measured)
    return message


def decode_arm(message: dict[str, Any]) -> None:
    """Turn the numbers of a message of ``/arm`` into arrays, in place.

    Raises:
        KeyError, TypeError, ValueError: a field is missing or wrong.
    """
    names = message["names"]
    if not isinstance(message["name"], str) or not all(isinstance(name, str) for name in names):
        raise ValueError("the names of an arm and its joints must be text")
    if len(names) > _MOST:
        raise ValueError(f"an arm of {len(names)} joints")
    message["names"] = tuple(names)
    for key in ("positions", "measured"):
        if key in message:
            message[key] = np.array(message[key], np.float64)  # which makes NaN of None
            if message[key].shape != (len(names),):
                raise ValueError(f"{key} of an arm must be {len(names)} numbers")
    message["pose"] = decode_pose(message["pose"])


def read_arm_track(
    commands: Sequence[int], messages: Mapping[int, Mapping[str, Any]]
) -> ArmTrack | None:
    """Put together what the messages of ``/arm`` hold.

    Args:
        commands: sequence numbers of the commands.
        messages: sequence number -> message.

    Returns:
        None where there is no message.

    Raises:
        ValueError: the arm changes.
    """
    if not messages:
        return None
    kinds = {(message["name"], message["names"]) for message in messages.values()}
    if len(kinds) > 1:
        raise ValueError("the log holds commands of more than one arm")
    ((name, joints),) = kinds
    found = [messages.get(command) for command in commands]
    none, nowhere = np.full(len(joints), np.nan), np.full(7, np.nan)

    def rows(key: str, absent: np.ndarray) -> np.ndarray:
        values = [absent if m is None else m.get(key, absent) for m in found]
        return np.array(values).reshape(-1, len(absent))

    return ArmTrack(
        name, joints, rows("positions", none), rows("measured", none), rows("pose", nowhere)
    )
