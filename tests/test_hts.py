"""The Quest app Hand Tracking Streamer: its lines, its sockets, what goes wrong with them."""

import socket
from typing import Any

import fuzzing
import headset_apps as app
import numpy as np
import pytest
from hypothesis import strategies as st
from live_time import PATIENCE_S, Kept, until

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError, SourceError
from smooth_operator.headsets import hts_lines
from smooth_operator.headsets.hts_lines import HtsHands, parse_line
from smooth_operator.io.anatomy import chirality
from smooth_operator.poses import separation
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.inboxes import TcpInbox, split_lines
from smooth_operator.teleop.sources.programs import HtsSource
from smooth_operator.types import HandFrame, Side

POSE = (0.4, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512)
RIGHT, LEFT = app.landmarks(app.hand("right")), app.landmarks(app.hand("left"))
HANDS: dict[Side, np.ndarray] = {"right": RIGHT, "left": LEFT}
# 25 cm to the right, 1 m up, 50 cm ahead, palm down
LEVEL = (0.5, -0.25, 1.0, 1.0, 0.0, 0.0, 0.0)


def fed(data: bytes, hands: HtsHands | None = None, received: float = 0.0) -> list[HandFrame]:
    hands = hands or HtsHands()
    found = [hands.add(parse_line(line), received) for line in data.split(b"\n")]
    return [frame for frame in found if frame is not None]


def check(frame: HandFrame, pose: app.Pose, points: np.ndarray) -> None:
    """The text has four digits of a metre, three of a quaternion."""
    np.testing.assert_allclose(frame.landmarks, points, atol=0.6e-4)
    assert frame.valid.all()
    assert (separation(frame.T_world_wrist, np.asarray(pose)) < [1e-4, 3e-3]).all()
    assert frame.world == "hts"
    sign = 1.0 if frame.side == "right" else -1.0
    assert sign * chirality(frame.landmarks[None])[0] > 0.25


def test_the_bytes_of_a_level_hand():
    points = np.zeros((21, 3))
    points[1], points[9] = (0.05, 0.03, -0.01), (0.09, 0.0, 0.0)
    data = app.hts_packet("right", LEVEL, points)
    wrist, rest = data.split(b"\n")
    assert wrist == b"Right wrist:, 0.2500, 1.0000, 0.5000, 0.000, -0.000, -0.000, 1.000"
    assert rest.startswith(b"Right landmarks:, -0.0000, 0.0000, 0.0000, -0.0300, -0.0100, 0.0500, ")
    (frame,) = fed(data)
    np.testing.assert_allclose(frame.T_world_wrist, LEVEL)
    np.testing.assert_allclose(frame.landmarks[1], points[1])
    # joints at 0 0 0 are those that the headset does not have
    assert frame.valid.tolist() == [k in (0, 1, 9) for k in range(21)]
    assert frame.stamp is None


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_left_handed_frame_keeps_the_side_and_the_wrist(side):
    data = app.hts_packet(side, POSE, HANDS[side])
    (frame,) = fed(data)
    assert frame.side == side
    check(frame, POSE, HANDS[side])


def test_an_independent_reader_finds_the_same_numbers():
    sdk = pytest.importorskip("hand_tracking_sdk", reason="hand-tracking-sdk is not installed")
    meta = " | f = 12 | t = 5312345678"
    for line in app.hts_packet("left", POSE, LEFT, meta).split(b"\n"):
        theirs, ours = sdk.parse_line(line.decode()), parse_line(line)
        assert theirs.side.value.lower() == ours.side
        assert theirs.kind.value == ours.kind
        values = list(theirs.data.to_dict().values())
        np.testing.assert_array_equal(np.ravel(values), ours.values)
        assert theirs.debug.source_frame_seq == ours.number == 12
        assert theirs.debug.source_ts_ns == 5312345678
        assert ours.stamp == 5.312345678


def test_the_wrist_belongs_to_its_own_landmarks():
    first, second = (" | f = 7 | t = 1000000000", " | f = 8 | t = 1014000000")
    hands = HtsHands()
    (frame,) = fed(app.hts_packet("right", POSE, RIGHT, first), hands)
    assert frame.stamp == 1.0
    check(frame, POSE, RIGHT)
    (lone,) = fed(app.hts_landmarks("right", RIGHT, second), hands)
    assert lone.stamp == 1.014
    assert np.isnan(lone.T_world_wrist).all()
    fed(app.hts_wrist("right", POSE, first), hands)
    (other,) = fed(app.hts_landmarks("right", RIGHT, second), hands)
    assert np.isnan(other.T_world_wrist).all()  # of another frame
    fed(app.hts_wrist("right", POSE), hands, 0.0)
    (late,) = fed(app.hts_landmarks("right", RIGHT), hands, 0.2)
    assert np.isnan(late.T_world_wrist).all()
    fed(app.hts_wrist("left", POSE), hands, 1.0)
    (of_the_other,) = fed(app.hts_landmarks("right", RIGHT), hands, 1.0)
    assert np.isnan(of_the_other.T_world_wrist).all()


def test_a_headset_in_another_language_writes_decimal_commas():
    data = app.hts_packet("right", POSE, RIGHT).replace(b".", b",")
    (frame,) = fed(data)
    check(frame, POSE, RIGHT)


def test_what_is_not_known_is_not_valid():
    wrist, points = app.hts_packet("right", POSE, RIGHT).split(b"\n")
    (frame,) = fed(b"Right wrist:, NaN, 0, 0, 0, 0, 0, 1\n" + points)
    assert np.isnan(frame.T_world_wrist).all()
    (frame,) = fed(b"Right wrist:, 0, 0, 0, 0, 0, 0, 0\n" + points)
    assert np.isnan(frame.T_world_wrist).all()
    words = points.split(b", ")
    words[1 + 3 * 8] = b"NaN"
    (frame,) = fed(wrist + b"\n" + b", ".join(words))
    assert frame.valid.tolist() == [k != 8 for k in range(21)]
    (frame,) = fed(b"Right landmarks:" + b", 0" * 63)
    assert not frame.valid.any()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"Right wrist:, 1, 2, 3", "7 numbers, not 3: the line is truncated"),
        (b"Right landmarks:, 1, 2", "63 numbers, not 2"),
        (b"Right wrist:, 1, 2, 3, x, 0, 0, 1", "one is 'x'"),
        (b"Right wrist:, 1_0, 2, 3, 0, 0, 0, 1", "one is '1_0'"),
        (b"Right elbow:, 1", "must begin with"),
        (b"Head wrist:, 1, 2, 3, 0, 0, 0, 1", "must begin with"),
        (b'{"landmarks": []}', "must begin with"),
        (b"\xff\xfe\x00", "must begin with"),
        (b"Right wrist:" + b", 1" * 3000, "too long"),
        (b"Right landmarks:" + b", 100" * 62 + b", 7", "metres"),
    ],
)
def test_a_damaged_line_says_what_is_wrong(line, words):
    with pytest.raises(RecordingError, match=words):
        HtsHands().add(parse_line(line), 0.0)


def test_no_line_is_a_crash():
    good = app.hts_packet("left", POSE, LEFT, " | f = 3 | t = 99").split(b"\n")
    hands, refused, taken = HtsHands(), [], []

    def read(mutants: tuple[bytes, ...]) -> None:
        for mutant in mutants:
            try:
                frame = hands.add(parse_line(mutant), (len(taken) + len(refused)) / 70)
            except SmoothOperatorError as error:
                refused.append(str(error))
            else:
                taken.append(frame)
                assert frame is None or np.isfinite(frame.landmarks[frame.valid]).all()

    lines = [fuzzing.damaged_bytes(line) for line in good]
    digits = [i for i, letter in enumerate(good[1]) if letter in b"0123456789"]
    one_digit = st.tuples(st.sampled_from(digits), st.sampled_from(b"0123456789")).map(
        lambda it: good[1][: it[0]] + bytes([it[1]]) + good[1][it[0] + 1 :]
    )
    wrist = st.just(good[0])
    mutants = st.tuples(*lines) | st.tuples(wrist, lines[1]) | st.tuples(wrist, one_digit)
    with np.errstate(all="ignore"):
        fuzzing.each(mutants, 300, read)
    assert len(refused) > 100
    assert len([frame for frame in taken if frame is not None]) > 10
    assert all(len(words) < 500 for words in refused)


def ports(source: HtsSource) -> list[tuple[str, int]]:
    found = [part.rpartition("://")[2] for part in source.endpoint.split(" and ")]
    return [(where.rpartition(":")[0], int(where.rpartition(":")[2])) for where in found]


def started(text: str) -> tuple[HtsSource, Kept]:
    source = build_source(text)
    mailbox = Kept()
    source.start(mailbox)
    return source, mailbox


def last(mailbox: Kept, side: Side) -> HandFrame:
    return [each.frame for each in mailbox.all if each.frame.side == side][-1]


def test_both_hands_over_udp():
    source, mailbox = started("hts:port=0,transport=udp")
    try:
        (where,) = ports(source)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.sendto(b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1", where)
            one.sendto(app.hts_packet("right", POSE, RIGHT), where)
            one.sendto(b"\n" + app.hts_landmarks("left", LEFT), where)  # as where the wrist is lost
            one.sendto(app.hts_packet("left", LEVEL, LEFT), where)
            one.sendto(b"Right wrist:, 1, 2", where)
            until(lambda: "could not be read" in source.health().detail)
        until(lambda: len(mailbox.all) == 3)
        check(last(mailbox, "right"), POSE, RIGHT)
        check(last(mailbox, "left"), LEVEL, LEFT)
        assert [a.stamp == a.received for a in mailbox.all] == [True] * 3
        assert "1 of 7 messages" in source.health().detail
        assert "7 numbers, not 2" in source.health().detail
    finally:
        source.stop()


def test_over_tcp_each_hand_has_a_connection_and_may_come_back():
    source, mailbox = started("hts:port=0,transport=tcp")
    try:
        (where,) = ports(source)
        right, left, head = (socket.create_connection(where, timeout=60) for _ in range(3))
        data = app.hts_packet("right", POSE, RIGHT) + b"\n"
        right.sendall(data[:40])  # a line in parts
        head.sendall(b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1\n")
        left.sendall(app.hts_packet("left", LEVEL, LEFT) + b"\n")
        until(lambda: mailbox.received_of["left"] == 1)
        right.sendall(data[40:])
        until(lambda: mailbox.received_of["right"] == 1)
        check(last(mailbox, "right"), POSE, RIGHT)
        check(last(mailbox, "left"), LEVEL, LEFT)
        # The headset sleeps: its connection stays, and a new one comes when it wakes.
        again = socket.create_connection(where, timeout=60)
        again.sendall(data * 2)
        until(lambda: mailbox.received_of["right"] == 3)
        assert [a.session for a in mailbox.all if a.frame.side == "right"] == [0, 1, 1]
        left.close()
        left = socket.create_connection(where, timeout=60)
        left.sendall(app.hts_packet("left", LEVEL, LEFT) + b"\n")
        until(lambda: mailbox.received_of["left"] == 2)
        for one in (right, left, head, again):
            one.close()
    finally:
        source.stop()


def test_connections_that_never_end_make_room():
    source, mailbox = started("hts:port=0,transport=tcp")
    try:
        (where,) = ports(source)
        idle = [socket.create_connection(where, timeout=60) for _ in range(12)]
        with socket.create_connection(where, timeout=60) as one:
            one.sendall(app.hts_packet("right", POSE, RIGHT) + b"\n")
            until(lambda: mailbox.received == 1)
            one.sendall(b"x" * 200_000)  # no line ends
            until(lambda: "too long" in source.health().detail)
        for each in idle:
            each.close()
    finally:
        source.stop()


def test_connections_that_say_nothing_do_not_push_a_headset_out():
    inbox = TcpInbox("127.0.0.1", 0, split_lines, hts_lines.begins_line, "hts")
    where = ("127.0.0.1", int(inbox.address.rpartition(":")[2]))
    heard: list[Any] = []

    def turn() -> None:
        heard.extend(inbox.receive(0.01))

    try:
        with socket.create_connection(where, timeout=PATIENCE_S) as headset:
            headset.sendall(b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1\n")
            until(lambda: turn() or len(heard) == 1)
            others = []
            for k in range(40):
                others.append(socket.create_connection(where, timeout=PATIENCE_S))
                if k % 2:
                    others[-1].sendall(b"Hea")  # no message is complete
                turn()
            headset.sendall(b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1\n")
            until(lambda: turn() or len(heard) == 2)
            until(lambda: turn() or len(inbox.sockets()) <= 9)
        for one in others:
            one.close()
    finally:
        inbox.close()


@pytest.mark.parametrize(
    "beginning",
    [b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"\x16\x03\x01\x02\x00", b"SSH-2.0-x\r\n"],
)
def test_what_comes_after_another_protocol_is_not_read(beginning):
    """A web page can send any text after its HTTP request."""
    inbox = TcpInbox("127.0.0.1", 0, split_lines, hts_lines.begins_line, "hts")
    heard: list[Any] = []
    try:
        where = ("127.0.0.1", int(inbox.address.rpartition(":")[2]))
        with socket.create_connection(where, timeout=PATIENCE_S) as page:
            page.sendall(beginning + app.hts_packet("right", POSE, RIGHT) + b"\n")
            until(lambda: heard.extend(inbox.receive(0.01)) or heard)
            assert len(inbox.sockets()) == 1  # it is closed
        for _ in range(3):
            heard.extend(inbox.receive(0.01))
    finally:
        inbox.close()
    (message,) = heard
    assert isinstance(message[0], RecordingError)


def test_a_second_headset_is_not_used_while_the_first_sends():
    source = HtsSource(port=0)
    inbox, read = source.connect(), source.reader()
    inbox.close()
    wrist, points = app.hts_packet("right", POSE, RIGHT).split(b"\n")

    def take(host: bytes, received: float) -> list[Any]:
        return [r for line in (wrist, points) for r in read((line, host), received)]

    with pytest.raises(RecordingError, match="must begin with"):  # and does not choose the sender
        read((b"x", b"192.168.1.7"), 0.0)
    assert len(take(b"192.168.1.5", 0.0)) == 1
    with pytest.raises(RecordingError, match=r"192\.168\.1\.7 also sends.*192\.168\.1\.5"):
        take(b"192.168.1.7", 0.5)
    assert len(take(b"192.168.1.5", 0.9)) == 1
    first = take(b"192.168.1.7", 2.0)  # the first has fallen silent
    assert first[0].session != take(b"192.168.1.5", 4.0)[0].session


def test_one_source_hears_both_protocols():
    source, mailbox = started("hts:port=0")
    try:
        udp, tcp = ports(source)
        assert source.health().detail.endswith("for Wi-Fi use hts:0.0.0.0")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.sendto(app.hts_packet("right", POSE, RIGHT), udp)
            until(lambda: mailbox.received == 1)
        with socket.create_connection(tcp, timeout=60) as one:
            one.sendall(app.hts_packet("left", POSE, LEFT) + b"\n")
            until(lambda: mailbox.received == 2)
    finally:
        source.stop()


def test_what_can_t_be_listened_on_is_said():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SourceError, match=f"TCP port {port}.*hts:port=PORT"):
            build_source(f"hts:port={port},transport=tcp").start(Kept())
    with pytest.raises(SourceError, match=r"UDP address 'no\.such\.host\.invalid'"):
        build_source("hts:no.such.host.invalid").start(Kept())
    with pytest.raises(ConfigError, match="port must be 0 to 65535"):
        build_source("hts:port=70000")
    with pytest.raises(ConfigError, match="both or udp or tcp"):
        build_source("hts:transport=http")
