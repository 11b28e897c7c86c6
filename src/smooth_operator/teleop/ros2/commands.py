"""Joint commands and wrist poses as ROS 2 messages: names, order, quaternions with w last."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError, UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.hardware.actuator_map import BoundMap
from smooth_operator.teleop.hardware.table_file import find_table, read_table
from smooth_operator.teleop.ros2.messages import (
    Duration,
    Float64MultiArray,
    Header,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Message,
    Point,
    Pose,
    Quaternion,
    Time,
)

Kind: TypeAlias = Literal["joint_state", "trajectory", "array"]
"""Type of the message: ``sensor_msgs/JointState``, ``trajectory_msgs/JointTrajectory`` or
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
    """Message with a command to joints.

    Args:
        kind: type of the message.
        stamp: stamp of a joint state.
        names: (k,) names of the joints.
        positions: (k,) positions in the driver's unit.
        velocities: (k,) velocities of a joint state; may be empty.
        duration: time from the start to the point of a trajectory [s].

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


@dataclass(frozen=True)
class JointLayout:
    """Order and names of a hand's joints in a driver, which takes radians.

    Attributes:
        names: (k,) the driver's names of the joints.
        indices: (k,) indices of the joints in the hand.
    """

    names: tuple[str, ...]
    indices: tuple[int, ...]

    def values(self, positions: Float[np.ndarray, " n"]) -> list[float]:
        """(k,) positions of these joints [rad]."""
        picked: list[float] = positions[list(self.indices)].tolist()
        return picked

    def rates(self, velocities: Float[np.ndarray, " n"]) -> list[float]:
        """(k,) velocities of these joints [rad/s]."""
        return self.values(velocities)


@dataclass(frozen=True)
class TableLayout:
    """Actuators of a table, which maps joints to them within their ends.

    Attributes:
        table: the table, bound to the joints of the hand.
    """

    table: BoundMap

    @property
    def names(self) -> tuple[str, ...]:
        """(k,) names of the actuators."""
        return self.table.table.names

    def values(self, positions: Float[np.ndarray, " n"]) -> list[float]:
        """(k,) commands for joint positions [rad]."""
        commands = self.table.commands(self.table.angles(positions))
        within: list[float] = self.table.clip(commands).tolist()
        return within

    def rates(self, velocities: Float[np.ndarray, " n"]) -> list[float]:
        """Empty: drivers with a unit of their own use ``velocity`` for another quantity."""
        del velocities
        return []


Layout: TypeAlias = JointLayout | TableLayout
"""Order, names and unit of joints in a driver."""


def table_layout(hand: Hand, table: str) -> TableLayout:
    """The layout of a table for a hand.

    Args:
        hand: the hand.
        table: a file, ``{side}`` in its name stands for the side; or the name of a table.

    Raises:
        ConfigError: there is no such table, it is of the other side, or it can't be read.
        UnknownNameError: the hand has no joint of a name in it.
    """
    side = hand.spec.side
    read = read_table(find_table(table.replace("{side}", side), "ros2", side))
    if read.side != side:
        raise ConfigError(
            f"ros2: {read.file} is of the {read.side} hand, and commands are for the {side} one; "
            "put {side} into the name of the table"
        )
    return TableLayout(read.bind(hand))


def joint_layout(hand: Hand, joints: str, prefix: str = "") -> JointLayout:
    """The layout for a hand.

    Args:
        hand: the hand.
        joints: ``all``, ``actuated`` (those without couplings to another), or names with ``*`` for
            any letters, separated by blanks, in the order in which they are sent.
        prefix: put before each name.

    Raises:
        UnknownNameError: the hand has no joint of a name.
    """
    if joints in ("all", "actuated"):
        indices = hand.actuated if joints == "actuated" else tuple(range(len(hand.joint_names)))
    else:
        indices = tuple(dict.fromkeys(i for word in joints.split() for i in _matching(hand, word)))
    names = tuple(prefix + hand.joint_names[i] for i in indices)
    return JointLayout(names, indices)


def _matching(hand: Hand, pattern: str) -> list[int]:
    indices = [i for i, name in enumerate(hand.joint_names) if fnmatchcase(name, pattern)]
    if not indices:
        raise UnknownNameError(
            f"joint of hand {hand.name!r}:",
            pattern,
            hand.joint_names,
            "joints= takes all, actuated, or names separated by blanks.",
        )
    return indices


def pose_message(pose: Float[np.ndarray, "7"]) -> Pose:
    """A pose x y z [m] and quaternion w x y z as a message."""
    x, y, z, w, a, b, c = pose.tolist()
    return Pose(Point(x, y, z), Quaternion(a, b, c, w))


def pose_rows(poses: list[Pose]) -> Float[np.ndarray, "n 7"]:
    """(n, 7) poses, x y z [m] and quaternion w x y z."""
    rows = [
        (p.position.x, p.position.y, p.position.z, q.w, q.x, q.y, q.z)
        for p in poses
        for q in (p.orientation,)
    ]
    return np.array(rows, np.float64).reshape(len(rows), 7)
