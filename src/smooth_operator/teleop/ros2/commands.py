"""Commands to joints as ROS 2 messages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal, TypeAlias

from smooth_operator.errors import SinkError
from smooth_operator.teleop.ros2.messages import (
    Duration,
    Float64MultiArray,
    Header,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Message,
    Time,
)

Kind: TypeAlias = Literal["joint_state", "trajectory", "array"]
"""The message: ``sensor_msgs/JointState``, ``trajectory_msgs/JointTrajectory`` or
``std_msgs/Float64MultiArray``."""

KINDS: Final[dict[Kind, type[Message]]] = {
    "joint_state": JointState,
    "trajectory": JointTrajectory,
    "array": Float64MultiArray,
}


def joint_message(
    kind: Kind,
    stamp: Time,
    names: Sequence[str],
    positions: list[float],
    velocities: list[float],
    duration: float,
) -> Message:
    """A command to joints.

    Args:
        kind: the message.
        stamp: of a joint state.
        names: (k,) of the joints.
        positions: (k,) in the driver's unit.
        velocities: (k,) of a joint state; empty for none.
        duration: from the start to the point of a trajectory [s].

    Raises:
        SinkError: a position is not finite.
    """
    if not all(map(math.isfinite, positions)):
        raise SinkError(f"ros2: a command that is not finite is not sent: {positions}")
    if kind == "array":
        return Float64MultiArray(data=positions)
    if kind == "trajectory":
        # No stamp: it begins when it comes, by the controller's clock. No velocity: some
        # controllers refuse a last point that moves.
        time = Time.of(round(duration * 1e9))
        point = JointTrajectoryPoint(positions, time_from_start=Duration(time.sec, time.nanosec))
        return JointTrajectory(Header(), list(names), [point])
    return JointState(Header(stamp), list(names), positions, velocities)
