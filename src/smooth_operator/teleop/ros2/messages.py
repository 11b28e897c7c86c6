"""ROS 2 messages as classes of CycloneDDS, without a ROS 2 installation.

Fields are those of the public interface definitions (builtin_interfaces, std_msgs, geometry_msgs,
sensor_msgs, trajectory_msgs), the same from Humble to Rolling, and of manus_ros2_msgs.
The type ``std_msgs/msg/String`` is ``std_msgs::msg::dds_::String_`` in DDS. Without
``annotations`` from the future: CycloneDDS evaluates them.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar, dataclass_transform

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float32, float64, int32, uint32

if TYPE_CHECKING:
    from builtins import list as sequence
else:
    from cyclonedds.idl.types import sequence

Message = IdlStruct
"""A message of ROS 2."""

M = TypeVar("M", bound=Message)


@dataclass_transform(field_specifiers=(field,))
def _message(kind: type[M]) -> type[M]:
    return dataclass(final(kind))


def type_name(kind: type[Message]) -> str:
    """The type of a message in ROS 2: ``sensor_msgs/msg/JointState``."""
    name: str = kind.__idl_typename__
    return name.replace(".msg.dds_.", "/msg/").removesuffix("_")


@_message
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    """A point in time: seconds and nanoseconds since 1970."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @property
    def seconds(self) -> float:
        """The time as one number [s]."""
        return float(self.sec + 1e-9 * self.nanosec)

    @property
    def nanoseconds(self) -> int:
        """The time as one whole number [ns]."""
        return int(1_000_000_000 * self.sec + self.nanosec)

    @staticmethod
    def of(nanoseconds: int) -> "Time":
        """The time of a number of nanoseconds since 1970."""
        return Time(*divmod(nanoseconds, 1_000_000_000))


@_message
class Duration(IdlStruct, typename="builtin_interfaces.msg.dds_.Duration_"):
    """A length of time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@_message
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    """Stamp, and name of the reference frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@_message
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    """A text."""

    data: str = ""


@_message
class MultiArrayDimension(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayDimension_"):
    """One dimension of an array."""

    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@_message
class MultiArrayLayout(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayLayout_"):
    """Dimensions of an array; none for a plain list."""

    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@_message
class Float64MultiArray(IdlStruct, typename="std_msgs.msg.dds_.Float64MultiArray_"):
    """Numbers without names."""

    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)


@_message
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    """A position [m]."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@_message
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    """A rotation; ROS 2 writes w last."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@_message
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    """Position and orientation."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@_message
class PoseStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseStamped_"):
    """A pose at a time, in a frame."""

    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@_message
class PoseArray(IdlStruct, typename="geometry_msgs.msg.dds_.PoseArray_"):
    """Poses at a time, in a frame."""

    header: Header = field(default_factory=Header)
    poses: sequence[Pose] = field(default_factory=list)


@_message
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    """Positions [rad], velocities [rad/s] and efforts of joints."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@_message
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs.msg.dds_.JointTrajectoryPoint_"):
    """Targets of joints at a time after the start."""

    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@_message
class JointTrajectory(IdlStruct, typename="trajectory_msgs.msg.dds_.JointTrajectory_"):
    """A motion of joints."""

    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@_message
class ManusRawNode(IdlStruct, typename="manus_ros2_msgs.msg.dds_.ManusRawNode_"):
    """One node of a glove's skeleton."""

    node_id: int32 = 0
    parent_node_id: int32 = 0
    joint_type: str = ""
    chain_type: str = ""
    pose: Pose = field(default_factory=Pose)


@_message
class ManusErgonomics(IdlStruct, typename="manus_ros2_msgs.msg.dds_.ManusErgonomics_"):
    """One joint angle of a glove."""

    type: str = ""
    value: float32 = 0.0


@_message
class ManusGlove(IdlStruct, typename="manus_ros2_msgs.msg.dds_.ManusGlove_"):
    """One glove, as MANUS's ROS 2 package publishes it."""

    glove_id: int32 = 0
    side: str = ""
    raw_node_count: int32 = 0
    raw_nodes: sequence[ManusRawNode] = field(default_factory=list)
    ergonomics_count: int32 = 0
    ergonomics: sequence[ManusErgonomics] = field(default_factory=list)
    raw_sensor_orientation: Quaternion = field(default_factory=Quaternion)
    raw_sensor_count: int32 = 0
    raw_sensor: sequence[Pose] = field(default_factory=list)
