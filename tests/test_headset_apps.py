"""Apps of headsets: messages and connections of Quest (``hts``), PICO and Vision Pro (``avp``)."""

import contextlib
import json
import socket
import struct
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import fuzzing
import headset_apps as app
import numpy as np
import pytest
from hypothesis import strategies as st
from live_time import PATIENCE_S, Kept, until

from smooth_operator.errors import (
    ConfigError,
    RecordingError,
    SourceError,
)
from smooth_operator.headsets import hts_lines
from smooth_operator.headsets.avp import METHOD, read_hands
from smooth_operator.headsets.hts_lines import HtsHands, parse_line
from smooth_operator.headsets.pico_packets import read_packet, split_packets
from smooth_operator.io.landmark_order import chirality
from smooth_operator.poses import separation
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.inboxes import TcpInbox, split_lines
from smooth_operator.teleop.sources.programs import AvpSource, HtsSource, PicoSource
from smooth_operator.types import HandFrame, Side

POSE = (0.4, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512)
# 25 cm to the right, 1 m up, 50 cm ahead, palm down
LEVEL = (0.5, -0.25, 1.0, 1.0, 0.0, 0.0, 0.0)
POSES: dict[Side, app.Pose] = {"left": LEVEL, "right": POSE}
STAMP = 1_732_613_438_765_715_200
JOINTS: dict[Side, np.ndarray] = {side: app.hand(side) for side in POSES}
POINTS = {side: app.landmarks(joints) for side, joints in JOINTS.items()}
HEAD = b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1"
NO_HAND = (np.eye(4), np.stack([np.eye(4)] * 27))


def check(frame: HandFrame, world: str) -> None:
    """A frame is the hand of its side, as precisely as the app sends it."""
    side, pose = frame.side, np.asarray(POSES[frame.side])
    # the lines of hts have four digits of a metre, three of a quaternion
    tolerance = 0.6e-4 if world == "hts" else 1e-6
    expected, metacarpals = POINTS[side], JOINTS[side][[5, 10, 15, 20]]
    if world == "pico":  # its landmarks are in the world
        turn = app.turn(pose[3:]).T
        expected, metacarpals = expected @ turn + pose[:3], metacarpals @ turn + pose[:3]
    np.testing.assert_allclose(frame.landmarks, expected, atol=tolerance)
    if world != "hts":
        np.testing.assert_allclose(frame.metacarpals, metacarpals, atol=tolerance)
    if world == "pico":
        assert (np.abs(frame.orientations @ pose[3:]) > 1 - 1e-6).all()
    assert frame.valid.all()
    if frame.forearm is not None:  # the Vision Pro sees it
        np.testing.assert_allclose(frame.forearm, [1.0, 0.0, 0.0], atol=1e-6)
    limits = [1e-4, 3e-3] if world == "hts" else 2e-6
    assert (separation(frame.T_world_wrist, pose) < limits).all()
    assert frame.world == world
    sign = 1.0 if side == "right" else -1.0
    assert sign * chirality(frame.landmarks[None])[0] > 0.25


def hts(side: Side, meta: str = "") -> bytes:
    return app.hts_packet(side, POSES[side], POINTS[side], meta)


def pico(move: float = 0.0, stamp: int | None = STAMP, nested: bool = True, **hands: Any) -> bytes:
    return app.pico_tracking(pico_hands(move) | hands, stamp, nested)


def pico_hands(move: float = 0.0) -> dict[str, Any]:
    moved = (POSE[0] + move, *POSE[1:])
    return {
        "leftHand": app.pico_hand(LEVEL, JOINTS["left"]),
        "rightHand": app.pico_hand(moved, JOINTS["right"]),
    }


def avp(move: float = 0.0, forearm: bool = True) -> dict[Side, Any]:
    moved = {**POSES, "right": (POSE[0] + move, *POSE[1:])}
    return {
        side: (app.arkit_wrist(side, moved[side]), app.arkit_joints(side, JOINTS[side], forearm))
        for side in POSES
    }


UPDATE = app.avp_update(avp())


def fed(data: bytes, hands: HtsHands | None = None, received: float = 0.0) -> list[HandFrame]:
    hands = hands or HtsHands()
    frames = [hands.add(parse_line(line), received) for line in data.split(b"\n")]
    return [frame for frame in frames if frame is not None]


@pytest.mark.parametrize(
    ("name", "read"),
    {
        "hts": lambda: fed(hts("left") + b"\n" + hts("right")),
        "hts with decimal commas": lambda: fed(
            (hts("left") + b"\n" + hts("right")).replace(b".", b",")
        ),
        "pico": lambda: read_packet(pico()),
        "pico, object": lambda: read_packet(pico(nested=False)),
        "avp": lambda: read_hands(UPDATE),
        "avp of a later version": lambda: read_hands(
            UPDATE + b"\x20\x07\x29" + struct.pack("<d", 1.0)
        ),
        "avp without forearm": lambda: read_hands(app.avp_update(avp(forearm=False))),
    }.items(),
)
def test_both_hands_in_the_conventions_of_the_project(name, read):
    frames, world = read(), name.split()[0].strip(",")
    assert [frame.side for frame in frames] == ["left", "right"]
    stamps = {"hts": None, "pico": pytest.approx(STAMP / 1e9, abs=3e-7), "avp": None}
    for frame in frames:
        check(frame, world)
        assert frame.stamp == stamps[world]
        assert (frame.forearm is not None) == (name.startswith("avp") and "without" not in name)


def test_messages_without_hands_and_joints_that_the_headset_does_not_have():
    other = app.pico_packet(0x6D, b'{"functionName": "timeTest", "value": "1"}')
    for silent in (other, app.pico_packet(0x19, b"PA9410|-1"), app.pico_packet(0x6C, b"")):
        assert read_packet(silent) == ()
    points = np.zeros((21, 3))
    points[1], points[9] = (0.05, 0.03, -0.01), (0.09, 0.0, 0.0)
    (frame,) = fed(app.hts_packet("right", LEVEL, points))
    assert frame.valid.tolist() == [k in (0, 1, 9) for k in range(21)]  # the others are at 0 0 0


def test_an_independent_reader_of_hts_finds_the_same_numbers():
    sdk = pytest.importorskip("hand_tracking_sdk", reason="hand-tracking-sdk is not installed")
    for line in hts("left", " | f = 12 | t = 5312345678").split(b"\n"):
        theirs, ours = sdk.parse_line(line.decode()), parse_line(line)
        assert theirs.side.value.lower() == ours.side
        assert theirs.kind.value == ours.kind
        values = list(theirs.data.to_dict().values())
        np.testing.assert_array_equal(np.ravel(values), ours.values)
        assert theirs.debug.source_frame_seq == ours.number == 12
        assert theirs.debug.source_ts_ns == 5312345678
        assert ours.stamp == 5.312345678


def test_a_wrist_of_hts_belongs_to_its_own_landmarks():
    first, second = (" | f = 7 | t = 1000000000", " | f = 8 | t = 1014000000")
    (wrist, points), (wrist_1, _), (_, points_2) = (
        hts("right", meta).split(b"\n") for meta in ("", first, second)
    )
    hands = HtsHands()
    (frame,) = fed(hts("right", first), hands)
    assert frame.stamp == 1.0
    check(frame, "hts")
    for before, line, received, stamp in (
        (b"", points_2, 0.0, 1.014),  # there is no second wrist
        (wrist_1, points_2, 0.0, 1.014),  # of another frame
        (wrist, points, 0.2, None),  # too late
        (app.hts_wrist("left", POSE), points, 0.0, None),  # of the other hand
    ):
        if before:
            fed(before, hands, 0.0)
        (frame,) = fed(line, hands, received)
        assert frame.stamp == stamp
        assert np.isnan(frame.T_world_wrist).all()


def test_an_unknown_joint_or_wrist_is_not_valid():
    wrist, points = hts("right").split(b"\n")
    for lost in (b"NaN, 0, 0, 0, 0, 0, 1", b"0, 0, 0, 0, 0, 0, 0"):
        (frame,) = fed(b"Right wrist:, " + lost + b"\n" + points)
        assert np.isnan(frame.T_world_wrist).all()
    words = points.split(b", ")
    words[1 + 3 * 8] = b"NaN"
    (frame,) = fed(wrist + b"\n" + b", ".join(words))
    assert frame.valid.tolist() == [k != 8 for k in range(21)]
    (frame,) = fed(b"Right landmarks:" + b", 0" * 63)
    assert not frame.valid.any()

    hands = pico_hands()
    hands["leftHand"] = app.pico_hand(LEVEL, JOINTS["left"], active=0)
    locations = hands["rightHand"]["HandJointLocations"]
    locations[1 + 9]["s"] = 0  # the index tip
    locations[1]["s"] = 2  # a wrist without orientation
    (right,) = read_packet(pico(**hands))
    assert right.valid.tolist() == [k != 8 for k in range(21)]
    assert np.isnan(right.T_world_wrist).all()
    assert read_packet(app.pico_tracking({}, None)) == ()

    (right,) = read_hands(app.avp_update({**avp(), "left": NO_HAND}))
    assert right.side == "right"
    wrist, joints = avp()["right"]
    joints[9] = np.eye(4)  # an index tip that was never seen
    (frame,) = read_hands(app.avp_update({"right": (np.eye(4), joints)}))
    assert frame.valid.tolist() == [k != 8 for k in range(21)]
    assert np.isnan(frame.T_world_wrist).all()
    joints[9] = np.nan
    joints[10:15, :3, :3] *= 1.2  # no rotation
    (frame,) = read_hands(app.avp_update({"right": (wrist, joints)}))
    assert frame.valid.tolist() == [k not in (8, 9, 10, 11, 12) for k in range(21)]
    assert read_hands(b"") == read_hands(app.avp_update({})) == ()


def test_a_left_handed_pico_app_is_read_with_its_axes():
    hands = pico_hands()
    for joint in hands["rightHand"]["HandJointLocations"]:
        x, y, z = (float(word) for word in joint["p"].split(",")[:3])
        joint["p"] = ",".join(map(str, (x, y, -z, *app.unity_turn(POSE[3:]))))
    check(read_packet(pico(**hands), "unity")[1], "pico")
    mirrored = read_packet(pico(**hands))[1]
    assert chirality(mirrored.landmarks[None])[0] < -0.25  # the loop refuses it


def value(text: str) -> bytes:
    """A packet of PICO's app with this JSON."""
    body = json.dumps({"functionName": "Tracking", "value": text}).encode()
    return app.pico_packet(0x6D, body)


def with_joint(joint: Any) -> bytes:
    hands = pico_hands()
    hands["leftHand"]["HandJointLocations"][3] = joint
    return pico(**hands)


def in_millimetres() -> bytes:
    hands = avp()
    hands["right"][1][:, :3, 3] *= 1000.0
    return app.avp_update(hands)


BAD_JOINTS = [{}, {"p": "1,2,3"}, {"p": "a,b"}, {"p": 1}, {"p": "0", "s": []}, 7]


@pytest.mark.parametrize(
    ("read", "data", "words"),
    [
        (fed, b"Right wrist:, 1, 2, 3", "7 numbers, not 3: the line is truncated"),
        (fed, b"Right landmarks:, 1, 2", "63 numbers, not 2"),
        (fed, b"Right wrist:, 1, 2, 3, x, 0, 0, 1", "one is 'x'"),
        (fed, b"Right wrist:, 1_0, 2, 3, 0, 0, 0, 1", "one is '1_0'"),
        (fed, b"Right elbow:, 1", "must begin with"),
        (fed, b"Head wrist:, 1, 2, 3, 0, 0, 0, 1", "must begin with"),
        (fed, b"\xff\xfe\x00", "must begin with"),
        (fed, b"Right wrist:" + b", 1" * 3000, "too long"),
        (fed, b"Right landmarks:" + b", 100" * 62 + b", 7", "metres"),
        (read_packet, value("{"), "not JSON"),
        (read_packet, value("[1]"), "'value' must be an object"),
        (read_packet, value('{"Hand": 3}'), "'Hand' must be an object"),
        (read_packet, value('{"Hand": {"leftHand": {}}}'), "must have 26"),
        (read_packet, value('{"timeStampNs": 1e300}'), "nanoseconds"),
        *((read_packet, with_joint(joint), "a joint of 'leftHand'") for joint in BAD_JOINTS),
        (read_hands, UPDATE[:-3], "truncated"),
        (read_hands, b"\xff" * 40, "damaged"),
        (read_hands, b"\x0b", "not a HandUpdate"),
        (read_hands, b"x" * 70_000, "too long"),
        (read_hands, app.avp_update({"left": (np.eye(4), np.stack([np.eye(4)] * 65))}), "not 65"),
        (read_hands, in_millimetres(), "millimetres"),
    ],
)
def test_a_damaged_message_says_what_is_wrong(read, data, words):
    with pytest.raises(RecordingError, match=words):
        read(data)


def hts_mutants() -> st.SearchStrategy[bytes]:
    wrist, points = hts("left", " | f = 3 | t = 99").split(b"\n")
    digits = [i for i, letter in enumerate(points) if letter in b"0123456789"]
    one_digit = st.tuples(st.sampled_from(digits), st.sampled_from(b"0123456789")).map(
        lambda it: points[: it[0]] + bytes([it[1]]) + points[it[0] + 1 :]
    )
    intact, damaged = st.just(wrist), fuzzing.damaged_bytes(points)
    pairs = st.tuples(fuzzing.damaged_bytes(wrist) | intact, damaged | one_digit)
    return pairs.map(lambda pair: b"\n".join(line.replace(b"\n", b"") for line in pair))


def pico_mutants() -> st.SearchStrategy[bytes]:
    good = pico()
    values = fuzzing.damaged_json(good[6:-9]).map(lambda each: each[:60_000])
    return fuzzing.damaged_bytes(good) | values.map(lambda each: app.pico_packet(0x6D, each))


def pico_frames(data: bytes) -> list[HandFrame]:
    return [f for packet in split_packets(bytearray(data)) for f in read_packet(packet)]


@pytest.mark.parametrize(
    ("mutants", "read"),
    [
        (hts_mutants, fed),
        (pico_mutants, pico_frames),
        (lambda: fuzzing.damaged_bytes(UPDATE), read_hands),
    ],
    ids=["hts", "pico", "avp"],
)
def test_no_message_is_a_crash(mutants, read):
    refused, found = fuzzing.outcomes(mutants(), 100, lambda data: [*read(data)])
    frames = [frame for each in found for frame in each]
    assert len(refused) > 30
    assert len(frames) > 5
    assert all(np.isfinite(frame.landmarks[frame.valid]).all() for frame in frames)


@contextlib.contextmanager
def started(text: str) -> Iterator[tuple[Any, Kept, list[tuple[str, int]]]]:
    """A source, its mailbox, and the addresses at which it listens."""
    source, mailbox = build_source(text), Kept()
    source.start(mailbox)
    try:
        parts = [part.rpartition("://")[2] for part in source.endpoint.split(" and ")]
        yield source, mailbox, [(p.rpartition(":")[0], int(p.rpartition(":")[2])) for p in parts]
    finally:
        source.stop()


def dial(where: tuple[str, int]) -> socket.socket:
    return socket.create_connection(where, timeout=PATIENCE_S)


def rights(mailbox: Kept) -> list[Any]:
    return [arrival for arrival in mailbox.all if arrival.frame.side == "right"]


def test_hts_over_udp_and_over_tcp_at_once():
    with (
        started("hts:port=0") as (source, mailbox, (where, tcp)),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
    ):
        one.sendto(HEAD, where)
        one.sendto(hts("right"), where)
        one.sendto(b"\n" + app.hts_landmarks("left", POINTS["left"]), where)  # a lost wrist
        one.sendto(hts("left"), where)
        one.sendto(b"Right wrist:, 1, 2", where)
        until(lambda: "could not be read" in source.health().detail)
        until(lambda: len(mailbox.all) == 3)
        with dial(tcp) as other:
            other.sendall(hts("left") + b"\n" + b"x" * 200_000)  # a line that never ends
            until(lambda: len(mailbox.all) == 4)
            until(lambda: "too long" in source.health().detail)
        check(mailbox.all[0].frame, "hts")
        check(mailbox.all[2].frame, "hts")
        assert all(arrival.stamp == arrival.received for arrival in mailbox.all)


def test_over_tcp_each_hand_of_hts_has_a_connection_and_may_come_back():
    with started("hts:port=0,transport=tcp") as (_, mailbox, (where,)):
        right, left, head = (dial(where) for _ in range(3))
        data = hts("right") + b"\n"
        right.sendall(data[:40])  # a line in parts
        head.sendall(HEAD + b"\n")
        left.sendall(hts("left") + b"\n")
        until(lambda: mailbox.received_of["left"] == 1)
        right.sendall(data[40:])
        until(lambda: mailbox.received_of["right"] == 1)
        for arrival in mailbox.all:
            check(arrival.frame, "hts")
        # The headset sleeps: its connection stays, and a new one comes when it wakes.
        again = dial(where)
        again.sendall(data * 2)
        until(lambda: mailbox.received_of["right"] == 3)
        assert [arrival.session for arrival in rights(mailbox)] == [0, 1, 1]
        left.close()
        left = dial(where)
        left.sendall(hts("left") + b"\n")
        until(lambda: mailbox.received_of["left"] == 2)
        for one in (right, left, head, again):
            one.close()


def test_connections_that_say_nothing_do_not_push_a_headset_out():
    inbox = TcpInbox("127.0.0.1", 0, split_lines, hts_lines.begins_line, "hts")
    where = ("127.0.0.1", int(inbox.address.rpartition(":")[2]))
    messages: list[Any] = []

    def heard() -> int:
        messages.extend(inbox.receive(0.01))
        return len(messages)

    with contextlib.closing(inbox), dial(where) as headset:
        headset.sendall(HEAD + b"\n")
        until(lambda: heard() == 1)
        others = []
        for k in range(40):
            others.append(dial(where))
            if k % 2:
                others[-1].sendall(b"Hea")  # no message is complete
            heard()
        headset.sendall(HEAD + b"\n")
        until(lambda: heard() == 2)
        until(lambda: heard() and len(inbox.sockets()) <= 9)
        for one in others:
            one.close()


def test_a_second_headset_is_not_used_while_the_first_sends():
    source = HtsSource(port=0)
    source.connect().close()
    read = source.reader()

    def take(host: bytes, received: float) -> list[Any]:
        return [r for line in hts("right").split(b"\n") for r in read((line, host), received)]

    with pytest.raises(RecordingError, match="must begin with"):  # and does not choose the sender
        read((b"x", b"192.168.1.7"), 0.0)
    assert len(take(b"192.168.1.5", 0.0)) == 1
    with pytest.raises(RecordingError, match=r"192\.168\.1\.7 is also sending.*192\.168\.1\.5"):
        take(b"192.168.1.7", 0.5)
    assert len(take(b"192.168.1.5", 0.9)) == 1
    first = take(b"192.168.1.7", 2.0)  # the first has fallen silent
    assert first[0].session != take(b"192.168.1.5", 4.0)[0].session

    pico_source = PicoSource(port=0)
    pico_source.connect().close()
    read = pico_source.reader()
    with pytest.raises(RecordingError, match="0x3F"):
        read((b"x", b"192.168.1.7", b"1"), 0.0)
    assert len(read((pico(), b"192.168.1.5", b"2"), 0.1)) == 2


def test_pico_packets_are_taken_out_of_any_pieces():
    one, two = app.pico_packet(0x23, b"SN"), app.pico_tracking({}, STAMP)
    stream = one + two + one
    for size in (1, 50, len(stream)):
        buffer, packets = bytearray(), []
        for at in range(0, len(stream), size):
            buffer += stream[at : at + size]
            packets += split_packets(buffer)
        assert (packets, buffer) == ([one, two, one], b"")


def test_a_pico_headset_connects_repeats_itself_and_comes_back():
    with started("pico:port=0") as (source, mailbox, (where,)):
        assert source.health().detail.endswith("use pico:0.0.0.0")
        with dial(where) as headset:
            headset.sendall(app.pico_packet(0x19, b"SN|-1") + app.pico_packet(0x6C, b"SN|1.0|1"))
            headset.sendall(pico())
            # the left hand is lost: its last values are sent again
            headset.sendall(pico(0.001, STAMP + 14_000_000))
            until(lambda: mailbox.received_of["right"] == 2)
        assert mailbox.received_of["left"] == 1
        with dial(where) as headset:  # it slept
            headset.sendall(pico(0.002, STAMP + 5 * 10**9))
            until(lambda: mailbox.received_of["right"] == 3)
        assert [arrival.session for arrival in rights(mailbox)] == [0, 0, 1]
        stamps = [round(arrival.stamp - STAMP / 1e9, 3) for arrival in rights(mailbox)]
        assert stamps == [0.0, 0.014, 5.0]
        check(rights(mailbox)[0].frame, "pico")
        with dial(where) as headset:
            headset.sendall(pico(0.003, stamp=None))
            until(lambda: mailbox.received_of["right"] == 4)
        assert rights(mailbox)[3].stamp == rights(mailbox)[3].received


class Headset:
    """A gRPC server with the app's method; ``messages`` are sent in turn, then it waits."""

    def __init__(self, port: int = 0, method: str = METHOD) -> None:
        import grpc

        self.messages: list[bytes] = []
        self.more = threading.Condition()
        self.requests: list[bytes] = []
        self.ended = False
        service, _, name = method.strip("/").partition("/")
        handler = grpc.unary_stream_rpc_method_handler(self._stream)
        self._server = grpc.server(
            ThreadPoolExecutor(2), options=[("grpc.so_reuseport", 0)], compression=None
        )
        self._server.add_generic_rpc_handlers(
            (grpc.method_handlers_generic_handler(service, {name: handler}),)
        )
        self.port = self._server.add_insecure_port(f"127.0.0.1:{port}")
        self._server.start()

    def send(self, *messages: bytes) -> None:
        with self.more:
            self.messages += messages
            self.more.notify_all()

    def stop(self) -> None:
        with self.more:
            self.ended = True
            self.more.notify_all()
        self._server.stop(0).wait()

    def _stream(self, request: bytes, context: Any) -> Iterator[bytes]:
        self.requests.append(request)
        sent = 0
        while not self.ended and context.is_active():
            with self.more:
                if len(self.messages) == sent:
                    self.more.wait(0.1)
                new, sent = self.messages[sent:], len(self.messages)
            yield from new


@contextlib.contextmanager
def connected(port: int) -> Iterator[tuple[AvpSource, Kept]]:
    source, mailbox = build_source(f"avp:127.0.0.1,port={port}"), Kept()
    source.start(mailbox)
    try:
        yield source, mailbox
    finally:
        source.stop()


def test_a_stream_of_tracking_streamer_repeats_itself_ends_and_comes_back():
    pytest.importorskip("grpc", reason="grpcio (the extra avp) is not installed")
    headset = Headset()
    with connected(headset.port) as (source, mailbox):
        first, second, third = avp(), avp(0.001), avp(0.001)
        second["left"] = third["left"] = first["left"]  # lost: its last values are sent again
        third["right"][1][9, 0, 3] += 0.001  # the index tip moves; the wrist is lost
        headset.send(*map(app.avp_update, (first, second, third)), b"\x0b")
        until(lambda: "could not be read" in source.health().detail)
        assert mailbox.received_of == {"left": 1, "right": 3}
        assert mailbox.all[3].frame.valid.all()
        assert np.isnan(mailbox.all[3].frame.T_world_wrist).all()
        check(mailbox.all[0].frame, "avp")
        check(mailbox.all[1].frame, "avp")
        assert mailbox.all[0].stamp == mailbox.all[0].received
        assert headset.requests == [b""]
        headset.stop()  # the headset sleeps
        until(lambda: source.health().state == "waiting")
        until(lambda: "check that the app is running" in source.health().detail)
        again = Headset(headset.port)
        again.send(app.avp_update(avp(0.002)))
        until(lambda: mailbox.received_of["right"] == 4)
        assert [arrival.session for arrival in rights(mailbox)] == [0, 0, 0, 1]
        again.stop()


def test_another_program_than_the_app_is_named():
    pytest.importorskip("grpc", reason="grpcio (the extra avp) is not installed")
    other = Headset(method="/other.Service/Method")
    with connected(other.port) as (source, _):
        until(lambda: "without hand tracking" in source.health().detail)
    other.stop()


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("hts:no.such.host.invalid", SourceError, r"UDP address 'no\.such\.host\.invalid'"),
        ("hts:port=70000", ConfigError, "port must be 0 to 65535"),
        ("hts:transport=http", ConfigError, "both or udp or tcp"),
        ("pico:port=-1", ConfigError, "port must be"),
        ("pico:axes=arkit", ConfigError, "openxr or unity"),
        ("avp", ConfigError, "needs address: write avp:ADDRESS"),
        ("avp: ", ConfigError, "which the app shows"),
        ("avp:10.0.0.2,port=0", ConfigError, "port must be"),
    ],
)
def test_a_wrong_setting_is_refused(text, error, words):
    with pytest.raises(error, match=words):
        build_source(text).start(Kept())


def test_a_taken_port_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for text in (f"hts:port={port},transport=tcp", f"pico:port={port}"):
            with pytest.raises(SourceError, match=f"TCP port {port}.*{text[:3]}.*:port=PORT"):
                build_source(text).start(Kept())
