"""Defines ROS 2 messages as CycloneDDS classes, without a ROS 2 installation.

Fields are those of the public interface definitions, the same from Humble to Rolling, and of
manus_ros2_msgs. The type ``std_msgs/msg/String`` is ``std_msgs::msg::dds_::String_`` in DDS.
"""

import types
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias, TypeVar

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float32, float64, int16, int32, sequence, uint8, uint32

Message: TypeAlias = IdlStruct
"""A message of ROS 2."""

M = TypeVar("M", bound=Message)

_DEFAULTS: Final = {uint8: 0, int16: 0, int32: 0, uint32: 0, float32: 0.0, float64: 0.0, str: ""}


def message_class(package: str, name: str, /, **fields: Any) -> Any:
    """Makes the class of a message, a dataclass with a default for each field.

    Args:
        package: ROS 2 package that defines the message.
        name: name of the message.
        fields: name -> type, in the order of the definition; or type and default.
    """

    def body(members: dict[str, Any]) -> None:
        members["__module__"], members["__doc__"] = __name__, f"``{package}/msg/{name}``."
        for each, kind in fields.items():
            kind, *default = kind if isinstance(kind, tuple) else (kind,)
            members["__annotations__"][each] = kind
            if default or kind in _DEFAULTS:
                members[each] = default[0] if default else _DEFAULTS[kind]
            else:
                members[each] = field(default_factory=kind if isinstance(kind, type) else list)

    kind = types.new_class(name, (IdlStruct,), {"typename": f"{package}.msg.dds_.{name}_"}, body)
    return dataclass(final(kind))


def type_name(kind: type[Message]) -> str:
    """Name of a message's type in ROS 2, such as ``sensor_msgs/msg/JointState``."""
    name: str = kind.__idl_typename__
    return name.replace(".msg.dds_.", "/msg/").removesuffix("_")


Time = message_class("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Duration = message_class("builtin_interfaces", "Duration", sec=int32, nanosec=uint32)
Header = message_class("std_msgs", "Header", stamp=Time, frame_id=str)
String = message_class("std_msgs", "String", data=str)
MultiArrayDimension = message_class(
    "std_msgs", "MultiArrayDimension", label=str, size=uint32, stride=uint32
)
MultiArrayLayout = message_class(
    "std_msgs", "MultiArrayLayout", dim=sequence[MultiArrayDimension], data_offset=uint32
)
Float64MultiArray = message_class(
    "std_msgs", "Float64MultiArray", layout=MultiArrayLayout, data=sequence[float64]
)
Point = message_class("geometry_msgs", "Point", x=float64, y=float64, z=float64)
Quaternion = message_class(
    "geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=(float64, 1.0)
)
Pose = message_class("geometry_msgs", "Pose", position=Point, orientation=Quaternion)
PoseStamped = message_class("geometry_msgs", "PoseStamped", header=Header, pose=Pose)
PoseArray = message_class("geometry_msgs", "PoseArray", header=Header, poses=sequence[Pose])

_NUMBERS: Final = sequence[float64]
JointState = message_class(
    "sensor_msgs",
    "JointState",
    header=Header,
    name=sequence[str],
    position=_NUMBERS,
    velocity=_NUMBERS,
    effort=_NUMBERS,
)
JointTrajectoryPoint = message_class(
    "trajectory_msgs",
    "JointTrajectoryPoint",
    positions=_NUMBERS,
    velocities=_NUMBERS,
    accelerations=_NUMBERS,
    effort=_NUMBERS,
    time_from_start=Duration,
)
JointTrajectory = message_class(
    "trajectory_msgs",
    "JointTrajectory",
    header=Header,
    joint_names=sequence[str],
    points=sequence[JointTrajectoryPoint],
)
ManusRawNode = message_class(
    "manus_ros2_msgs",
    "ManusRawNode",
    node_id=int32,
    parent_node_id=int32,
    joint_type=str,
    chain_type=str,
    pose=Pose,
)
ManusErgonomics = message_class("manus_ros2_msgs", "ManusErgonomics", type=str, value=float32)
ManusGlove = message_class(
    "manus_ros2_msgs",
    "ManusGlove",
    glove_id=int32,
    side=str,
    raw_node_count=int32,
    raw_nodes=sequence[ManusRawNode],
    ergonomics_count=int32,
    ergonomics=sequence[ManusErgonomics],
    raw_sensor_orientation=Quaternion,
    raw_sensor_count=int32,
    raw_sensor=sequence[Pose],
)


def time_of(nanoseconds: int) -> Message:
    """Converts nanoseconds since 1970 to a ``Time`` message."""
    return Time(*divmod(nanoseconds, 1_000_000_000))


def seconds_of(time: Message) -> float:
    """Converts a ``Time`` message to seconds [s]."""
    return float(time.sec + 1e-9 * time.nanosec)


def nanoseconds_of(time: Message) -> int:
    """Converts a ``Time`` message to nanoseconds since 1970."""
    return int(1_000_000_000 * time.sec + time.nanosec)
