"""Another program on a ROS 2 network, without ROS 2: a process of its own.

The bytes of its messages are compared with those of rosbags elsewhere; those of MANUS, which
rosbags does not know, are defined here once more. One JSON object a line on standard input:
``{"domain": 3, "subscribe": "rt/x", "type": "JointState"}`` or
``{"domain": 3, "publish": "rt/x", "type": "PoseArray", "values": {...}, "reliable": true}``. What
comes goes to standard output, one line for each message: topic and fields.
"""

import dataclasses
import json
import sys
import threading
from dataclasses import dataclass
from typing import Any

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, int32, sequence
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from smooth_operator_devices.ros2.messages import (  # noqa: F401  (found by their names)
    Float64MultiArray,
    Header,
    JointState,
    JointTrajectory,
    Point,
    Pose,
    PoseArray,
    PoseStamped,
    Quaternion,
    String,
    Time,
)

# Settings of rmw_cyclonedds_cpp (Humble) where ROS_LOCALHOST_ONLY is 1. Elsewhere than on Linux
# the loopback interface may have no multicast, and programs find each other by unicast.
UNICAST = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
)
CONFIG = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface address="127.0.0.1"/>'
    f"</Interfaces></General>{'' if sys.platform == 'linux' else UNICAST}</Domain></CycloneDDS>"
)


@dataclass
class RawNode(IdlStruct, typename="manus_ros2_msgs.msg.dds_.ManusRawNode_"):
    node_id: int32
    parent_node_id: int32
    joint_type: str
    chain_type: str
    pose: Pose


@dataclass
class Ergonomics(IdlStruct, typename="manus_ros2_msgs.msg.dds_.ManusErgonomics_"):
    type: str
    value: float32


@dataclass
class ManusGlove(IdlStruct, typename="manus_ros2_msgs.msg.dds_.ManusGlove_"):
    glove_id: int32
    side: str
    raw_node_count: int32
    raw_nodes: sequence[RawNode]
    ergonomics_count: int32
    ergonomics: sequence[Ergonomics]
    raw_sensor_orientation: Quaternion
    raw_sensor_count: int32
    raw_sensor: sequence[Pose]


RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))


def header(frame: str, stamp: float) -> Header:
    return Header(Time(int(stamp), round(stamp % 1 * 1e9)), frame)


def pose(row: list[float]) -> Pose:
    """From x y z, and a quaternion x y z w where it is there."""
    return Pose(Point(*row[:3]), Quaternion(*(row[3:] or (0.0, 0.0, 0.0, 1.0))))


def message(kind: str, values: dict[str, Any]) -> Any:
    head = header(values.get("frame", ""), values.get("stamp", 0.0))
    if kind == "PoseArray":
        return PoseArray(head, [pose(row) for row in values["poses"]])
    if kind == "PoseStamped":
        return PoseStamped(head, pose(values["pose"]))
    if kind == "ManusGlove":
        nodes = [RawNode(i, 0, "MCP", "Index", pose(row)) for i, row in enumerate(values["poses"])]
        angles = [Ergonomics("IndexMCPStretch", 12.5)]
        turn = Quaternion(0.0, 0.0, 0.0, 1.0)
        return ManusGlove(
            values["glove"], values["side"], len(nodes), nodes[::-1], 1, angles, turn, 0, []
        )
    return String(values["data"])


class Peer:
    """The domains, writers and readers of this process."""

    def __init__(self) -> None:
        self.domains: dict[int, tuple[Any, Any]] = {}
        self.writers: dict[tuple[int, str], Any] = {}
        self.readers: list[tuple[str, Any]] = []
        self.lock = threading.Lock()

    def participant(self, number: int) -> Any:
        if number not in self.domains:
            self.domains[number] = Domain(number, CONFIG), DomainParticipant(number)
        return self.domains[number][1]

    def obey(self, order: dict[str, Any]) -> None:
        participant = self.participant(order["domain"])
        kind = globals()[order["type"]]
        reliability = RELIABLE if order.get("reliable", True) else Policy.Reliability.BestEffort
        qos = Qos(reliability, Policy.Durability.Volatile, Policy.History.KeepLast(10))
        if "subscribe" in order:
            topic = Topic(participant, order["subscribe"], kind)
            with self.lock:
                reader = DataReader(participant, topic, qos=qos)
                self.readers.append((order["subscribe"], reader))
            return
        key = order["domain"], order["publish"]
        if key not in self.writers:
            topic = Topic(participant, order["publish"], kind)
            self.writers[key] = DataWriter(participant, topic, qos=qos)
        if order["values"] is not None:
            self.writers[key].write(message(order["type"], order["values"]))

    def print_what_comes(self) -> None:
        wait = threading.Event()
        while not wait.wait(0.005):
            with self.lock:
                readers = list(self.readers)
            for topic, reader in readers:
                for sample in reader.take(64):
                    if isinstance(sample, reader.topic.data_type):  # not a writer's end
                        line = {"topic": topic, **dataclasses.asdict(sample)}
                        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    peer = Peer()
    threading.Thread(target=peer.print_what_comes, daemon=True).start()
    for text in sys.stdin:
        peer.obey(json.loads(text))
