"""The source ``angles``: gloves that give joint angles by UDP, ZeroMQ and ROS 2."""

import json
import math
from typing import Any

import fuzzing
import numpy as np
import pytest
from live_time import until
from tracker_session import sender, started

from smooth_operator.errors import ConfigError, RecordingError, SourceError
from smooth_operator.io.landmark_order import chirality
from smooth_operator.landmarks import FINGERS, index
from smooth_operator.synthetic.hand_anatomy import draw_anatomy
from smooth_operator.teleop.components import build_source
from smooth_operator.types import HandFrame
from smooth_operator_devices.trackers.joint_angles import JointAngles

FIST = {
    **{f"{finger}_mcp": 70 for finger in FINGERS[1:]},
    **{f"{finger}_pip": 90 for finger in FINGERS[1:]},
    "thumb_cmc_flexion": 10,
    "thumb_ip": 30,
}


def message(angles: Any = FIST, **fields: Any) -> bytes:
    return json.dumps({"angles": angles, **fields}).encode()


def read(data: bytes, unit: Any = "deg", **settings: Any) -> list[HandFrame]:
    readings = JointAngles(unit, **settings).reader()((data, b"127.0.0.1"), 7.0)
    return [reading.frame for reading in readings]


def bend(frame: HandFrame, finger: str, joint: str) -> float:
    """Angle between the bones at a joint [deg]."""
    at = index(f"{finger}_{joint}")
    points = frame.landmarks
    before, after = points[at] - points[at - 1], points[at + 1] - points[at]
    return math.degrees(math.acos(before @ after / np.linalg.norm(before) / np.linalg.norm(after)))


def test_the_bones_bend_by_the_angles_of_the_message():
    (frame,) = read(message({"index_pip": 50, "index_dip": 20, "ring_pip": 60, "thumb_ip": 35}))
    assert bend(frame, "index", "pip") == pytest.approx(50.0)
    assert bend(frame, "index", "dip") == pytest.approx(20.0)
    assert bend(frame, "ring", "pip") == pytest.approx(60.0)
    assert bend(frame, "ring", "dip") == pytest.approx(40.0)  # 2/3 of the PIP
    assert bend(frame, "thumb", "ip") == pytest.approx(35.0)
    assert bend(frame, "middle", "pip") == pytest.approx(0.0, abs=1e-4)


def test_flexion_goes_to_the_palm_and_abduction_to_the_thumb():
    (flat,), (bent,) = read(message({"index_mcp": 0})), read(message({"index_mcp": 40}))
    (spread,) = read(message({"index_mcp_abduction": 15}))
    tip, knuckle = index("index_tip"), index("index_mcp")
    points = flat.landmarks
    up, side = points[index("middle_mcp")], points[index("index_mcp")] - points[index("pinky_mcp")]
    palm = np.cross(side, up)  # out of the palm of a right hand
    assert (bent.landmarks[tip] - points[tip]) @ palm > 0
    assert (spread.landmarks[tip] - points[tip]) @ side > 0
    np.testing.assert_allclose(bent.landmarks[knuckle], points[knuckle])


def test_size_is_the_length_of_the_hand():
    (frame,) = read(message({"index_mcp": 0}), size=0.17)
    bones = np.diff(frame.landmarks[9:13], axis=0)
    length = np.linalg.norm(frame.landmarks[9]) + np.linalg.norm(bones, axis=1).sum()
    assert length == pytest.approx(0.17)
    np.testing.assert_allclose(frame.metacarpals, draw_anatomy(0.17, 0).metacarpal_bases)


def test_degrees_and_radians_are_the_same_hand():
    radians = {name: math.radians(angle) for name, angle in FIST.items()}
    (one,), (other,) = read(message()), read(message(radians), "rad")
    np.testing.assert_allclose(one.landmarks, other.landmarks)


def test_both_hands_are_mirror_images():
    hands = [{"side": side, "angles": FIST} for side in ("right", "left")]
    data = json.dumps({"stamp": 3.5, "hands": hands}).encode()
    right, left = read(data, side="both")
    np.testing.assert_allclose(right.landmarks * [1.0, -1.0, 1.0], left.landmarks)
    assert chirality(right.landmarks[None])[0] > 0.25 > -0.25 > chirality(left.landmarks[None])[0]
    assert right.stamp == left.stamp == 3.5


def test_an_unknown_angle_hides_what_follows_it():
    for unknown in (None, float("nan")):
        (frame,) = read(message({**FIST, "index_pip": unknown}))
        assert frame.valid.tolist() == [k not in (7, 8) for k in range(21)]
        (frame,) = read(message({**FIST, "pinky_mcp": unknown}))
        assert frame.valid.tolist() == [k not in (18, 19, 20) for k in range(21)]


def test_a_session_by_udp():
    with started("angles:deg,port=0,side=both") as (source, mailbox), sender(source) as send:
        for k in range(4):
            side = ("right", "left")[k % 2]
            wrist = [0.1 * k, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
            send(message(side=side, stamp=10.0 + k, wrist=wrist, world="room", session=k // 2))
            until(lambda k=k: mailbox.received == k + 1)
        assert [arrival.stamp for arrival in mailbox.all] == [10.0, 11.0, 12.0, 13.0]
        assert [arrival.session for arrival in mailbox.all] == [0, 0, 1, 1]
        np.testing.assert_allclose(mailbox.all[1].frame.T_world_wrist[:3], [0.1, 0.0, 1.0])
        assert mailbox.all[0].frame.world == "room"
        send(message())
        until(lambda: "does not contain a side" in source.health().detail)
        until(lambda: "no message at udp" in source.health().detail)
        assert source.health().state == "waiting"


def test_a_session_by_zeromq():
    zmq = pytest.importorskip("zmq")
    context = zmq.Context()
    publisher = context.socket(zmq.PUB)
    port = publisher.bind_to_random_port("tcp://127.0.0.1")
    try:
        with started(f"angles:deg,address=tcp://127.0.0.1:{port}") as (_, mailbox):

            def heard() -> int:
                publisher.send(message())
                return mailbox.received

            until(heard)
            assert mailbox.all[0].frame.side == "right"
    finally:
        publisher.close(linger=0)
        context.term()


def test_a_session_by_ros_2(monkeypatch):
    pytest.importorskip("cyclonedds", reason="the extra 'ros2' is not installed")
    from smooth_operator_devices.ros2.messages import Header, JointState, Time
    from smooth_operator_devices.ros2.transport import Endpoint, Transport

    monkeypatch.setenv("ROS_DOMAIN_ID", "87")
    names, positions = list(FIST), [math.radians(angle) for angle in FIST.values()]

    def state(second: int) -> Any:
        header = Header(Time(second, 500_000_000), "")
        return JointState(header, names, positions, [], [])

    transport = Transport(Endpoint("the test", SourceError, None, None))
    publish = {side: transport.publisher(JointState, f"/g/{side}") for side in ("right", "left")}
    try:
        with started("angles:rad,topic=/g/{side},side=both") as (source, mailbox):

            def heard() -> bool:
                for side in ("right", "left"):
                    publish[side](state(12))
                return set(mailbox.received_of) == {"right", "left"}

            until(heard)
            for arrival in mailbox.all:
                (frame,) = read(message(), side=arrival.frame.side)
                np.testing.assert_allclose(arrival.frame.landmarks, frame.landmarks, atol=1e-9)
                assert arrival.stamp == 12.5
            names[0] = "index_knuckle"

            def refused() -> bool:
                publish["left"](state(13))
                return "unknown joint index_knuckle" in source.health().detail

            until(refused)
    finally:
        transport.close()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (b"12, 13", "not JSON"),
        (b"[1, 2]", "an object with 'angles'"),
        (b'{"hands": [1]}', "'hands', a list"),
        (b"{}", "'angles' must be an object of angles by name, not None"),
        (message({}), "'angles' must be an object"),
        (message([1.0] * 20), "'angles' must be an object"),
        (
            message({"index_knuckle": 3}),
            "unknown joint index_knuckle; the names are thumb_cmc_flexion",
        ),
        (message({"index_mcp": "3"}), "must be a number, not '3'"),
        (message({"index_mcp": True}), "must be a number, not True"),
        (message({"index_mcp": 400}), "'index_mcp' is 400 deg, more than a joint can turn"),
        (message(stamp="now"), "timestamp"),
        (message(side="up"), "side must be 'right' or 'left'"),
        (message(wrist=[1, 2]), "'wrist' must have shape"),
        (b"{" + b" " * 70_000, "too long"),
    ],
)
def test_a_damaged_message_says_what_is_wrong(data, words):
    with pytest.raises(RecordingError, match=words):
        read(data)


def test_degrees_that_are_declared_as_radians_are_refused():
    with pytest.raises(RecordingError, match=r"90 rad, .*: angles:deg or angles:rad"):
        read(message(), "rad")


def test_settings_are_checked():
    with pytest.raises(ConfigError, match="needs unit: write angles:UNIT"):
        build_source("angles")
    for settings, words in (
        ({"size": 1.9}, "size must be 0.12 to 0.25 m"),
        ({"address": "tcp://a:1", "topic": "/a"}, "not both"),
        ({"topic": "/glove", "side": "both"}, "two topics"),
    ):
        with pytest.raises(ConfigError, match=words):
            JointAngles("rad", **settings)


def test_damaged_bytes_raise_only_errors_of_this_program():
    refused, _ = fuzzing.outcomes(fuzzing.damaged_json(message(stamp=1.0, side="left")), 150, read)
    assert len(refused) > 20
