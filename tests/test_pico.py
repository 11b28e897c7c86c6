"""The PICO app XRoboToolkit: its packets, its connection, what goes wrong with them."""

import json
import socket
from typing import Any

import fuzzing
import headset_apps as app
import numpy as np
import pytest
from live_time import Kept, until

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError, SourceError
from smooth_operator.headsets.pico_packets import read_packet, split_packets
from smooth_operator.io.anatomy import chirality
from smooth_operator.poses import separation
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.programs import PicoSource
from smooth_operator.types import HandFrame, Side

POSE = (0.4, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512)
LEVEL = (0.5, 0.25, 1.0, 1.0, 0.0, 0.0, 0.0)
STAMP = 1_732_613_438_765_715_200
JOINTS: dict[Side, np.ndarray] = {"right": app.hand("right"), "left": app.hand("left")}


def both(stamp: int | None = STAMP, move: float = 0.0) -> dict[str, Any]:
    moved = (POSE[0] + move, *POSE[1:])
    hands = {
        "leftHand": app.pico_hand(LEVEL, JOINTS["left"]),
        "rightHand": app.pico_hand(moved, JOINTS["right"]),
    }
    return {"hands": hands, "stamp_ns": stamp}


def check(frame: HandFrame, pose: app.Pose, joints: np.ndarray) -> None:
    world = joints @ app.turn(pose[3:]).T + np.asarray(pose[:3])
    np.testing.assert_allclose(frame.landmarks, app.landmarks(world), atol=1e-6)
    np.testing.assert_allclose(frame.metacarpals, world[[5, 10, 15, 20]], atol=1e-6)
    assert (separation(frame.T_world_wrist, np.asarray(pose)) < 1e-6).all()
    assert (np.abs(frame.orientations @ np.asarray(pose[3:])) > 1 - 1e-6).all()
    assert frame.world == "pico"
    sign = 1.0 if frame.side == "right" else -1.0
    assert sign * chirality(frame.landmarks[None])[0] > 0.25


def test_the_bytes_of_a_packet():
    data = app.pico_packet(0x19, b"PA9410|-1", 1)
    assert data == b"\x3f\x19\x09\x00\x00\x00PA9410|-1\x01\x00\x00\x00\x00\x00\x00\x00\xa5"
    assert read_packet(data).frames == ()
    for command in (0x6C, 0x23):
        assert read_packet(app.pico_packet(command, b"")).frames == ()
    other = app.pico_packet(0x6D, b'{"functionName": "timeTest", "value": "1"}')
    assert read_packet(other).frames == ()


@pytest.mark.parametrize("nested", [True, False])
def test_both_hands_of_a_packet(nested):
    said = both()
    found = read_packet(app.pico_tracking(said["hands"], STAMP, nested))
    assert [frame.side for frame in found.frames] == ["left", "right"]
    assert found.stamp == pytest.approx(STAMP / 1e9, abs=3e-7)
    left, right = found.frames
    check(left, LEVEL, JOINTS["left"])
    check(right, POSE, JOINTS["right"])


def test_what_the_headset_does_not_see_is_not_valid():
    hands = both()["hands"]
    hands["leftHand"] = app.pico_hand(LEVEL, JOINTS["left"], active=0)
    locations = hands["rightHand"]["HandJointLocations"]
    locations[1 + 9]["s"] = 0  # the index tip
    locations[1]["s"] = 2  # a wrist without orientation
    (right,) = read_packet(app.pico_tracking(hands, STAMP)).frames
    assert right.valid.tolist() == [k != 8 for k in range(21)]
    assert np.isnan(right.T_world_wrist).all()
    del hands["rightHand"]
    assert read_packet(app.pico_tracking(hands, STAMP)).frames == ()
    assert read_packet(app.pico_tracking({}, None)).frames == ()


def test_a_left_handed_app_is_read_with_its_axes():
    hands = both()["hands"]
    for joint in hands["rightHand"]["HandJointLocations"]:
        x, y, z = (float(word) for word in joint["p"].split(",")[:3])
        q = app.unity_turn(POSE[3:])
        joint["p"] = ",".join(map(str, (x, y, -z, *q)))
    data = app.pico_tracking(hands, STAMP)
    check(read_packet(data, "unity").frames[1], POSE, JOINTS["right"])
    assert chirality(read_packet(data).frames[1].landmarks[None])[0] < -0.25  # the loop refuses it


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("{", "not JSON"),
        ("[1]", "'value' must be an object"),
        ('{"Hand": 3}', "'Hand' must be an object"),
        ('{"Hand": {"leftHand": {}}}', "must have 26"),
        ('{"Hand": {"leftHand": {"HandJointLocations": [1, 2]}}}', "must have 26.*not 2"),
        ('{"timeStampNs": "x"}', "nanoseconds"),
        ('{"timeStampNs": 1e300}', "nanoseconds"),
    ],
)
def test_what_can_t_be_read_says_why(value, words):
    body = json.dumps({"functionName": "Tracking", "value": value}).encode()
    with pytest.raises(RecordingError, match=words):
        read_packet(app.pico_packet(0x6D, body))


@pytest.mark.parametrize(
    "joint", [{}, {"p": "1,2,3"}, {"p": "a,b"}, {"p": 1}, {"p": "0", "s": []}, 7]
)
def test_a_joint_that_is_none_is_refused(joint):
    hands = both()["hands"]
    hands["leftHand"]["HandJointLocations"][3] = joint
    with pytest.raises(RecordingError, match="a joint of 'leftHand'"):
        read_packet(app.pico_tracking(hands, STAMP))


def test_packets_are_taken_out_of_any_pieces():
    one, two = app.pico_packet(0x23, b"SN"), app.pico_tracking({}, STAMP)
    stream = one + two + one
    for size in (1, 7, 50, len(stream)):
        buffer, found = bytearray(), []
        for at in range(0, len(stream), size):
            buffer += stream[at : at + size]
            found += split_packets(buffer)
        assert found == [one, two, one]
        assert not buffer


def test_no_packet_is_a_crash():
    good = app.pico_tracking(both()["hands"], STAMP)
    values = fuzzing.damaged_json(good[6:-9]).map(lambda value: value[:60_000])
    mutants = fuzzing.damaged_bytes(good) | values.map(lambda each: app.pico_packet(0x6D, each))
    refused, taken = [], []

    def read(mutant: bytes) -> None:
        for data in split_packets(bytearray(mutant)):
            try:
                frames = read_packet(data).frames
            except SmoothOperatorError as error:
                refused.append(str(error))
            else:
                taken.extend(frames)
                assert all(np.isfinite(one.landmarks[one.valid]).all() for one in frames)

    with np.errstate(all="ignore"):
        fuzzing.each(mutants, 250, read)
    assert len(refused) > 50
    assert len(taken) > 10
    assert all(len(words) < 500 for words in refused)


def started(text: str) -> tuple[PicoSource, Kept, tuple[str, int]]:
    source = build_source(text)
    mailbox = Kept()
    source.start(mailbox)
    host, _, port = source.endpoint.removeprefix("tcp://").rpartition(":")
    return source, mailbox, (host, int(port))


def test_a_headset_connects_repeats_itself_and_comes_back():
    source, mailbox, where = started("pico:port=0")
    try:
        assert source.health().detail.endswith("use pico:0.0.0.0")
        first, second = both(), both(STAMP + 14_000_000, move=0.001)
        with socket.create_connection(where, timeout=60) as headset:
            headset.sendall(app.pico_packet(0x19, b"SN|-1") + app.pico_packet(0x6C, b"SN|1.0|1"))
            headset.sendall(app.pico_tracking(first["hands"], STAMP))
            # the left hand is lost: what was known of it is sent again
            headset.sendall(app.pico_tracking(second["hands"], STAMP + 14_000_000))
            until(lambda: mailbox.received_of["right"] == 2)
        assert mailbox.received_of["left"] == 1
        with socket.create_connection(where, timeout=60) as headset:  # it slept
            third = both(move=0.002)
            headset.sendall(app.pico_tracking(third["hands"], STAMP + 5 * 10**9))
            until(lambda: mailbox.received_of["right"] == 3)
        rights = [a for a in mailbox.all if a.frame.side == "right"]
        assert [a.session for a in rights] == [0, 0, 1]
        assert [round(a.stamp - STAMP / 1e9, 3) for a in rights] == [0.0, 0.014, 5.0]
        check(rights[0].frame, POSE, JOINTS["right"])
    finally:
        source.stop()


def test_a_frame_without_a_stamp_is_of_the_time_of_receipt():
    source, mailbox, where = started("pico:port=0,side=right")
    try:
        with socket.create_connection(where, timeout=60) as headset:
            headset.sendall(app.pico_tracking(both()["hands"], None))
            until(lambda: mailbox.received == 1)  # the right hand alone
        assert mailbox.all[0].stamp == mailbox.all[0].received
        assert source.health().state == "running"
    finally:
        source.stop()


def test_what_is_no_packet_does_not_choose_the_sender():
    source = PicoSource(port=0)
    source.connect().close()
    read = source.reader()
    data = app.pico_tracking(both()["hands"], STAMP)
    with pytest.raises(RecordingError, match="0x3F"):
        read((b"x", b"192.168.1.7", b"1"), 0.0)
    assert len(read((data, b"192.168.1.5", b"2"), 0.1)) == 2


def test_what_can_t_be_listened_on_is_said():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SourceError, match=f"TCP port {port}.*pico:port=PORT"):
            build_source(f"pico:port={port}").start(Kept())
    with pytest.raises(ConfigError, match="port must be"):
        build_source("pico:port=-1")
    with pytest.raises(ConfigError, match="openxr or unity"):
        build_source("pico:axes=arkit")
