"""The source ``bvh``: datagrams of Axis Studio and hc_mocap, by an encoder of the test."""

import struct
from pathlib import Path

import capture_files as capture
import fuzzing
import numpy as np
import pytest
from live_time import until
from tracker_session import sender, started

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.io.landmark_order import chirality
from smooth_operator.poses import wrist_from_landmarks
from smooth_operator.types import Side
from smooth_operator_devices.trackers.bvh_stream import BvhStream

FRAMES = 6
TREE = capture.in_file_order(capture.arms())
TURNS = capture.angles(TREE, FRAMES)
MOVED = np.array([0.0, 84.1, 0.0]) + np.outer(np.arange(FRAMES), [1.0, 0.2, -0.5])
OURS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
WITH = capture.numbers(TREE, TURNS, "YXZ", MOVED, displaced=True)
WITHOUT = capture.numbers(TREE, TURNS, "YXZ", MOVED, displaced=False)


def expected(side: Side) -> np.ndarray:
    """(T, 21, 3) landmarks [m] in our axes."""
    where = capture.places(TREE, TURNS, "YXZ", MOVED)
    return capture.landmarks(where, side) @ OURS.T / 100.0


def binary(
    values: np.ndarray, *, version: bytes = b"\0\0\1\1", reference: bool = False, person: int = 0
) -> bytes:
    """A datagram of Axis Studio, field by field as the struct of Noitom's plug-in."""
    if reference:
        values = np.concatenate([[9.0, 8.0, 7.0, 6.0, 5.0, 4.0], values])
    data = struct.pack("<H", 0xDDFF) + version + struct.pack("<H", len(values))
    data += bytes([1, reference]) + struct.pack("<I", person) + b"Avatar_0".ljust(32, b"\0")
    data += struct.pack("<IIII", 42, 0, 0, 0) + struct.pack("<H", 0xEEFF)
    assert len(data) == 64
    return data + b"".join(struct.pack("<f", value) for value in values)


def text(values: np.ndarray, prefix: str = "0 Avatar_0 ", suffix: str = " ||") -> bytes:
    return (prefix + " ".join(f"{value:.5f}" for value in values) + suffix).encode()


@pytest.fixture
def skeleton(tmp_path: Path) -> Path:
    """A file of the same skeleton with positions of all joints, as Axis Studio exports it."""
    path = tmp_path / "take.bvh"
    path.write_text(capture.bvh(TREE, WITH[:1], displaced=True))
    return path


@pytest.mark.parametrize(
    "packet",
    [
        lambda k: binary(WITH[k]),
        lambda k: binary(WITHOUT[k]),
        lambda k: binary(WITH[k], reference=True),
        lambda k: text(WITHOUT[k]),
        lambda k: text(WITH[k]) + text(WITH[k] + 5.0, "1 Avatar_1 "),
        lambda k: text(WITHOUT[k], "", ""),
    ],
    ids=["binary", "binary, angles", "binary, reference", "text", "two persons", "numbers"],
)
def test_both_hands_of_every_form_of_frame(skeleton, packet):
    with started(f"bvh:{skeleton},port=0") as (source, mailbox), sender(source) as send:
        for k in range(FRAMES):
            send(packet(k))
            until(lambda k=k: mailbox.received == 2 * (k + 1))
        assert source.health().state == "running"
        for k, arrival in enumerate(mailbox.all):
            side = arrival.frame.side
            points = expected(side)[k // 2]
            np.testing.assert_allclose(arrival.frame.landmarks, points, atol=3e-6)
            wrist = wrist_from_landmarks(points, side)
            np.testing.assert_allclose(arrival.frame.T_world_wrist, wrist, atol=1e-4)
            assert arrival.frame.world == "bvh"
            assert arrival.stamp == arrival.received
            sign = 1.0 if side == "right" else -1.0
            assert sign * chirality(arrival.frame.landmarks[None])[0] > 0.1


def test_only_the_chosen_person_and_hand_are_used(skeleton):
    text_of_source = f"bvh:{skeleton},port=0,person=1,side=left"
    with started(text_of_source) as (source, mailbox), sender(source) as send:
        send(binary(WITH[0]))
        send(binary(WITH[1], person=1))
        until(lambda: mailbox.received == 1)
        np.testing.assert_allclose(mailbox.all[0].frame.landmarks, expected("left")[1], atol=3e-6)


def test_a_frame_that_repeats_is_a_lost_hand(skeleton):
    source = BvhStream(skeleton)
    read = source.reader()
    host = b"127.0.0.1"
    assert len(read((binary(WITH[0]), host), 0.0)) == 2
    assert read((binary(WITH[0]), host), 0.1) == []
    moved = WITH[0].copy()
    moved[-1] += 1.0  # a finger of the left hand
    assert [r.frame.side for r in read((binary(moved), host), 0.2)] == ["left"]


def test_a_number_that_is_not_finite_is_a_landmark_not_seen(skeleton):
    values = WITH[0].copy()
    values[-1] = np.nan  # the rotation of the left little finger's last joint
    readings = BvhStream(skeleton, side="left").reader()((binary(values), b"::1"), 0.0)
    assert readings[0].frame.valid.tolist() == [True] * 20 + [False]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (binary(WITH[0])[:50], "header of 64 bytes, not 50"),
        (binary(WITH[0])[:-4], "must have .* bytes"),
        (binary(WITH[0], version=b"\0\0\0\2"), "version 2.0.0.0 .* not known"),
        (binary(WITH[0]).replace(b"\xff\xee", b"\xff\xef", 1), "must end with 0xEEFF"),
        (binary(WITH[0][:60]), "60 numbers, but take.bvh needs"),
        (text(WITHOUT[0][:-1]), "export the skeleton again"),
        (b"0 Avatar_0 1.0 x ||", "must be numbers"),
        (b"GET / HTTP/1.1\r\n", "must be numbers"),
        (b"", "empty"),
        (b"1 " * 40_000, "too long"),
        (binary(10.0 * WITH[0]), "metres"),
    ],
)
def test_a_damaged_frame_says_what_is_wrong(skeleton, data, words):
    with pytest.raises(RecordingError, match=words):
        BvhStream(skeleton).reader()((data, b"127.0.0.1"), 0.0)


def test_a_damaged_frame_does_not_end_the_source(skeleton):
    with started(f"bvh:{skeleton},port=0") as (source, mailbox), sender(source) as send:
        assert "switch on BVH broadcasting" in source.health().detail
        send(b"nonsense")
        send(binary(WITH[0]))
        until(lambda: mailbox.received == 2)
        until(lambda: "1 of 2 messages could not be read" in source.health().detail)
        until(lambda: "no message at udp" in source.health().detail)
        assert source.health().state == "waiting"


def test_settings_are_checked(skeleton, tmp_path):
    tree = capture.in_file_order(capture.arms(["left"]))
    path = tmp_path / "left.bvh"
    frames = capture.numbers(tree, capture.angles(tree, 1), "YXZ", MOVED[:1], False)
    path.write_text(capture.bvh(tree, frames))
    assert BvhStream(path).sides == ("left",)
    with pytest.raises(ConfigError, match="has only a left hand"):
        BvhStream(path, side="right")
    with pytest.raises(ConfigError, match="port must be"):
        BvhStream(path, port=70_000)
    with pytest.raises(RecordingError, match=r"no\.bvh: can't be opened"):
        BvhStream(tmp_path / "no.bvh")
    path.write_text(capture.bvh(TREE, WITHOUT[:1]).replace("Thumb", "Toe"))
    with pytest.raises(RecordingError, match="no hand with fingers"):
        BvhStream(path)


def test_damaged_bytes_raise_only_errors_of_this_program(skeleton):
    read = BvhStream(skeleton).reader()
    for good in (binary(WITH[0]), text(WITHOUT[0])):
        mutants = fuzzing.damaged_bytes(good)
        refused, _ = fuzzing.outcomes(mutants, 50, lambda data: read((data, b"127.0.0.1"), 0.0))
        assert len(refused) > 10
