"""The source ``rokoko``: datagrams of JSON v3, written from Rokoko's texts by this test."""

import itertools
import json
from typing import Any

import fuzzing
import numpy as np
import pytest
from live_time import until
from tracker_session import sender, started

from smooth_operator.errors import RecordingError
from smooth_operator.io.landmark_order import chirality
from smooth_operator.poses import rotate, wrist_from_landmarks
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandFrame, Side
from smooth_operator_devices.trackers.rokoko import RokokoStream, read_scene

lz4 = pytest.importorskip("lz4.frame", reason="the extra 'rokoko' is not installed")

FRAMES = [one.landmarks for one in itertools.islice(SyntheticOperator(seed=4).frames(), 5)]
AT = np.array([0.4, -0.2, 1.1])
"""Place of the hands in our world: ahead, to the right, up [m]."""
FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")
NAMES = [
    "Hand",
    *(f"{f}{part}" for f in FINGERS for part in ("Proximal", "Medial", "Distal", "Tip")),
]


def ours(side: Side, k: int = 0) -> np.ndarray:
    """(21, 3) landmarks of the k-th frame in our world; the left hand is the mirror image."""
    points = FRAMES[k] + AT
    return points if side == "right" else points * [1.0, -1.0, 1.0]


def joint(point: np.ndarray) -> dict[str, Any]:
    """A joint in Studio's axes: x to the right, y up, z forward, as Unity has them."""
    x, y, z = float(-point[1]), float(point[2]), float(point[0])
    return {"position": {"x": x, "y": y, "z": z}, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}


def actor(k: int = 0, name: str = "Ann", **meta: bool) -> dict[str, Any]:
    hands: tuple[Side, ...] = ("left", "right")
    body = {"hip": joint(np.array([0.0, 0.0, 1.0]))}
    for side in hands:
        body |= {f"{side}{n}": joint(p) for n, p in zip(NAMES, ours(side, k), strict=True)}
    return {
        "name": name,
        "color": [255, 0, 0],
        "meta": {"hasGloves": True, "hasLeftGlove": True, "hasRightGlove": True, **meta},
        "dimensions": {"totalHeight": 1.8, "hipHeight": 1.0},
        "body": body,
    }


def scene(*actors: dict[str, Any], stamp: Any = 12.5, **header: Any) -> dict[str, Any]:
    people = list(actors) or [actor()]
    body = {"timestamp": stamp, "actors": people, "props": []}
    return {"version": "3.0", "fps": 60, "scene": body, **header}


def packet(*actors: dict[str, Any], packed: bool = True, **options: Any) -> bytes:
    data = json.dumps(scene(*actors, **options)).encode()
    return lz4.compress(data) if packed else data


def hands(data: bytes, name: str = "") -> dict[str, HandFrame]:
    return {frame.side: frame for frame in read_scene(data, name)}


@pytest.mark.parametrize("packed", [True, False], ids=["lz4", "plain"])
def test_a_session_has_both_hands_with_wrists(packed):
    with started("rokoko:port=0") as (source, mailbox), sender(source) as send:
        assert "JSON v3" in source.health().detail
        for k in range(5):
            send(packet(actor(k), packed=packed, stamp=12.5 + k / 60))
            until(lambda k=k: mailbox.received == 2 * (k + 1))
        for number, arrival in enumerate(mailbox.all):
            frame, k = arrival.frame, number // 2
            points = ours(frame.side, k)
            np.testing.assert_allclose(frame.landmarks, points, atol=1e-9)
            wrist = wrist_from_landmarks(points, frame.side)
            np.testing.assert_allclose(frame.T_world_wrist, wrist, atol=1e-9)
            assert frame.world == "rokoko"
            assert arrival.stamp == pytest.approx(12.5 + k / 60)
            sign = 1.0 if frame.side == "right" else -1.0
            assert sign * chirality(frame.landmarks[None])[0] > 0.25
        assert {arrival.session for arrival in mailbox.all} == {0}
        assert source.health().state == "running"
        until(lambda: "no message at udp" in source.health().detail)
        assert source.health().state == "waiting"


def test_a_clip_that_loops_is_another_session():
    with started("rokoko:port=0,side=right") as (source, mailbox), sender(source) as send:
        for k, stamp in enumerate((30.0, 30.1, 0.0)):
            send(packet(actor(k), stamp=stamp))
            until(lambda k=k: mailbox.received == k + 1)
        assert [arrival.session for arrival in mailbox.all] == [0, 0, 1]


@pytest.mark.parametrize("suit", [True, False])
def test_the_forearm_is_that_of_a_suit(suit):
    """The elbow is 0.25 m behind the wrist along the palm, and 0.1 m above it."""
    person = actor(hasBody=suit)
    for side in ("left", "right"):
        wrist = wrist_from_landmarks(ours(side), side)
        elbow = wrist[:3] + rotate(wrist[3:], np.array([-0.25, 0.0, 0.1]))
        person["body"][f"{side}LowerArm"] = joint(elbow)
    expected = np.array([0.25, 0.0, -0.1]) / np.hypot(0.25, 0.1) if suit else np.full(3, np.nan)
    for hand in hands(packet(person)).values():
        np.testing.assert_allclose(hand.forearm, expected, atol=1e-6)


def test_a_glove_that_is_off_is_a_missing_hand():
    assert set(hands(packet(actor(hasLeftGlove=False)))) == {"right"}
    one = actor()
    for name in [name for name in one["body"] if name.startswith("right")]:
        del one["body"][name]
    assert set(hands(packet(one))) == {"left"}
    one["body"] = None
    assert hands(packet(one)) == {}


def test_a_frame_that_repeats_is_a_lost_hand():
    read = RokokoStream().reader()
    assert len(read((packet(), b"10.0.0.1"), 0.0)) == 2
    assert read((packet(stamp=12.6), b"10.0.0.1"), 0.1) == []


def test_an_unknown_joint_is_not_valid():
    one = actor()
    del one["body"]["rightIndexTip"]
    one["body"]["rightHand"]["position"]["x"] = None
    data = json.dumps(scene(one)).replace(str(-ours("left")[4][1]), "NaN")
    found = hands(data.encode())
    assert found["right"].valid.tolist() == [k not in (0, 8) for k in range(21)]
    assert np.isnan(found["right"].T_world_wrist).all()
    assert found["left"].valid.tolist() == [k != 4 for k in range(21)]


def test_an_actor_is_chosen_by_name():
    data = packet(actor(0, "Ann"), actor(1, "Bo"))
    np.testing.assert_allclose(hands(data)["right"].landmarks, ours("right", 0))
    np.testing.assert_allclose(hands(data, "Bo")["right"].landmarks, ours("right", 1))
    with pytest.raises(RecordingError, match="no actor 'Cy', but Ann, Bo"):
        hands(data, "Cy")


def test_a_scene_without_a_stamp_has_the_time_of_receipt():
    assert [frame.stamp for frame in read_scene(packet(stamp=None), "")] == [None, None]


def in_centimetres() -> bytes:
    one = actor()
    for part in one["body"].values():
        part["position"] = {axis: 100.0 * value for axis, value in part["position"].items()}
    return packet(one)


def with_joint(value: Any) -> bytes:
    one = actor()
    one["body"]["leftRingTip"] = value
    return packet(one)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        (packet()[:-20], "cut off"),
        (packet()[:40] + b"\xff" * 40 + packet()[80:], "damaged|cut off|not JSON"),
        (lz4.compress(b" " * 2_000_000), "longer than"),
        (b"Smartsuit", "not JSON"),
        (b"[]", "no 'version'"),
        (b'{"frame": 1}', "choose JSON v3"),
        (packet(version=2, scene=None), "version 2.* choose JSON v3"),
        (
            json.dumps({"version": 3, "timestamp": 1, "trackers": []}).encode(),
            "without the 'scene'",
        ),
        (packet(version="4.1"), r"version 4\.1"),
        (packet(scene=[]), "'scene' must be an object"),
        (packet(scene={"actors": 3}), "'actors' must be a list, not 3"),
        (packet(scene={"actors": []}), "has no actor"),
        (packet(scene={"actors": [1]}), "an actor must be an object"),
        (packet(stamp="now"), "timestamp"),
        (with_joint({"position": {"x": 1, "y": 2}}), "'leftRingTip' must have a 'position'"),
        (with_joint({"position": [1, 2, 3]}), "'leftRingTip'"),
        (with_joint(5), "'leftRingTip'"),
        (in_centimetres(), "centimetres"),
    ],
)
def test_a_damaged_message_says_what_is_wrong(data, words):
    with pytest.raises(RecordingError, match=words):
        read_scene(data, "")


def test_damaged_bytes_raise_only_errors_of_this_program():
    for mutants in (fuzzing.damaged_bytes(packet()), fuzzing.damaged_json(packet(packed=False))):
        refused, _ = fuzzing.outcomes(mutants, 50, lambda data: read_scene(data, ""))
        assert len(refused) > 10
