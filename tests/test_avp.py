"""The Vision Pro app Tracking Streamer: its messages, its stream, what goes wrong with them."""

import contextlib
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import fuzzing
import headset_apps as app
import numpy as np
import pytest
from live_time import Kept, until

from smooth_operator.errors import (
    ConfigError,
    MissingExtraError,
    RecordingError,
    SmoothOperatorError,
)
from smooth_operator.headsets.avp import METHOD, read_hands
from smooth_operator.io.anatomy import chirality
from smooth_operator.poses import separation
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.programs import AvpSource
from smooth_operator.types import HandFrame, Side

POSE = (0.4, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512)
LEVEL = (0.5, 0.25, 1.0, 1.0, 0.0, 0.0, 0.0)
JOINTS: dict[Side, np.ndarray] = {"right": app.hand("right"), "left": app.hand("left")}
NEVER = (np.eye(4), np.stack([np.eye(4)] * 27))


def both(move: float = 0.0, forearm: bool = True) -> dict[Side, Any]:
    pose = (POSE[0] + move, *POSE[1:])
    return {
        "left": (app.arkit_wrist("left", LEVEL), app.arkit_joints("left", JOINTS["left"], forearm)),
        "right": (
            app.arkit_wrist("right", pose),
            app.arkit_joints("right", JOINTS["right"], forearm),
        ),
    }


def check(frame: HandFrame, pose: app.Pose) -> None:
    joints = JOINTS[frame.side]
    np.testing.assert_allclose(frame.landmarks, app.landmarks(joints), atol=1e-7)
    np.testing.assert_allclose(frame.metacarpals, joints[[5, 10, 15, 20]], atol=1e-7)
    assert (separation(frame.T_world_wrist, np.asarray(pose)) < 2e-6).all()
    assert frame.world == "avp"
    sign = 1.0 if frame.side == "right" else -1.0
    assert sign * chirality(frame.landmarks[None])[0] > 0.25


def test_the_bytes_of_a_matrix():
    matrix = app.transform(np.eye(3), np.array([0.5, 0.0, -2.0]))
    assert app.avp_matrix(matrix) == (
        b"\x0d\x00\x00\x80\x3f"
        b"\x25\x00\x00\x00\x3f"  # m00 = 1, m03 = 0.5
        b"\x35\x00\x00\x80\x3f"  # m11 = 1
        b"\x5d\x00\x00\x80\x3f"
        b"\x65\x00\x00\x00\xc0"  # m22 = 1, m23 = -2
        b"\x85\x01\x00\x00\x80\x3f"  # m33 = 1
    )


@pytest.mark.parametrize("forearm", [False, True])
def test_both_hands_of_a_message(forearm):
    left, right = read_hands(app.avp_update(both(forearm=forearm)), 3.0)
    assert (left.side, right.side, left.stamp) == ("left", "right", 3.0)
    check(left, LEVEL)
    check(right, POSE)


def test_what_the_headset_has_not_seen_is_no_hand():
    hands = both()
    hands["left"] = NEVER
    (right,) = read_hands(app.avp_update(hands))
    assert right.side == "right"
    wrist, joints = hands["right"]
    joints = joints.copy()
    joints[9] = np.eye(4)  # an index tip that was never seen
    (frame,) = read_hands(app.avp_update({"right": (np.eye(4), joints)}))
    assert frame.valid.tolist() == [k != 8 for k in range(21)]
    assert np.isnan(frame.T_world_wrist).all()
    joints[9] = np.nan
    joints[10:15, :3, :3] *= 1.2  # no rotation
    (frame,) = read_hands(app.avp_update({"right": (wrist, joints)}))
    assert frame.valid.tolist() == [k not in (8, 9, 10, 11, 12) for k in range(21)]
    assert read_hands(b"") == ()
    assert read_hands(app.avp_update({})) == ()


def test_messages_that_are_none_are_refused():
    good = app.avp_update(both())
    for data, words in (
        (good[:-3], "truncated"),
        (good[:500], "truncated"),
        (b"\xff" * 40, "damaged"),
        (b"\x0b", "not a HandUpdate"),
        (b"\x00\x00", "not a HandUpdate"),
        (b"x" * 70_000, "too long"),
        (app.avp_update({"left": (np.eye(4), np.stack([np.eye(4)] * 24))}), "25 or 27 joints"),
        (app.avp_update({"left": (np.eye(4), np.stack([np.eye(4)] * 65))}), "not 65"),
    ):
        with pytest.raises(RecordingError, match=words):
            read_hands(data)
    millimetres = both()
    millimetres["right"][1][:, :3, 3] *= 1000.0
    with pytest.raises(RecordingError, match="millimetres"):
        read_hands(app.avp_update(millimetres))
    # fields of a later version are skipped
    assert len(read_hands(good + b"\x20\x07" + b"\x29" + struct.pack("<d", 1.0))) == 2


def test_no_message_is_a_crash():
    refused, taken = [], []

    def read(mutant: bytes) -> None:
        try:
            frames = read_hands(mutant)
        except SmoothOperatorError as error:
            refused.append(str(error))
        else:
            taken.extend(frames)
            assert all(np.isfinite(one.landmarks[one.valid]).all() for one in frames)

    with np.errstate(all="ignore"):
        fuzzing.each(fuzzing.damaged_bytes(app.avp_update(both())), 250, read)
    assert len(refused) > 50
    assert len(taken) > 10
    assert all(len(words) < 500 for words in refused)


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
def started(port: int) -> Iterator[tuple[AvpSource, Kept]]:
    source = build_source(f"avp:127.0.0.1,port={port}")
    mailbox = Kept()
    source.start(mailbox)
    try:
        yield source, mailbox
    finally:
        source.stop()


def test_a_stream_of_both_hands_repeats_itself_ends_and_comes_back():
    pytest.importorskip("grpc", reason="grpcio (the extra avp) is not installed")
    headset = Headset()
    with started(headset.port) as (source, mailbox):
        first, second = both(), both(0.001)
        second["left"] = first["left"]  # lost: what was known of it is sent again
        third = both(0.001)
        third["left"] = first["left"]
        third["right"][1][9, 0, 3] += 0.001  # the index tip moves; the wrist is lost
        headset.send(*map(app.avp_update, (first, second, third)), b"\x0b")
        until(lambda: "could not be read" in source.health().detail)
        assert mailbox.received_of == {"left": 1, "right": 3}
        assert mailbox.all[3].frame.valid.all()
        assert np.isnan(mailbox.all[3].frame.T_world_wrist).all()
        check(mailbox.all[0].frame, LEVEL)
        check(mailbox.all[1].frame, POSE)
        assert mailbox.all[0].stamp == mailbox.all[0].received
        assert headset.requests == [b""]
        headset.stop()  # the headset sleeps
        until(lambda: source.health().state == "waiting")
        again = Headset(headset.port)
        again.send(app.avp_update(both(0.002)))
        until(lambda: mailbox.received_of["right"] == 4, 20.0)
        assert [a.session for a in mailbox.all if a.frame.side == "right"] == [0, 0, 0, 1]
        again.stop()


def test_a_headset_that_is_not_there_is_said_and_waited_for():
    pytest.importorskip("grpc", reason="grpcio (the extra avp) is not installed")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with started(port) as (source, _):
        until(lambda: "check that the app is running" in source.health().detail)
        assert source.health().state == "waiting"
    other = Headset(method="/other.Service/Method")
    with started(other.port) as (source, _):
        until(lambda: "another program" in source.health().detail)
    other.stop()


def test_what_is_missing_is_said(monkeypatch):
    with pytest.raises(ConfigError, match="needs address: write avp:ADDRESS"):
        build_source("avp")
    with pytest.raises(ConfigError, match="which the app shows"):
        AvpSource(" ")
    with pytest.raises(ConfigError, match="port must be"):
        AvpSource("10.0.0.2", 0)
    monkeypatch.setitem(sys.modules, "grpc", None)
    with pytest.raises(MissingExtraError, match="avp"):
        AvpSource("10.0.0.2").start(Kept())
