"""What all live sources share, and those that need no socket: replay and the built-in operator."""

import threading
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from live_time import PATIENCE_S, Waits, started, until

from smooth_operator.errors import ConfigError, RecordingError, SourceError, UnknownNameError
from smooth_operator.plugins import Entry, Registry
from smooth_operator.retargeting.known_gaps import MEDIAPIPE
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator.teleop.components import build_component, build_source
from smooth_operator.teleop.sources.live import (
    Arrival,
    Mailbox,
    Running,
    ThreadedSource,
    on_time,
    source_gaps,
)
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.played import Replay, SyntheticSource
from smooth_operator.teleop.sources.stream import MessageReceiver
from smooth_operator.types import HandFrame, Side


def frame(stamp: float = 0.0, side: Side = "right") -> HandFrame:
    return HandFrame(np.zeros((21, 3)), stamp, side)


def test_a_mailbox_gives_the_newest_frame_of_each_hand_once():
    mailbox = Mailbox(lambda: 7.0)
    for stamp in (1.0, 2.0, 3.0):
        mailbox.post(frame(stamp))
    mailbox.post(frame(9.0, "left"), received=6.5, session=2)
    right, left = mailbox.take("right"), mailbox.take("left")
    assert (right.frame.stamp, right.received, right.session) == (3.0, 7.0, 0)
    assert (left.frame.stamp, left.received, left.session) == (9.0, 6.5, 2)
    assert mailbox.take("right") is None
    assert (mailbox.received, mailbox.overwritten) == (4, 2)


def test_a_mailbox_waits_for_its_hands_until_it_is_woken():
    mailbox = Mailbox()
    mailbox.post(frame(side="left"))
    assert not mailbox.wait(("right",), 0.01)
    assert mailbox.wait(("right", "left"), 0.0)
    later = threading.Timer(0.05, mailbox.post, [frame()])
    later.start()
    assert mailbox.wait(("right",), PATIENCE_S)
    later.join()
    mailbox.take("right")
    waker = threading.Timer(0.02, mailbox.wake)
    waker.start()
    assert not mailbox.wait(("right",), PATIENCE_S)
    waker.join()
    mailbox.wake()
    assert not mailbox.wait(("right",), PATIENCE_S)
    assert not mailbox.wait(("right",), 0.01)  # one call ends one wait


def test_a_mailbox_loses_count_of_nothing_among_threads():
    mailbox, taken = Mailbox(), 0
    threads = [
        threading.Thread(target=lambda: [mailbox.post(frame()) for _ in range(200)])
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) or mailbox.wait(("right",), 0.0):
        taken += mailbox.take("right") is not None
    assert mailbox.received == 800
    assert taken + mailbox.overwritten == 800


@dataclass(frozen=True)
class Told(ThreadedSource):
    """A source that fails as it is told."""

    error: Exception | None = None

    @property
    def label(self) -> str:
        return "told"

    def run(self, running: Running) -> None:
        if self.error is not None:
            raise self.error
        running.stopping.wait(PATIENCE_S)


@pytest.mark.parametrize(
    ("error", "detail"),
    [(SourceError("the cable is out"), "the cable is out"), (KeyError("x"), "KeyError: 'x'")],
)
def test_what_a_source_raises_is_its_health(error, detail):
    source = Told(error)
    source.start(Mailbox())
    until(lambda: source.health().state == "failed")
    assert source.health().detail == detail
    source = Told()  # which can be stopped at any time
    assert source.health().state == "waiting"
    source.stop()
    source.start(Mailbox())
    source.stop()
    source.stop()
    assert source.health().state == "ended"


@dataclass(frozen=True)
class Part:
    where: Path
    speed: float = 1.0
    loop: bool = False
    many: int | None = None
    side: Literal["right", "left"] = "right"


PARTS = Registry(
    "source", {"part": Entry(f"{__name__}:Part", "a part"), "other": Entry(f"{__name__}:Told", "-")}
)


def test_a_word_with_settings_makes_its_part():
    made = build_component(PARTS, "part:in/a=b.npz,speed=2,loop=yes,many=none,side=left")
    assert made == Part(Path("in/a=b.npz"), 2.0, True, None, "left")
    assert build_component(PARTS, "part:where=x,many=3") == Part(Path("x"), many=3)
    assert "part" in PARTS.describe()
    assert build_source("replay:glove.npz,speed=2") == Replay(Path("glove.npz"), speed=2.0)
    assert build_source("synthetic:3,side=both") == SyntheticSource(seed=3, side="both")


def test_a_class_of_ones_own_is_named_by_its_module():
    own = f"{__name__}:Part"
    assert build_component(PARTS, f"{own}:in/a=b.npz,speed=2") == Part(Path("in/a=b.npz"), 2.0)
    assert build_component(PARTS, f"{own},where=x,many=3") == Part(Path("x"), many=3)
    assert build_component(PARTS, "part:pathlib.py") == Part(Path("pathlib.py"))
    assert PARTS.split("part:a:b") == ("part", "a:b")
    parts = PARTS.split("my.lab:Sink:tcp://127.0.0.1:5,x=1")
    assert parts == ("my.lab:Sink", "tcp://127.0.0.1:5,x=1")
    with pytest.raises(ConfigError, match="can't be a source: it lacks label, start, stop, health"):
        build_source(f"{own}:x")


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        (f"{__name__}:Prat", ConfigError, "has no 'Prat'"),
        (f"{__name__}:frame", ConfigError, "it must be a dataclass"),
        (__name__, UnknownNameError, "unknown source"),
        ("no.such.module:Part", ConfigError, "there is no module 'no'"),
        ("relay:glove.npz", UnknownNameError, "other, part"),
        ("prat:x", UnknownNameError, "Did you mean 'part'?"),
        ("", UnknownNameError, "other, part"),
        ("part", ConfigError, "write part:WHERE"),
        ("part:x,sped=2", UnknownNameError, "Did you mean 'speed'?"),
        ("part:x,2", UnknownNameError, "'2'"),
        ("part:x,where=y", ConfigError, "'where' twice"),
        ("part:x,speed=fast", ConfigError, "speed must be a number up to 1e+09, not 'fast'"),
        ("part:x,loop=perhaps", ConfigError, "true or false"),
        ("part:x,many=1.5", ConfigError, "a whole number"),
        ("part:x,side=both", ConfigError, "right or left"),
    ],
)
def test_a_bad_word_says_what_is_wrong(text, error, says):
    with pytest.raises(error) as caught:
        build_component(PARTS, text)
    assert says in str(caught.value)


def test_late_items_come_at_once_and_in_order_and_time_starts_with_the_first():
    waits, seen = Waits(), []
    for _, k in on_time(((k * 0.01, k) for k in range(6)), waits.clock, waits):
        seen.append((k, round(waits.now, 6)))
        if k == 1:
            waits.now += 0.025
    assert seen == [(0, 0.0), (1, 0.01), (2, 0.035), (3, 0.035), (4, 0.04), (5, 0.05)]

    waits = Waits()

    def slow() -> object:
        waits.now += 3.0
        yield 0.0, "a"
        yield 0.5, "b"

    times = [(late, waits.now) for late, _ in on_time(slow(), waits.clock, waits)]
    assert times == [(0.0, 3.0), (0.0, 3.5)]


@pytest.fixture
def glove(tmp_path: Path) -> Path:
    recording = SyntheticOperator(side="left", rate_hz=50.0).record(0.4)
    path = tmp_path / "glove.npz"
    np.savez(
        path,
        landmarks=recording.landmarks,
        timestamps=recording.stamps + 1000.0,
        side=recording.side,
    )
    return path


def played(source: Replay, waits: Waits) -> list[Arrival]:
    """Everything that a source posts in a time of its own."""
    source.open()
    running, mailbox = started(waits)
    source.run(running)
    assert running.health.state == "running"
    return mailbox.all


def test_a_replay_posts_each_frame_at_its_time(glove):
    arrivals = played(Replay(glove, speed=2.0), Waits(overshoot=1e-3))
    assert [a.frame.stamp for a in arrivals] == pytest.approx(1000.0 + np.arange(20) / 50.0)
    assert {(a.frame.side, a.session) for a in arrivals} == {("left", 0)}
    received = np.array([a.received for a in arrivals])
    np.testing.assert_allclose(received[1:], np.arange(1, 20) / 100.0 + 1e-3, atol=1e-6)


def test_rounds_of_a_replay_are_sessions_whose_stamps_go_on(glove, tmp_path):
    arrivals = played(Replay(glove, loop=True), Waits(until=1.0))
    np.testing.assert_allclose(np.diff([a.frame.stamp for a in arrivals]), 0.02, atol=1e-6)
    assert [a.session for a in arrivals] == [k // 20 for k in range(len(arrivals))]
    assert np.array_equal(arrivals[0].frame.landmarks, arrivals[20].frame.landmarks)
    np.save(tmp_path / "pose.npy", SyntheticOperator().record(0.1).landmarks[0])
    single = played(Replay(tmp_path / "pose.npy", loop=True), Waits(until=0.1))
    assert len(single) == 11


def test_a_replay_that_can_t_be_read_says_so_at_the_start(tmp_path):
    plain = tmp_path / "plain.npy"
    np.save(plain, SyntheticOperator(side="left").record(0.1).landmarks)
    with pytest.raises(RecordingError, match="rate"):
        Replay(plain).start(Mailbox())
    arrivals = played(Replay(plain, rate=100.0, side="left"), Waits())
    assert [a.frame.side for a in arrivals] == ["left"] * 10
    with pytest.raises(ConfigError, match="speed"):
        Replay(plain, speed=0.0)


def test_the_built_in_operator_in_real_time_is_that_of_the_demo():
    running, mailbox = started(Waits())
    SyntheticSource(seed=4, rate=60.0, duration=1.0, tracker="headset").run(running)
    tracker = tracker_model("headset", 4)
    recording = SyntheticOperator(seed=4, rate_hz=60.0, tracker=tracker).record(1.0)
    assert [a.frame.stamp for a in mailbox.all] == pytest.approx(recording.stamps)
    assert [a.received for a in mailbox.all] == pytest.approx(recording.stamps)
    assert source_gaps(SyntheticSource(tracker="camera")) == MEDIAPIPE
    assert source_gaps(SyntheticSource(tracker="headset")) == {}
    for arrived, landmarks in zip(mailbox.all, recording.landmarks, strict=True):
        np.testing.assert_array_equal(arrived.frame.landmarks, landmarks)


def test_both_hands_come_by_turns_and_mirror_each_other():
    running, mailbox = started(Waits(until=0.5))
    SyntheticSource(side="both", gestures="pinch_index+spread").run(running)
    right, left = ([a.frame for a in mailbox.all if a.frame.side == s] for s in ("right", "left"))
    assert len(right) == len(left) > 40
    for one, other in zip(right, left, strict=True):
        assert one.stamp == other.stamp
        np.testing.assert_allclose(one.landmarks * [1, -1, 1], other.landmarks)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"rate": 0.0}, "rate"),
        ({"side": "top"}, "side"),
        ({"gestures": "pinch_index+wave"}, "wave"),
        ({"tracker": "sonar"}, "sonar"),
        ({"duration": 0.0}, "duration"),
        ({"rate": 0.0, "duration": 1.0}, "rate"),
    ],
)
def test_settings_of_the_operator_are_checked(settings, says):
    with pytest.raises((ConfigError, UnknownNameError), match=says):
        SyntheticSource(**settings)


@pytest.mark.parametrize(
    ("stamps", "sessions"),
    [
        ([0.0, 0.1, 0.2], [0, 0, 0]),
        ([5.0, 5.1, 5.1, 5.05, 5.2], [0, 0, 0, 0, 0]),  # repeated, out of order: the loop's affair
        ([5.0, 4.1, 5.1, 4.05, 5.2], [0, 0, 0, 1, 1]),  # more than a second behind the newest
        ([5.0, 0.0, 0.1], [0, 1, 1]),
        ([5.0, 99.0, 5.1, 5.2], [0, 0, 1, 1]),
    ],
)
def test_stamps_that_jump_back_are_another_session(stamps, sessions):
    assert received([Reading(frame(at)) for at in stamps]) == [
        ("right", session) for session in sessions
    ]


def received(readings: list[Reading]) -> list[tuple[Side, int]]:
    """Side and session of each frame of messages that are read so."""
    running, mailbox = started(Waits())
    script = iter(readings)
    receiver = MessageReceiver(running, "here", ("right", "left"), lambda *_: [next(script)])
    for reading in readings:
        receiver.take((b"",), 1.2 if reading.frame.stamp is None else reading.frame.stamp)
    return [(a.frame.side, a.session) for a in mailbox.all]


def test_each_hand_has_its_sessions_and_a_tracker_may_name_them():
    script: list[Reading] = [
        Reading(frame(1.0), "a"),
        Reading(frame(1.0, "left"), "a"),
        Reading(frame(1.1), "b"),
        Reading(frame(1.1, "left"), "a"),
        Reading(replace(frame(), stamp=None), "b"),
    ]
    sessions = [("right", 0), ("left", 0), ("right", 1), ("left", 0), ("right", 2)]
    assert received(script) == sessions


def test_health_counts_what_could_not_be_read_and_tells_of_silence():
    def read(message: tuple[bytes, ...], at: float) -> list[Reading]:
        if message[0] == b"bad":
            raise RecordingError("it makes no sense")
        return [Reading(frame(at))]

    waits = Waits()
    running, mailbox = started(waits)
    receiver = MessageReceiver(running, "udp://x:1", ("right",), read)
    assert (running.health.state, running.health.detail) == ("waiting", "listening on udp://x:1")
    receiver.silent()
    assert running.health.state == "waiting"
    receiver.take((b"bad",), 0.0)
    assert running.health.state == "waiting"
    for k in range(4):
        receiver.take((b"good",), 0.1 * k)
    assert running.health.state == "running"
    assert running.health.detail == "1 of 5 messages could not be read: it makes no sense"
    waits.now = 0.9
    receiver.silent()
    assert running.health.state == "running"
    waits.now = 5.4
    receiver.silent()
    assert running.health.state == "waiting"
    assert "for 5 s" in running.health.detail
    assert len(mailbox.all) == 4
    receiver.take((b"good",), waits.now)
    for waits.now in (6.0, 9.0):  # a page that keeps on connecting is no sign of the tracker
        state = running.health.state
        receiver.take((RecordingError("closed"),), waits.now)
    assert (state, running.health.state) == ("running", "waiting")
    assert running.health.detail.endswith("for 4 s; connections closed: 2; closed")
    receiver = MessageReceiver(running, "x", ("right",), lambda _, at: [Reading(frame(at, "left"))])
    receiver.take((b"",), 9.0)
    assert len(mailbox.all) == 5
    assert running.health.state == "waiting"
    assert "other hand" in running.health.detail


def test_overflow_in_a_source_says_nothing_on_the_terminal():
    class Overflowing(ThreadedSource):
        label = "overflowing"

        def run(self, running: Running) -> None:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                np.linalg.norm(np.full((21, 3), 1e300), axis=1)
                np.full(3, np.inf) - np.inf

    source = Overflowing()
    source.start(Mailbox())
    source._running.end()
    assert source.health().state == "ended", source.health()
