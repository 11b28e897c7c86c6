"""ROS 2 without ROS 2: against another process with definitions of its own, and against rosbags."""

import dataclasses
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_time import PATIENCE_S, until
from scipy.spatial.transform import Rotation
from ticks import make_tick

from smooth_operator.errors import ConfigError, RecordingError, SinkError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import NODE_LAYOUTS
from smooth_operator.poses import wrist_from_landmarks
from smooth_operator.retargeting.alignment import reference_landmarks
from smooth_operator.teleop.components import build_sink, build_source
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, Mode, Tick, WristCommand
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.types import HandFrame, Side

pytest.importorskip("cyclonedds", reason="needs CycloneDDS's Python binding: the extra ros2")

from smooth_operator_devices.ros2 import messages as ros
from smooth_operator_devices.ros2 import sink as sink_module
from smooth_operator_devices.ros2 import transport as transport_module
from smooth_operator_devices.ros2.messages import Message
from smooth_operator_devices.ros2.sink import Ros2Sink
from smooth_operator_devices.ros2.source import HandPoseReader, Ros2Source
from smooth_operator_devices.ros2.transport import Endpoint, Transport, reach_of

DOMAINS = (1 + (os.getpid() * 13 + i) % 100 for i in count())
"""A domain, which is a range of ports, for each test."""
LOCAL = {"network": "localhost"}


class Peer:
    """The other process, and what it says has come: topic -> messages."""

    def __init__(self) -> None:
        script = Path(__file__).with_name("ros2_peer.py")
        self.process = subprocess.Popen(
            [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.came: dict[str, list[dict[str, Any]]] = {}
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self) -> None:
        for line in self.process.stdout or ():
            message = json.loads(line)
            self.came.setdefault(message.pop("topic"), []).append(message)

    def order(self, **order: Any) -> None:
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()

    def of(self, topic: str) -> list[dict[str, Any]]:
        return self.came.get(topic, [])


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    other = Peer()
    yield other
    other.process.stdin.close()
    other.process.wait(PATIENCE_S)


@pytest.fixture
def domain() -> int:
    return next(DOMAINS)


def send_until(sink: Ros2Sink, tick: Tick, done: Callable[[], object]) -> None:
    """Send a command again and again: what is sent before the two found each other is lost."""

    def sent() -> object:
        sink.send(tick)
        time.sleep(0.01)
        return done()

    until(sent)


SAMPLES: list[Message] = [
    ros.String("tracking, não só"),
    ros.JointState(
        ros.Header(ros.Time(1_700_000_000, 999_999_999), "base"),
        ["a", "bcd", ""],
        [0.1, -2.5, 3e-300],
        [1.0],
        [],
    ),
    ros.JointTrajectory(
        ros.Header(),
        ["thumb", "index_mcp"],
        [ros.JointTrajectoryPoint([0.5, -0.5], time_from_start=ros.Duration(0, 50_000_000))],
    ),
    ros.Float64MultiArray(
        ros.MultiArrayLayout([ros.MultiArrayDimension("q", 3, 3)], 0), [1.0, 2.0, 3.0]
    ),
    ros.Float64MultiArray(data=[0.25]),
    ros.PoseStamped(ros.Header(ros.Time(5, 6), "w"), ros.Pose(ros.Point(1.0, 2.0, 3.0))),
    ros.PoseArray(ros.Header(ros.Time(5, 6), "odd"), [ros.Pose()] * 2),
]


def of_rosbags(store: Any, message: Message) -> Any:
    """The message as an object of rosbags."""
    values = {}
    for each in dataclasses.fields(message):
        value = getattr(message, each.name)
        if dataclasses.is_dataclass(value):
            value = of_rosbags(store, value)
        elif "float64" in str(each.type) and isinstance(value, list):
            value = np.array(value, float)
        elif isinstance(value, list):
            value = [of_rosbags(store, v) if isinstance(v, Message) else v for v in value]
        values[each.name] = value
    return store.types[ros.type_name(type(message))](**values)


@pytest.mark.parametrize("release", ["ROS2_HUMBLE", "ROS2_JAZZY"])
def test_bytes_are_those_of_rosbags(release):
    rosbags = pytest.importorskip("rosbags.typesys", reason="needs rosbags to compare with")
    store = rosbags.get_typestore(rosbags.Stores[release])
    for message in SAMPLES:
        name = ros.type_name(type(message))
        ours = message.serialize(use_version_2=False)
        theirs = bytes(store.serialize_cdr(of_rosbags(store, message), name))
        assert ours.rstrip(b"\0") == theirs.rstrip(b"\0"), name
        assert abs(len(ours) - len(theirs)) < 4  # a sample is filled up to four bytes
        assert type(message).deserialize(theirs) == message
        back = store.deserialize_cdr(ours, name)
        assert str(back) == str(of_rosbags(store, message))


def test_another_process_gets_joints_mode_and_wrists(peer, domain, hand):
    sink = Ros2Sink(domain=domain, human_wrist="/{side}/human", base="panda_link0", **LOCAL)
    for topic, kind in {
        "rt/mimic_p050/right/joint_commands": "JointState",
        "rt/mimic_p050/right/joint_commands_mode": "String",
        "rt/mimic_p050/right/wrist_pose": "PoseStamped",
        "rt/right/human": "PoseStamped",
    }.items():
        peer.order(domain=domain, subscribe=topic, type=kind)
    sink.check({"right": hand})
    sink.open({"right": hand}, {})
    assert "this machine only" in sink.note
    target = np.array([0.5, -0.25, 1.0, 0.5, 0.5, -0.5, 0.5])
    human = np.array([0.125, 0.25, 0.375, 0.5, -0.5, 0.5, 0.5])
    tick = make_tick(hand, 3)
    frame = replace(tick.arrival.frame, T_world_wrist=human, world="headset")
    tick = replace(
        tick,
        wrist=WristCommand(target, True, True),
        arrival=replace(tick.arrival, frame=frame),
        velocity=np.linspace(-1.0, 1.0, len(hand.joint_names)),
    )
    send_until(sink, tick, lambda: peer.of("rt/right/human"))
    until(lambda: peer.of("rt/mimic_p050/right/joint_commands"))
    until(lambda: peer.of("rt/mimic_p050/right/wrist_pose"))

    def last_mode() -> str:
        messages = peer.of("rt/mimic_p050/right/joint_commands_mode")
        return messages[-1]["data"] if messages else ""

    sink.stalled(0.3)
    until(lambda: last_mode() == "stalled")
    sink.close()
    until(lambda: last_mode() == "ended")
    state = peer.of("rt/mimic_p050/right/joint_commands")[-1]
    assert state["name"] == list(hand.joint_names)
    assert state["position"] == tick.command.joint_positions.tolist()
    assert state["velocity"] == tick.velocity.tolist()
    assert state["effort"] == []
    assert abs(state["header"]["stamp"]["sec"] - time.time()) < 600
    wrist = peer.of("rt/mimic_p050/right/wrist_pose")[-1]
    assert wrist["header"]["frame_id"] == "panda_link0"
    assert list(wrist["pose"]["position"].values()) == [0.5, -0.25, 1.0]
    assert list(wrist["pose"]["orientation"].values()) == [0.5, -0.5, 0.5, 0.5]  # x y z w
    tracked = peer.of("rt/right/human")[-1]
    assert tracked["header"]["frame_id"] == "headset"
    assert list(tracked["pose"]["orientation"].values()) == [-0.5, 0.5, 0.5, 0.5]
    stamps = {
        json.dumps(m["header"]["stamp"]) for m in peer.of("rt/mimic_p050/right/joint_commands")
    }
    assert json.dumps(wrist["header"]["stamp"]) in stamps  # wrist and fingers bear one stamp


class Recorded:
    """A transport that keeps what is published: topic -> messages."""

    label = "kept"

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}
        self.closed = False

    def publisher(self, kind: type[Message], topic: str) -> Callable[[Any], None]:
        return self.sent.setdefault(topic, []).append

    def now(self) -> Message:
        return ros.Time(7, 8)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def recorded(monkeypatch) -> Recorded:
    transport = Recorded()
    monkeypatch.setattr(sink_module, "Transport", lambda endpoint: transport)
    return transport


def test_controllers_get_the_actuated_joints_by_their_names(hand, recorded):
    assert len(hand.actuated) < len(hand.joint_names)
    tick = make_tick(hand, 7)
    actuated = dict(zip(hand.joint_names, tick.command.joint_positions.tolist(), strict=True))
    names = list(hand.actuated_names)
    first, *_, last = names
    sinks = [
        Ros2Sink("/trajectory", "trajectory", prefix="r_", duration=0.125),
        Ros2Sink("/array", "array"),
        Ros2Sink("/state", joints=f"{last} {first[:-1]}*"),
    ]
    for sink in sinks:
        sink.connect({"right": hand}, {}).deliver(tick)
    trajectory, array, state = (recorded.sent[sink.topic][-1] for sink in sinks)
    assert trajectory.joint_names == [f"r_{name}" for name in names]
    (point,) = trajectory.points
    assert point.positions == [actuated[name] for name in names]
    assert (point.velocities, point.time_from_start) == ([], ros.Duration(0, 125_000_000))
    assert trajectory.header.stamp == ros.Time(0, 0)  # from now on
    assert array.data == [actuated[name] for name in names]
    assert state.name[:2] == [last, first]
    assert state.position == [actuated[name] for name in state.name]


def test_rate_is_the_most_and_a_new_mode_is_never_left_out(hand, recorded):
    link = Ros2Sink("/x", rate=30.0).connect({"right": hand}, {})
    for i in range(100):  # a second at 100 Hz
        link.deliver(make_tick(hand, i, at=50.0 + 0.01 * i))
    assert 29 <= len(recorded.sent["/x"]) <= 31
    before = len(recorded.sent["/x"])
    link.deliver(make_tick(hand, 100, at=50.9901, mode=Mode.STOPPED))
    assert len(recorded.sent["/x"]) == before + 1
    assert recorded.sent["/x_mode"][-1].data == "stopped"
    link.close()
    assert recorded.closed


TABLE = """
format = 1
driver = "ros2"
hand = "mimic_p050"
side = "right"
unit = "0-255"
[[actuators]]
name = "index"
joint = "{index}"
points = [[0.0, 255.0], [1.5, 0.0]]
[[actuators]]
name = "thumb"
joint = "{thumb}"
points = [[-1.0, 10.0], [0.0, 100.0], [1.0, 250.0]]
ends = [20.0, 240.0]
"""


def test_a_table_gives_names_order_and_commands(hand, recorded, tmp_path):
    index, thumb = hand.joint_names[5], hand.joint_names[1]
    file = tmp_path / "driver_right.toml"
    file.write_text(TABLE.format(index=index, thumb=thumb), encoding="utf-8")
    sink = build_sink(f"ros2:/x,rate=30,table={tmp_path}/driver_{{side}}.toml")
    link = sink.connect({"right": hand}, {})
    tick = make_tick(hand)
    for angle, command in {0.5: 170.0, 0.0: 255.0, 9.0: 0.0}.items():
        q = np.zeros(len(hand.joint_names))
        q[5], q[1] = angle, 2.0
        moved = replace(
            tick, command=replace(tick.command, joint_positions=q), time=tick.time + angle + 1
        )
        link.deliver(moved)
        sent = recorded.sent["/x"][-1]
        assert (sent.name, sent.velocity) == (["index", "thumb"], [])
        assert sent.position == pytest.approx([command, 240.0])
        tick = moved
    with pytest.raises(ConfigError, match=r"driver_right\.toml is of the right hand"):
        Ros2Sink(table=str(file)).connect({"left": load_hand("mimic_p050", "left")}, {})
    file.write_text(TABLE.format(index="no_such", thumb=thumb), encoding="utf-8")
    with pytest.raises(UnknownNameError, match="no_such"):
        Ros2Sink(table=str(file)).connect({"right": hand}, {})
    with pytest.raises(ConfigError, match=r"there is no table nowhere_right\.toml"):
        Ros2Sink(table="nowhere").connect({"right": hand}, {})
    with pytest.raises(ConfigError, match="the table determines names and order"):
        Ros2Sink(table="x", prefix="r_")


def test_the_drivers_of_the_page_get_their_joints_in_their_order(recorded):
    page = Path(__file__).parents[3] / "docs" / "how-to" / "ros2.md"
    commands = re.findall(r"`--hand (\w+) --sink (.*?)`", page.read_text(encoding="utf-8"))
    sent = {}
    for name, text in commands:
        hand = load_hand(name)
        sink = build_sink(text.strip('"'))
        link = sink.connect({"right": hand}, {})
        link.deliver(make_tick(hand))
        topic = sink.topic.format(hand=name, side="right")
        sent[topic] = recorded.sent[topic][-1]
    assert len(sent) == len(commands) == 6
    wuji, linker, tesollo, trajectory, group, allegro = sent.values()
    # Names and order as the makers' configuration files have them.
    fingers = [f"finger{i}_joint{k}" for i in range(1, 6) for k in range(1, 5)]
    assert wuji.name == [f"right_{name}" for name in fingers]
    assert tesollo.joint_names == [f"rj_dg_{i}_{k}" for i in range(1, 6) for k in range(1, 5)]
    assert trajectory.joint_names[:2] == [
        f"right_thumb_{w}_joint" for w in ("metacarpal", "proximal")
    ]
    assert len(trajectory.joint_names) == len(group.data) == 6
    assert group.data[:2] == trajectory.points[0].positions[1::-1]  # thumb proximal first
    assert group.data[2:] == trajectory.points[0].positions[2:]
    assert (len(allegro.data), len(linker.position), linker.velocity) == (16, 10, [])
    assert all(0.0 <= value <= 255.0 for value in linker.position)
    first = " ".join(word.split("_")[0] for word in linker.name)
    assert first == "thumb thumb index middle ring little index ring little thumb"


def test_no_wrist_no_message(hand, recorded):
    link = Ros2Sink("/x", human_wrist="/h").connect({"right": hand}, {})
    tick = make_tick(hand)
    lost = replace(tick.arrival.frame, T_world_wrist=np.full(7, np.nan), world="headset")
    link.deliver(replace(tick, arrival=replace(tick.arrival, frame=lost)))
    assert recorded.sent["/h"] == recorded.sent["/mimic_p050/right/wrist_pose"] == []
    (sent,) = recorded.sent["/x"]
    assert len(sent.position) == len(sent.velocity) == len(hand.joint_names)


def test_the_arm_and_the_measured_joints_go_along(hand, recorded):
    sink = Ros2Sink("/x", rate=10.0, arm="/ur/{side}", arm_message="trajectory")
    link = sink.connect({"right": hand}, {})
    arm = ArmCommand(
        "ur5e", ("shoulder", "elbow"), np.array([0.5, -1.0]), np.array([0.1, 0.2]), np.zeros(7)
    )
    measured = np.full(len(hand.joint_names), np.nan)
    measured[[1, 4]] = 0.25, 0.75
    now = time.perf_counter()
    state = HandState("right", hand.name, now - 2.0, hand.joint_names, measured)
    tick = replace(make_tick(hand, at=now), arm=arm, state=state)
    link.deliver(tick)
    link.deliver(replace(tick, time=now + 0.01))  # too early for a command, and the same state
    later = replace(state, stamp=now - 1.0, velocities=measured * 2.0)
    link.deliver(replace(tick, time=now + 0.02, state=later))
    (sent,) = recorded.sent["/ur/right"]
    assert sent.joint_names == ["shoulder", "elbow"]
    assert sent.points[0].positions == [0.5, -1.0]
    first, second = recorded.sent["/mimic_p050/right/joint_states"]
    for message in (first, second):
        assert message.name == [hand.joint_names[1], hand.joint_names[4]]
        assert message.position == [0.25, 0.75]
    assert (first.velocity, second.velocity) == ([], [0.5, 1.5])
    assert 4.0 < ros.seconds_of(first.header.stamp) < 5.1  # 2 s before the command, at 7 s
    assert len(recorded.sent["/x"]) == 1


def test_a_command_that_is_not_finite_is_not_sent(hand, recorded):
    link = Ros2Sink("/x").connect({"right": hand}, {})
    tick = make_tick(hand)
    bad = tick.command.joint_positions.copy()
    bad[3] = np.nan
    with pytest.raises(SinkError, match="not finite"):
        link.deliver(replace(tick, command=replace(tick.command, joint_positions=bad)))
    assert recorded.sent["/x"] == []


def test_wrong_names_and_settings_say_what_is_expected(hand, recorded):
    with pytest.raises(UnknownNameError, match=r"no_such.*joints= must be all, actuated"):
        Ros2Sink(joints="no_such").connect({"right": hand}, {})
    with pytest.raises(SinkError, match="two hands on one topic"):
        Ros2Sink("/joints").connect({"right": hand, "left": hand}, {})
    for text, words in {
        "ros2:a b": "can't be a topic",
        "ros2:/x__y": "can't be a topic",
        "ros2:/{foot}/x": "can't be a topic",
        "ros2:wrist=1/2": "can't be a topic",
        "ros2:domain=233": "0 to 232",
        "ros2:network=all": "localhost or subnet",
        "ros2:message=twist": "joint_state or trajectory or array",
        "ros2:rate=-1": "rate must be",
        "ros2:joints= ": "joints must be",
    }.items():
        with pytest.raises(ConfigError, match=words):
            build_sink(text)


def a_hand(side: Side = "right", points: int = 21) -> np.ndarray:
    """(n, 3) points of an open hand, of 21, 25 or 26 [m]."""
    landmarks = reference_landmarks(load_hand("mimic_p050", side))
    if points == len(landmarks):
        return landmarks
    rows = np.random.default_rng(5).normal(0.0, 0.03, (points, 3))
    rows[list(NODE_LAYOUTS[points][0])] = landmarks
    return rows


def started(source: Ros2Source) -> tuple[Ros2Source, Mailbox]:
    mailbox = Mailbox()
    source.prepare()
    source.start(mailbox)
    return source, mailbox


def publish_until(peer: Peer, done: Callable[[], object], *orders: dict[str, Any]) -> None:
    """Publish again and again, until what comes of it is there."""

    def sent() -> object:
        for order in orders:
            peer.order(**order)
        time.sleep(0.02)
        return done()

    until(sent)


@pytest.mark.parametrize("reliable", [True, False])
def test_hands_come_from_another_process_with_the_wrist_in_the_world(peer, domain, reliable):
    source, mailbox = started(Ros2Source("/{side}/p", side="both", domain=domain, **LOCAL))
    hands = {"right": a_hand("right", 26), "left": a_hand("left", 25)}
    turn = Rotation.from_euler("xyz", [30, -20, 100], degrees=True)
    place = np.array([0.5, 0.25, 1.0])
    moved = {side: turn.apply(points) + place for side, points in hands.items()}
    orders: list[dict[str, Any]] = [
        {
            "domain": domain,
            "publish": f"rt/{side}/p",
            "type": "PoseArray",
            "reliable": reliable,
            "values": {"frame": "map", "stamp": 12.5, "poses": points.tolist()},
        }
        for side, points in moved.items()
    ]
    publish_until(peer, lambda: len(mailbox.received_of) == 2, *orders)
    for side, points in moved.items():
        arrival = mailbox.take(side)
        frame = arrival.frame
        landmarks = points[list(NODE_LAYOUTS[len(points)][0])]
        assert np.array_equal(frame.landmarks, landmarks)
        assert (frame.stamp, frame.side, frame.world) == (12.5, side, "map")
        assert frame.orientations is None  # all are the unit one: they say nothing
        wrist = wrist_from_landmarks(landmarks, side)
        assert np.allclose(frame.T_world_wrist, wrist)
        assert np.isfinite(wrist).all()
    source.stop()
    until(lambda: source.health().state == "ended")


def test_wrist_topic_gloves_and_texts(peer, domain):
    points = a_hand()
    points -= points[0]
    turn = Rotation.from_euler("xyz", [30, -20, 100], degrees=True)
    place = [0.5, 0.25, 1.0]
    common: dict[str, Any] = {"domain": domain, **LOCAL}
    sources = [
        started(Ros2Source("/h", frame="wrist", wrist="/w", **common)),
        started(Ros2Source("/g0 /g1", side="both", message="manus_glove", **common)),
        started(Ros2Source("/json", side="both", message="json", **common)),
    ]
    glove = a_hand("left", 25)
    text = json.dumps({"side": "right", "stamp": 3.5, "landmarks": points.tolist()})
    nodes = [{"id": i, "pos": row, "quat": [1, 0, 0, 0]} for i, row in enumerate(glove.tolist())]
    manus = json.dumps({"side": "left", "glove_id": 4, "nodes": nodes})
    pose = [*place, *turn.as_quat().tolist()]  # x y z w, as in ROS 2
    orders: list[dict[str, Any]] = [
        {"publish": "rt/w", "type": "PoseStamped", "values": {"frame": "odom", "pose": pose}},
        {"publish": "rt/h", "type": "PoseArray", "values": {"poses": points.tolist()}},
        {
            "publish": "rt/g1",
            "type": "ManusGlove",
            "values": {"glove": 7, "side": "Left", "poses": glove.tolist()},
        },
        {"publish": "rt/json", "type": "String", "values": {"data": text}},
        {"publish": "rt/json", "type": "String", "values": {"data": manus}},
    ]

    def all_are_here() -> bool:
        boxes = [mailbox for _, mailbox in sources]
        seen = boxes[0].newest("right")
        wrist = None if seen is None else seen.frame.T_world_wrist
        found = wrist is not None and bool(np.isfinite(wrist).all())
        return found and boxes[1].received > 0 and len(boxes[2].received_of) == 2

    publish_until(peer, all_are_here, *({"domain": domain, **order} for order in orders))
    in_wrist, from_glove, from_text = (mailbox for _, mailbox in sources)
    arrival = in_wrist.take("right")
    frame = arrival.frame
    assert np.array_equal(frame.landmarks, points)
    expected = wrist_from_landmarks(turn.apply(points) + place, "right")
    assert np.allclose(frame.T_world_wrist, expected)
    assert frame.world == "odom"
    assert frame.stamp == arrival.received  # a stamp of zero is none
    for mailbox in (from_glove, from_text):
        arrival = mailbox.take("left")
        assert np.allclose(arrival.frame.landmarks, glove[list(NODE_LAYOUTS[25][0])], atol=1e-6)
    arrival = from_text.take("right")
    assert arrival.frame.stamp == 3.5
    for source, _ in sources:
        source.stop()


def test_a_message_that_can_not_be_read_is_counted_and_the_next_is_read(peer, domain):
    source, mailbox = started(Ros2Source("/x", domain=domain, **LOCAL))
    here = {"domain": domain, "publish": "rt/x"}
    points = a_hand()
    bad = [
        here | {"type": "PoseArray", "values": {"poses": rows}}
        for rows in ([], points[:20].tolist())  # the first is "no hand"
    ]
    words = "message has 20 points; a hand has 21"
    publish_until(peer, lambda: words in source.health().detail, *bad)
    in_millimetres = {"type": "PoseArray", "values": {"poses": (1e3 * points).tolist()}}
    publish_until(peer, lambda: "0.001" in source.health().detail, here | in_millimetres)
    # 280 kB: longer than any hand, and dropped before a minute goes into reading it.
    peer.order(**here, type="PoseArray", values={"poses": np.zeros((5000, 3)).tolist()})
    good = {"type": "PoseArray", "values": {"poses": points.tolist()}}
    publish_until(peer, lambda: mailbox.received, here | good)
    assert source.health().state == "running"
    assert "5000" not in source.health().detail
    source.stop()


def test_bytes_of_another_type_are_refused_in_one_line(domain):
    class Reader:
        def take(self, most: int, condition: Any) -> list[Any]:
            return [ros.PoseArray.deserialize(b"\0\1\0\0\7")]

    (refusal,) = transport_module._take(Reader(), None, ros.PoseArray)
    assert isinstance(refusal, RecordingError)
    reader = HandPoseReader({"/x": "right"}, {}, "world", "mediapipe", {})
    with pytest.raises(RecordingError, match="another type than geometry_msgs/msg/PoseArray"):
        reader.read("/x", refusal, 1.0)


def test_a_wrist_that_is_old_or_unknown_is_not_valid():
    reader = HandPoseReader({"/x": "right"}, {"/w": "right"}, "wrist", "mediapipe", {})
    points = a_hand()
    array = ros.PoseArray(poses=[ros.Pose(ros.Point(*row)) for row in points.tolist()])

    def wrist(received: float, stamp: float = 0.0) -> HandFrame:
        message = replace(array, header=ros.Header(ros.time_of(round(stamp * 1e9))))
        (reading,) = reader.read("/x", message, received)
        return reading.frame

    def valid(frame: HandFrame) -> bool:
        return bool(np.isfinite(frame.T_world_wrist).all())

    assert not valid(wrist(9.0))
    reader.read("/w", ros.PoseStamped(ros.Header(ros.Time(50), "odom")), 10.0)
    assert valid(wrist(10.05))
    assert not valid(wrist(10.2))
    assert valid(wrist(99.0, stamp=50.05))  # by the stamps where both have one
    assert not valid(wrist(10.0, stamp=50.2))
    camera = HandPoseReader({"/x": "right"}, {}, "camera", "mediapipe", {})
    (reading,) = camera.read("/x", array, 1.0)
    assert reading.frame.T_world_wrist is None


def test_a_pose_alone_is_that_of_a_tracker():
    reader = HandPoseReader({"/t/left": "left"}, {}, "world", "mediapipe", {})
    pose = ros.Pose(ros.Point(1.0, 2.0, 3.0), ros.Quaternion(0.0, 0.0, 1.0, 0.0))
    (reading,) = reader.read("/t/left", ros.PoseStamped(ros.Header(ros.Time(50), "m"), pose), 1.0)
    frame = reading.frame
    assert (frame.side, frame.stamp, frame.world) == ("left", 50.0, "m")
    assert frame.T_world_wrist.tolist() == [1, 2, 3, 0, 0, 0, 1]
    assert not frame.valid.any()


def test_settings_of_the_source_that_contradict_each_other():
    for text, words in {
        "ros2:/p,side=both,message=pose": "put {side} into the topic",
        "ros2:/p,side=both": "put {side} into the topic",
        "ros2:/p,wrist=/w": "set both or neither",
        "ros2:/p,frame=wrist": "set both or neither",
        "ros2:/{side}/p,side=both,frame=wrist,wrist=/w": "two wrists",
        "ros2:/{hand}/p": "can't be a topic",
        "ros2:/p,right_glove=3,left_glove=3": "both '3'",
        "ros2:/p,domain=-1": "0 to 232",
        "ros2:/p,message=twist": "pose_array or json or manus_glove",
    }.items():
        with pytest.raises(ConfigError, match=words):
            build_source(text)
    assert build_source("ros2", "left").label == "ROS 2 /hand/{side}/poses"


def test_network_and_domain_come_from_the_setting_else_from_ros_variables(monkeypatch):
    names = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "CYCLONEDDS_URI")
    for name in (*names, "ROS_DOMAIN_ID"):
        monkeypatch.delenv(name, raising=False)
    end = Endpoint("the ros2 sink", SinkError)
    assert (reach_of(end), end.domain_id()) == ("localhost", 0)
    for value, reach in {"1": "localhost", "0": "subnet"}.items():
        monkeypatch.setenv("ROS_LOCALHOST_ONLY", value)
        assert reach_of(end) == reach
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert reach_of(end) == "localhost"
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    with pytest.raises(ConfigError, match="must be LOCALHOST or SUBNET, not 'OFF'"):
        reach_of(end)
    assert reach_of(replace(end, network="subnet")) == "subnet"
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///x.xml")
    assert reach_of(end) == "own"
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert end.domain_id() == 42
    assert replace(end, domain=3).domain_id() == 3
    for bad in ("-1", "233", "x"):
        monkeypatch.setenv("ROS_DOMAIN_ID", bad)
        with pytest.raises(ConfigError, match="ROS_DOMAIN_ID must be 0 to 232"):
            end.domain_id()


def test_one_domain_has_one_network_in_a_process(domain):
    end = Endpoint("the ros2 sink", SinkError, domain=domain, **LOCAL)
    first = Transport(end)
    with pytest.raises(ConfigError, match="already used in this process with network 'localhost'"):
        Transport(replace(end, network="subnet"))
    first.close()
