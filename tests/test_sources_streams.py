"""Messages of hands: what can be read, what can't, and sockets that come and go."""

import contextlib
import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fuzzing
import numpy as np
import pytest
from glove_simulator import write_manus
from hypothesis import strategies as st
from live_time import PATIENCE_S, Kept, until

from smooth_operator.errors import ConfigError, RecordingError, SourceError
from smooth_operator.landmarks import FROM_MANUS_25, METACARPALS_MANUS_25
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.sources.live import Running, ThreadedSource
from smooth_operator.teleop.sources.payload import MAX_BYTES, read_payload
from smooth_operator.teleop.sources.programs import ManusStream, UdpSource, ZmqSource, read_manus
from smooth_operator.types import HandFrame

zmq = pytest.importorskip("zmq")

HAND = next(SyntheticOperator(seed=2).frames())
POINTS = HAND.landmarks
NODES = np.zeros((25, 3))
NODES[list(FROM_MANUS_25)] = POINTS
NODES[list(METACARPALS_MANUS_25)] = HAND.metacarpals


def text(**message: Any) -> bytes:
    return json.dumps({"landmarks": POINTS.tolist(), **message}).encode()


def read(data: bytes, side: Any = "right") -> HandFrame:
    (reading,) = read_payload(data, side)
    return reading.frame


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
@pytest.mark.parametrize("points", [POINTS, NODES, np.vstack([[0.0, 0.0, 0.0], NODES])])
def test_numbers_of_three_trackers_are_the_same_hand(kind, points):
    frame = read(points.astype(kind).tobytes(), "left")
    np.testing.assert_allclose(frame.landmarks, POINTS, atol=1e-6)
    assert (frame.side, frame.stamp) == ("left", None)
    assert (frame.metacarpals is None) == (len(points) == 21)
    if frame.metacarpals is not None:
        np.testing.assert_allclose(frame.metacarpals, HAND.metacarpals, atol=1e-6)
    for first in b"{[":  # it may begin as JSON does
        data = bytes([first]) + points.astype(kind).tobytes()[1:]
        np.testing.assert_allclose(read(data).landmarks, POINTS, atol=1e-6)


def test_json_says_all_or_the_landmarks_alone():
    frame = read(
        text(
            stamp=12.5,
            side="Left",
            valid=[True] * 20 + [False],
            metacarpals=HAND.metacarpals.tolist(),
            orientations=(2.0 * HAND.orientations).tolist(),
        )
    )
    assert (frame.stamp, frame.side, frame.valid.tolist()) == (12.5, "left", [True] * 20 + [False])
    np.testing.assert_allclose(frame.metacarpals, HAND.metacarpals)
    np.testing.assert_allclose(frame.orientations, HAND.orientations, atol=1e-9)
    assert np.array_equal(read(json.dumps(POINTS.tolist()).encode()).landmarks, POINTS)
    assert np.array_equal(read(json.dumps(POINTS.ravel().tolist()).encode()).landmarks, POINTS)
    np.testing.assert_allclose(read(text(landmarks=NODES.tolist())).landmarks, POINTS)
    short = json.dumps(POINTS.round(3).tolist()).replace(" ", "").encode().ljust(504)
    assert len(short) == 504  # the size of 21 x 3 float64
    np.testing.assert_allclose(read(short).landmarks, POINTS, atol=1e-3)
    assert read(text(side="L"), None).side == "left"
    for data in (POINTS.astype("<f4").tobytes(), text()):
        with pytest.raises(RecordingError, match="does not contain a side"):
            read(data, None)  # where both hands are taken


def test_one_message_may_hold_both_hands():
    hands = [{"side": side, "landmarks": POINTS.tolist()} for side in ("right", "left")]
    data = json.dumps({"stamp": 3.0, "session": 9, "hands": hands}).encode()
    both = read_payload(data, None)
    assert [(r.frame.side, r.frame.stamp, r.session) for r in both] == [
        ("right", 3.0, "9"),
        ("left", 3.0, "9"),
    ]


def test_what_a_tracker_does_not_see_is_invalid_and_no_error():
    lost = POINTS.tolist()
    lost[8] = [None, None, None]
    assert read(text(landmarks=lost)).valid.tolist() == [k != 8 for k in range(21)]
    unseen = text(landmarks=[[float("nan")] * 3] * 21)
    assert not read(unseen).valid.any()
    assert not read(bytes(252)).valid.any()  # all zero: "no hand"
    wristless = POINTS.copy()
    wristless[0] = np.inf
    assert read(wristless.astype("<f4").tobytes()).valid.sum() == 20


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (b"x" * 253, "253 bytes is neither JSON"),
        (b"{" * (MAX_BYTES + 1), "too long"),
        (b"{not json}", "not JSON"),
        (b"[" * 60_000, "not JSON"),
        (b'{"landmarks": "\xff"}', "not JSON"),
        (b"{}", "neither 'landmarks' nor 'wrist'; it has nothing"),
        (b'{"points": 1}', "'points'"),
        (text(landmarks=5), "21 rows"),
        (text(landmarks=[[1, 2], [3]]), "rows of equal length"),
        (text(landmarks="hand"), "must be numbers"),
        (text(landmarks=[{}] * 21), "must be numbers"),
        (text(landmarks=POINTS[:20].tolist()), "20 points; a hand has 21"),
        (text(landmarks=[[10**400, 0, 0]] * 21), "a whole number has 401 digits"),
        (text(landmarks=(1e3 * POINTS).tolist()), "millimetres (multiply by 0.001)"),
        ((1e2 * POINTS).astype("<f4").tobytes(), "centimetres (multiply by 0.01)"),
        (text(side="top"), "side must be 'right' or 'left', not 'top'"),
        (text(stamp="now"), "finite number of seconds"),
        (text(stamp=float("nan")), "finite number of seconds"),
        (text(stamp=True), "finite number of seconds"),
        (text(stamp=10**400), "a whole number has 401 digits"),
        (text(stamp=[1]), "finite number of seconds"),
        (text(timestamp=1.7e12), "milliseconds (multiply by 0.001)"),
        (text(valid=[True]), "21 values that are true or false"),
        (text(valid=["yes"] * 21), "true or false"),
        (text(metacarpals=[[0, 0, 0]]), "'metacarpals' must have shape (4, 3)"),
        (text(hands=5), "list of objects"),
        (text(hands=[5]), "list of objects"),
    ],
)
def test_what_can_t_be_read_says_why(data, says):
    with pytest.raises(RecordingError) as caught:
        read_payload(data, "right")
    assert says in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize("tries", [50, pytest.param(300, marks=pytest.mark.weekly)])
def test_no_message_can_raise_anything_else(tries):
    objects = [dict(zip("xyz", point, strict=True)) for point in POINTS.tolist()]
    matrices = [[[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]] for x, y, z in POINTS]
    more = {"stamp": 4, "wrist": [0] * 7, "world": "w"}
    forms = [text(landmarks=form, **more) for form in (objects, matrices)]
    seeds = [text(stamp=1.0, valid=[True] * 21), glove_text(), csv(), ros_text(), *forms]
    mutants = [fuzzing.damaged_bytes(seed) for seed in seeds]
    mutants += [fuzzing.damaged_json(seed) for seed in forms]
    for reader in (
        lambda data: read_payload(data, "right"),
        lambda data: read_manus(data, gloves={}, side="right"),
    ):
        refused, found = fuzzing.outcomes(st.one_of(*mutants), tries, reader)
        assert len(refused) > tries // 3  # the other's messages, too
        for frame in (reading.frame for readings in found for reading in readings):
            assert np.isfinite(frame.landmarks[frame.valid]).all()


def node(i: int, *, key: str = "id") -> dict[str, Any]:
    return {key: i, "pos": NODES[i].tolist(), "quat": [2.0, 0.0, 0.0, 0.0]}


def glove_text(topic: str = "RIGHT ", **message: Any) -> bytes:
    whole = {"glove_id": 3064964832, "nodes": [node(i) for i in range(25)], **message}
    return topic.encode() + json.dumps({k: v for k, v in whole.items() if v is not ...}).encode()


def csv(glove: str = "bccdf6ef", hands: int = 1) -> bytes:
    rows = np.hstack([NODES, np.tile([0.0, 0.0, 0.0, 1.0], (25, 1))])
    fields = ",".join(f"{x:.6f}" for x in rows.ravel())
    return ",".join([f"{glove},{fields}", f"60f3738b,{fields}"][:hands]).encode()


def ros_text(**message: Any) -> bytes:
    def pose(i: int) -> dict[str, Any]:
        return {
            "position": dict(zip("xyz", NODES[i].tolist(), strict=True)),
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        }

    nodes = [{"node_id": i, "chain_type": "Index", "pose": pose(i)} for i in range(25)]
    return json.dumps({"glove_id": -5, "side": "Left", "raw_nodes": nodes, **message}).encode()


def read_glove(data: bytes, side: Any = None, **gloves: Any) -> list[HandFrame]:
    return [r.frame for r in read_manus(data, gloves=gloves, side=side)]


ROWS = [[*p, 1.0, 0.0, 0.0, 0.0] for p in NODES.tolist()]


@pytest.mark.parametrize(
    ("data", "hands"),
    [
        (glove_text(), ["right"]),
        (glove_text("LEFT "), ["left"]),
        (glove_text("/manus/left "), ["left"]),
        (glove_text("", side="LEFT"), ["left"]),
        (glove_text(side="UNKNOWN"), ["right"]),
        (glove_text(nodes=[node(i) for i in reversed(range(25))]), ["right"]),
        (glove_text(nodes=[node(i) for i in range(30 - 5)] + [{**node(0), "id": 99}]), ["right"]),
        (glove_text(nodes=ROWS), ["right"]),
        (glove_text(nodes=NODES.tolist()), ["right"]),
        (glove_text(nodes=..., data=[x for row in ROWS for x in row]), ["right"]),
        (ros_text(), ["left"]),
        (json.dumps([json.loads(ros_text(side=s)) for s in "RL"]).encode(), ["right", "left"]),
        (json.dumps({"hands": [json.loads(ros_text())]}).encode(), ["left"]),
        (
            json.dumps({"right": {"nodes": ROWS}, "left": {"nodes": ROWS}, "stamp": 1}).encode(),
            ["right", "left"],
        ),
        (csv(), ["right"]),
        (csv(hands=2), ["right", "left"]),
        (b",".join([b"0.1"] * 40), []),
    ],
)
def test_every_bridge_s_message_is_the_same_hand(data, hands):
    frames = read_glove(data, **{"bccdf6ef": "right", "60f3738b": "left"})
    assert [frame.side for frame in frames] == hands
    for frame in frames:
        np.testing.assert_allclose(frame.landmarks, POINTS, atol=1e-6)
        np.testing.assert_allclose(frame.metacarpals, HAND.metacarpals, atol=1e-6)
        assert frame.valid.all()
        if frame.orientations is not None:
            np.testing.assert_allclose(frame.orientations, np.tile([1.0, 0, 0, 0], (21, 1)))


def test_a_bridge_says_the_order_of_its_quaternions_and_its_time():
    rows = [[*p, 0.1, 0.2, 0.3, 0.927] for p in NODES.tolist()]
    (frame,) = read_glove(glove_text(nodes=rows, quaternion_order="xyzw"))
    np.testing.assert_allclose(frame.orientations[0], [0.927, 0.1, 0.2, 0.3], atol=1e-3)
    assert read_glove(glove_text(stamp=4.5))[0].stamp == 4.5
    assert read_glove(glove_text(timestamp=4.5))[0].stamp == 4.5
    # The SDK's own time is a packed date: better none than that.
    (reading,) = read_manus(glove_text(timestamp=10**17), gloves={}, side=None)
    assert reading.frame.stamp is None


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (glove_text("UNKNOWN "), "right_glove=3064964832 or left_glove=3064964832"),
        (csv(), "right_glove=bccdf6ef"),
        (glove_text(nodes=...), "no 'nodes'; it has glove_id"),
        (glove_text(nodes=[]), "a list of 25 nodes"),
        (glove_text(nodes=[node(i) for i in range(24)]), "are missing: [24]"),
        (glove_text(nodes=[node(i % 24) for i in range(25)]), "more than once"),
        (glove_text(nodes=[node(i, key="number") for i in range(25)]), "KeyError"),
        (glove_text(nodes=[{**node(i), "pos": [1, 2]} for i in range(25)]), "3 + 4 numbers"),
        (glove_text(nodes=ROWS[:24]), "25 rows"),
        (glove_text(nodes=(1e3 * NODES).tolist()), "millimetres (multiply by 0.001)"),
        (glove_text(stamp=1.7e12), "milliseconds"),
        (b"RIGHT {", "not JSON"),
        (b"a,b,c", "fields separated by commas; it has 3"),
        (b"RIGHT 5", "it has 1"),
        (b"RIGHT [5]", "list of objects"),
        (csv().replace(b",0.0", b",x"), "must be numbers"),
    ],
)
def test_a_bridge_s_message_that_can_t_be_read_says_why(data, says):
    with pytest.raises(RecordingError) as caught:
        read_glove(data)
    assert says in str(caught.value)


def test_what_is_written_is_read_again():
    landmarks = POINTS.copy()
    landmarks[5:9] = np.nan
    frame = HandFrame(landmarks, metacarpals=HAND.metacarpals, orientations=HAND.orientations)
    (again,) = read_glove(b'LEFT {"nodes":' + write_manus(frame) + b"}")
    np.testing.assert_allclose(again.landmarks, landmarks, atol=1e-6)
    np.testing.assert_allclose(again.metacarpals, HAND.metacarpals, atol=1e-6)
    np.testing.assert_allclose(again.orientations, HAND.orientations, atol=1e-5)
    assert again.valid.tolist() == [not 5 <= k < 9 for k in range(21)]


@contextlib.contextmanager
def running(source: ThreadedSource) -> Iterator[Kept]:
    mailbox = Kept()
    source.start(mailbox)
    try:
        yield mailbox
    finally:
        source.stop()
        assert source.health().state == "ended"


def test_datagrams_become_frames_and_bad_ones_are_counted():
    source = UdpSource(port=0)
    with running(source) as mailbox, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        port = int(source.endpoint.rpartition(":")[2])
        until(lambda: source.health().detail.startswith("listening"))
        messages = [
            POINTS.astype("<f4").tobytes(),
            text(stamp=5.0),
            b"\x80\x04nonsense",
            (1e3 * POINTS).astype("<f8").tobytes(),
            text(side="left"),
        ]
        for k, message in enumerate(messages):
            sender.sendto(message, ("127.0.0.1", port))
            if k < 2:
                until(lambda: len(mailbox.all) == k + 1)  # noqa: B023  (used at once)
                assert abs(mailbox.all[k].received - time.perf_counter()) < PATIENCE_S
        until(lambda: source.health().detail.startswith("2 of"))
        assert "millimetres" in source.health().detail
        assert source.health().state == "running"
        assert mailbox.all[1].frame.stamp == 5.0
        assert mailbox.all[0].frame.stamp == mailbox.all[0].received
        with pytest.raises(SourceError, match="another program"):
            UdpSource(port=port).start(Kept())
    with running(UdpSource(port=port)):  # it was given back
        pass


def test_of_a_flood_the_newest_is_looked_at():
    source = UdpSource(port=0)
    inbox = source.connect()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(50):
            sender.sendto(str(k).encode(), ("127.0.0.1", int(inbox.address.rpartition(":")[2])))
    assert inbox.receive(1.0)[-1][0] == b"49"
    assert inbox.receive(0.0) == []
    inbox.close()


def test_messages_that_come_together_have_stamps_in_their_order():
    running = Running(Kept(), "test")

    class Batch:
        address = "nowhere"

        def receive(self, timeout: float) -> list[tuple[bytes, ...]]:
            running.stopping.set()
            return [(POINTS.astype("<f4").tobytes(),)] * 4

        def close(self) -> None:
            pass

    source = UdpSource(port=0)
    object.__setattr__(source, "_inbox", Batch())
    source.run(running)
    stamps = [arrival.stamp for arrival in running.mailbox.all]
    assert len(stamps) == 4
    assert (np.diff(stamps) > 0).all()
    assert stamps[-1] <= running.mailbox.clock()


@pytest.mark.parametrize("settings", [{"port": -1}, {"port": 70_000}, {"side": "top"}])
def test_settings_of_udp_are_checked(settings):
    with pytest.raises(ConfigError):
        UdpSource(**settings)
    with pytest.raises(SourceError, match="host"):
        UdpSource(host="no such host.invalid").start(Kept())


class Publisher:
    """A publisher that a test can kill and start again at the same address."""

    def __init__(self, address: str = "tcp://127.0.0.1:*") -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        until(lambda: self._bound(address))  # one that was just given back may need a moment
        self.address = self._socket.getsockopt(zmq.LAST_ENDPOINT).decode()

    def _bound(self, address: str) -> bool:
        try:
            self._socket.bind(address)
        except zmq.ZMQError:
            return False
        return True

    def __enter__(self) -> "Publisher":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close(linger=0)
        self._context.term()

    def send(self, *parts: bytes) -> None:
        self._socket.send_multipart(parts)

    def send_until(self, condition: Any, *parts: bytes) -> None:
        def sent() -> Any:
            self.send(*parts)
            return condition()

        until(sent)


def test_a_publisher_may_come_late_and_come_back():
    with Publisher() as first:
        address = first.address
    source = ZmqSource(address)
    with running(source) as mailbox:
        assert source.health().state == "waiting"
        for session, stamp in enumerate((50.0, 3.0)):
            with Publisher(address) as publisher:
                publisher.send_until(
                    # What the one before has sent may still be coming in.
                    lambda: mailbox.all and mailbox.all[-1].frame.stamp == stamp,  # noqa: B023
                    text(stamp=stamp),
                )
            assert mailbox.all[-1].session == session
        until(lambda: "no message" in source.health().detail)
        assert source.health().state == "waiting"


def test_topics_may_be_a_part_or_a_word():
    with Publisher() as publisher:
        source = ZmqSource(publisher.address, topic="hand", side="left")
        with running(source) as mailbox:
            publisher.send(b"else", text())
            publisher.send_until(lambda: mailbox.all, b"hand", text(stamp=1.0, side="left"))
            publisher.send_until(
                lambda: mailbox.all[-1].frame.stamp == 2.0, b"hand " + text(stamp=2.0, side="left")
            )
            assert "could not be read" not in source.health().detail


def test_a_source_may_be_the_one_that_listens_and_pulls():
    source = ZmqSource("tcp://127.0.0.1:*", bind=True, pattern="pull")
    with running(source) as mailbox:
        with zmq.Context() as context, context.socket(zmq.PUSH) as pusher:
            pusher.setsockopt(zmq.LINGER, 0)
            pusher.connect(source.endpoint)
            pusher.send(POINTS.astype("<f4").tobytes())
            until(lambda: mailbox.all)
        with pytest.raises(SourceError, match="listen on"):
            ZmqSource(source.endpoint, bind=True).start(Kept())
    with pytest.raises(SourceError, match="looks like tcp"):
        ZmqSource("nowhere").start(Kept())


def test_pickled_python_objects_are_refused_not_opened():
    # What another program's send_pyobj([1, 2]) would send.
    pickled = bytes.fromhex("80049509000000000000005d94284b014b02652e")
    with Publisher() as publisher:
        source = ZmqSource(publisher.address)
        with running(source) as mailbox:
            publisher.send_until(lambda: "could not be read" in source.health().detail, pickled)
            assert mailbox.all == []


def test_the_simulated_glove_sends_both_hands_until_it_is_killed():
    program = Path(__file__).with_name("glove_simulator.py")
    command = [sys.executable, program, "--address", "tcp://127.0.0.1:*", "--side", "both"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as glove:
        source = ManusStream(glove.stdout.readline().split()[-1])
        try:
            with running(source) as mailbox:
                until(lambda: {a.frame.side for a in mailbox.all} == {"right", "left"})
                until(lambda: len(mailbox.all) > 20)
                assert {a.session for a in mailbox.all} == {0}
                # Rates on a machine with other things to do are not judged, order is.
                right = [a.frame.stamp for a in mailbox.all if a.frame.side == "right"]
                assert right == sorted(right)
                glove.kill()
                until(lambda: source.health().state == "waiting")
        finally:
            glove.kill()
