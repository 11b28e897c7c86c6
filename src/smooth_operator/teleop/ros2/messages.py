"""ROS 2 messages that are sent and read here, as dataclasses that need no ROS 2.

Fields are those of the public interface definitions (builtin_interfaces, std_msgs, geometry_msgs,
sensor_msgs, trajectory_msgs, tf2_msgs), the same from Humble to Rolling, and of manus_ros2_msgs. A
class knows the name of its type; ``to_foreign`` and ``from_foreign`` change to and from the classes
of a library.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar, get_args, get_type_hints

Int32: TypeAlias = Annotated[int, "int32"]
UInt32: TypeAlias = Annotated[int, "uint32"]
Float32: TypeAlias = Annotated[float, "float32"]
Float64: TypeAlias = Annotated[float, "float64"]


@dataclass
class Message:
    """A message.

    Attributes:
        type_name: its type in ROS 2: ``sensor_msgs/msg/JointState``.
    """

    type_name: ClassVar[str]


@dataclass
class Time(Message):
    """A point in time: seconds and nanoseconds since 1970."""

    type_name = "builtin_interfaces/msg/Time"
    sec: Int32 = 0
    nanosec: UInt32 = 0

    @property
    def seconds(self) -> float:
        """As one number [s]."""
        return self.sec + 1e-9 * self.nanosec

    @property
    def nanoseconds(self) -> int:
        """As one whole number [ns]."""
        return 1_000_000_000 * self.sec + self.nanosec

    @staticmethod
    def of(nanoseconds: int) -> Time:
        """The time so many nanoseconds after 1970."""
        return Time(*divmod(nanoseconds, 1_000_000_000))


@dataclass
class Duration(Message):
    """A length of time."""

    type_name = "builtin_interfaces/msg/Duration"
    sec: Int32 = 0
    nanosec: UInt32 = 0


@dataclass
class Header(Message):
    """Stamp, and name of the frame that positions are in."""

    type_name = "std_msgs/msg/Header"
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class String(Message):
    """A text."""

    type_name = "std_msgs/msg/String"
    data: str = ""


@dataclass
class MultiArrayDimension(Message):
    """One dimension of an array."""

    type_name = "std_msgs/msg/MultiArrayDimension"
    label: str = ""
    size: UInt32 = 0
    stride: UInt32 = 0


@dataclass
class MultiArrayLayout(Message):
    """Dimensions of an array; none for a plain list."""

    type_name = "std_msgs/msg/MultiArrayLayout"
    dim: list[MultiArrayDimension] = field(default_factory=list)
    data_offset: UInt32 = 0


@dataclass
class Float64MultiArray(Message):
    """Numbers without names."""

    type_name = "std_msgs/msg/Float64MultiArray"
    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: list[Float64] = field(default_factory=list)


@dataclass
class Point(Message):
    """A position [m]."""

    type_name = "geometry_msgs/msg/Point"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


@dataclass
class Vector3(Message):
    """A vector."""

    type_name = "geometry_msgs/msg/Vector3"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


@dataclass
class Quaternion(Message):
    """A rotation; ROS 2 writes w last."""

    type_name = "geometry_msgs/msg/Quaternion"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0
    w: Float64 = 1.0


@dataclass
class Pose(Message):
    """Position and rotation."""

    type_name = "geometry_msgs/msg/Pose"
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(Message):
    """A pose in a named frame at a time."""

    type_name = "geometry_msgs/msg/PoseStamped"
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass
class PoseArray(Message):
    """Poses in a named frame at a time."""

    type_name = "geometry_msgs/msg/PoseArray"
    header: Header = field(default_factory=Header)
    poses: list[Pose] = field(default_factory=list)


@dataclass
class Transform(Message):
    """Translation and rotation between two frames."""

    type_name = "geometry_msgs/msg/Transform"
    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(Message):
    """Where the frame ``child_frame_id`` is in the frame of the header."""

    type_name = "geometry_msgs/msg/TransformStamped"
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class TFMessage(Message):
    """Transforms, as on ``/tf``."""

    type_name = "tf2_msgs/msg/TFMessage"
    transforms: list[TransformStamped] = field(default_factory=list)


@dataclass
class JointState(Message):
    """Positions, velocities and efforts of named joints; a list may be empty."""

    type_name = "sensor_msgs/msg/JointState"
    header: Header = field(default_factory=Header)
    name: list[str] = field(default_factory=list)
    position: list[Float64] = field(default_factory=list)
    velocity: list[Float64] = field(default_factory=list)
    effort: list[Float64] = field(default_factory=list)


@dataclass
class JointTrajectoryPoint(Message):
    """Where the joints are to be so long after the stamp."""

    type_name = "trajectory_msgs/msg/JointTrajectoryPoint"
    positions: list[Float64] = field(default_factory=list)
    velocities: list[Float64] = field(default_factory=list)
    accelerations: list[Float64] = field(default_factory=list)
    effort: list[Float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory(Message):
    """Points of a motion of named joints; a stamp of zero means "from now on"."""

    type_name = "trajectory_msgs/msg/JointTrajectory"
    header: Header = field(default_factory=Header)
    joint_names: list[str] = field(default_factory=list)
    points: list[JointTrajectoryPoint] = field(default_factory=list)


M = TypeVar("M", bound=Message)

_FIELDS: dict[type[Message], dict[str, tuple[Any, bool]]] = {}


@dataclass
class ManusRawNode(Message):
    """A node of the skeleton of a MANUS glove."""

    type_name = "manus_ros2_msgs/msg/ManusRawNode"
    node_id: Int32 = 0
    parent_node_id: Int32 = 0
    joint_type: str = ""
    chain_type: str = ""
    pose: Pose = field(default_factory=Pose)


@dataclass
class ManusErgonomics(Message):
    """A joint angle of a MANUS glove."""

    type_name = "manus_ros2_msgs/msg/ManusErgonomics"
    type: str = ""
    value: Float32 = 0.0


@dataclass
class ManusGlove(Message):
    """A MANUS glove; its raw nodes are 25."""

    type_name = "manus_ros2_msgs/msg/ManusGlove"
    glove_id: Int32 = 0
    side: str = ""
    raw_node_count: Int32 = 0
    raw_nodes: list[ManusRawNode] = field(default_factory=list)
    ergonomics_count: Int32 = 0
    ergonomics: list[ManusErgonomics] = field(default_factory=list)
    raw_sensor_orientation: Quaternion = field(default_factory=Quaternion)
    raw_sensor_count: Int32 = 0
    raw_sensor: list[Pose] = field(default_factory=list)


def field_types(kind: type[Message]) -> dict[str, tuple[Any, bool]]:
    """Fields of a message in their order: name -> type, and whether there is a list of it.

    A type is a message, ``str``, or the name of a number: ``"int32"``, ``"uint32"``, ``"float32"``,
    ``"float64"``.
    """
    if kind in _FIELDS:
        return _FIELDS[kind]
    hints = get_type_hints(kind, include_extras=True)
    types: dict[str, tuple[Any, bool]] = {}
    for each in dataclasses.fields(kind):
        hint, many = hints[each.name], False
        if getattr(hint, "__origin__", None) is list:
            (hint,), many = get_args(hint), True
        number = getattr(hint, "__metadata__", None)
        types[each.name] = (hint if number is None else number[0], many)
    _FIELDS[kind] = types
    return types


def to_foreign(message: Message, find: Callable[[type[Message]], Any]) -> Any:
    """A message as an object of a library.

    Args:
        message: the message.
        find: the library's class for one of ours.
    """
    values: dict[str, Any] = {}
    for name, (kind, many) in field_types(type(message)).items():
        value = getattr(message, name)
        if isinstance(kind, type) and issubclass(kind, Message):
            value = [to_foreign(v, find) for v in value] if many else to_foreign(value, find)
        values[name] = value
    return find(type(message))(**values)


def from_foreign(value: Any, kind: type[M]) -> M:
    """An object of a library with the fields of a message, as that message."""
    values: dict[str, Any] = {}
    for name, (inner, many) in field_types(kind).items():
        item: Any = getattr(value, name)
        if isinstance(inner, type) and issubclass(inner, Message):
            read: Sequence[Any] = [from_foreign(v, inner) for v in (item if many else [item])]
            values[name] = read if many else read[0]
        else:
            values[name] = list(item) if many else item
    return kind(**values)
