"""Switches of a running loop under attack: hostile messages, floods, stops that cross releases."""

import json
import os
import struct
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from live_loop import Running, running, session_of
from live_time import PATIENCE_S, until
from ticks import make_tick

from smooth_operator import HandFrame, Retargeter, load_hand
from smooth_operator.errors import ConfigError, SourceError, UnknownNameError
from smooth_operator.landmarks import FINGERS
from smooth_operator.planning import make_request
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.retargeting.known_gaps import known_gaps
from smooth_operator.synthetic.operator import SyntheticOperator
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator.teleop.control.bindings import ACTIONS, inputs_of, read_bindings
from smooth_operator.teleop.control.method_switcher import MethodSwitcher
from smooth_operator.teleop.control.pedal import pedal
from smooth_operator.teleop.control.pinches import sides_of, watched
from smooth_operator.teleop.control.rpc import RpcHandlers, RpcServer, remote
from smooth_operator.teleop.control.switches import actions, help_line, pressing, terminal_keys
from smooth_operator.teleop.runtime.limiter import EXTRA
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Mode, WristCommand
from smooth_operator.teleop.sources.live import Arrival, Mailbox, SourceHealth

zmq = pytest.importorskip("zmq")

RATE = 100.0
HOSTILE = [
    b'{"do":' + b"[" * 20_000,
    b"{" * 20_000,
    b'{"do":' + b'{"do":' * 5_000,
    b'{"do": ' + b"9" * 20_000 + b"}",
    b'{"do": 1e999}',
    b'{"do": ["stop"]}',
    b'{"do": {"stop": "stop"}}',
    b'{"do": null}',
    b'{"do"',
    b"{}",
    b"[]",
    b"",
    b"\x00" * 1000,
    b"\xff\xfe{",
    '{"do": "\ud800"}'.encode("utf-8", "surrogatepass"),
    b'{"do": "st\\ud800op"}',
    b"stop\x00",
    b'{"do": "bang"}',
]


@dataclass
class Silence:
    """A source without frames."""

    label: str = "silence"

    def start(self, mailbox: Mailbox) -> None: ...

    def stop(self) -> None: ...

    def health(self) -> SourceHealth:
        return SourceHealth("running")


@pytest.fixture(scope="module")
def retargeter() -> Retargeter:
    built = Retargeter(load_hand("mimic_p050"), method="joint_angle")
    built.warm_up()
    return built


@pytest.fixture
def loop(retargeter: Retargeter) -> TeleopLoop:
    config = LoopConfig(rate=RATE)
    return TeleopLoop({"right": HandPipeline(retargeter, config)}, Silence(), SinkRunner(), config)


@pytest.fixture(name="running")
def _running(loop: TeleopLoop) -> Iterator[Running]:
    with running(loop) as run:
        yield run


class Client:
    """A program that sends without waiting for answers."""

    def __init__(self, address: str) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.linger = self._socket.sndhwm = self._socket.rcvhwm = 0
        self._socket.connect(address)

    def send(self, *frames: bytes) -> None:
        self._socket.send_multipart([b"", *frames])

    def hear(self) -> dict[str, Any]:
        assert self._socket.poll(1000 * PATIENCE_S), "no answer"
        return dict(json.loads(self._socket.recv_multipart()[-1]))

    def ask(self, message: bytes) -> dict[str, Any]:
        self.send(message)
        return self.hear()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy()


@pytest.fixture
def client(running: Running) -> Iterator[Client]:
    with remote(running.loop, "tcp://127.0.0.1:*") as address, Client(address) as connected:
        yield connected


def test_no_message_ends_the_listening(running, client):
    for message in HOSTILE:
        answer = client.ask(message)
        assert not answer["ok"], message[:40]
        assert len(answer["error"]) < 400
    for _ in range(3):
        client.send(*[b"x"] * 100)  # more parts than any relay adds
    assert client.ask(b"status")["modes"] == {"right": "waiting"}
    assert client.ask(b'{"do": "stop"}')["modes"] == {"right": "stopped"}
    assert running.mode() is Mode.STOPPED


def test_a_word_and_a_status_that_go_wrong_are_answered(running):
    def broken(fields: Any = None) -> dict[str, Any]:
        raise RecursionError("deep")

    with (
        remote(running.loop, "tcp://127.0.0.1:*", {"bang": broken}, broken) as address,
        Client(address) as client,
    ):
        for word in (b"bang", b"status"):
            assert "RecursionError" in client.ask(word)["error"]
        assert client.ask(b"stop")["ok"]


def test_asking_for_the_status_sends_no_commands(running, client):
    for _ in range(3000):
        client.send(b"status")
    for _ in range(3000):
        client.hear()
    at = np.array([tick.time for tick in running.ticks])
    window = (np.searchsorted(at, at + 0.2, "right") - np.arange(len(at))).max()
    assert window <= 0.2 * RATE + EXTRA + 1  # a tick's time is a moment after its turn


def test_a_stop_overtakes_what_waits(running):
    # no thread and no socket: what has been heard by the time of the stop is certain
    board = RpcServer(running.loop)
    answers: list[tuple[str, dict[str, Any]]] = []

    def say(word: str) -> None:
        board.hear(word.encode(), lambda text: answers.append((word, json.loads(text))))

    say("stop")
    until(lambda: running.mode() is Mode.STOPPED)
    for _ in range(1000):
        say("status")
    say("release")
    say("pause")
    say("stop")  # the release was for the first one
    until(lambda: running.loop.controls.waiting is False)
    assert [word for word, answer in answers if not answer["ok"]] == ["release"]
    assert "stop arrived in the meantime" in answers[-1][1]["error"]
    while not board.idle:
        board.turn()
    assert len(answers) == 1004
    assert running.loop.pipelines["right"].supervisor.stopped
    assert running.loop.pipelines["right"].supervisor.paused
    say("release")
    say("resume")
    while not board.idle:
        board.turn()
    assert not running.loop.pipelines["right"].supervisor.stopped


def test_a_stop_ends_what_was_released_a_moment_before(running):
    controls, supervisor = running.loop.controls, running.loop.pipelines["right"].supervisor
    controls.stop()
    until(lambda: running.mode() is Mode.STOPPED)
    held, go = threading.Event(), threading.Event()
    controls.change(lambda hand: (held.set(), go.wait(PATIENCE_S)))
    held.wait(PATIENCE_S)
    controls.release()
    controls.stop()  # both wait: the stop was later, and holds
    go.set()
    until(lambda: not controls.waiting)
    first = len(running.ticks)
    until(lambda: len(running.ticks) > first + 3)
    assert supervisor.stopped
    assert {tick.mode for tick in running.ticks[first:]} == {Mode.STOPPED}
    controls.release()
    until(lambda: not supervisor.stopped)


def test_too_many_messages_are_refused_and_a_stop_is_not(running):
    board, answers = RpcServer(running.loop), []
    for _ in range(5000):
        board.hear(b"status", lambda text: answers.append(json.loads(text)))
    assert answers
    assert all("too many" in answer["error"] for answer in answers)
    board.hear(b"stop", lambda text: None)
    until(lambda: running.mode() is Mode.STOPPED)


def test_a_loop_that_hangs_is_told_by_the_status(running, client):
    assert client.ask(b"status")["ok"]
    hangs, go = threading.Event(), threading.Event()
    running.loop.controls.change(lambda hand: (hangs.set(), go.wait(PATIENCE_S)))
    hangs.wait(PATIENCE_S)
    time.sleep(0.6)
    assert "does not answer" in client.ask(b"status")["error"]
    assert "does not answer" in client.ask(b"stop")["error"]
    go.set()
    until(lambda: running.mode() is Mode.STOPPED)
    assert client.ask(b"status")["modes"] == {"right": "stopped"}


def test_switches_move_the_pace_no_more_than_the_rate_lets_them(running):
    controls = running.loop.controls
    end = time.monotonic() + 0.5
    first = len(running.ticks)
    while time.monotonic() < end:
        controls.pause()
        controls.resume()
        time.sleep(0.0005)
    at = np.array([tick.time for tick in running.ticks[first:]])
    assert len(at) <= (at[-1] - at[0]) * RATE + EXTRA + 2


class Terminal:
    """A terminal to press keys on, and what it showed."""

    def __init__(self, master: int) -> None:
        self.master = master
        self.said: list[str] = []

    def press(self, keys: bytes) -> str:
        """Press keys; returns what is said of it."""
        before = len(self.said)
        os.write(self.master, keys)
        until(lambda: len(self.said) > before)
        return self.said[before]


@pytest.fixture
def terminal(running: Running, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    """Listens to its keys as a run does; the key of ``go`` raises."""
    pty = pytest.importorskip("pty", reason="a POSIX terminal")
    master, slave = pty.openpty()
    built, bindings = Terminal(master), read_bindings()
    acts = {"go": lambda: [][1], **actions(running.loop, bindings, built.said.append)}
    line = help_line(bindings, acts)
    assert line.startswith("space, escape or x: EMERGENCY STOP   u: release the stop   p:")
    with os.fdopen(slave) as stdin, monkeypatch.context() as patched:
        patched.setattr(sys, "stdin", stdin)
        with pressing(bindings, acts) as press, terminal_keys(press):
            yield built
    os.close(master)


@pytest.mark.parametrize("key", [b" ", b"\x1b", b"x", b"X", b"\x1b[A", b"\x1bu"])
def test_a_stop_key_stops_whoever_released_last(running, terminal, key):
    assert "STOPPED" in terminal.press(key)
    running.stays(Mode.STOPPED)
    running.loop.controls.release()  # on the page, or by another program
    running.stays(Mode.WAITING)
    assert "STOPPED" in terminal.press(key)
    running.stays(Mode.STOPPED)
    terminal.press(key)  # again: it does not release
    running.stays(Mode.STOPPED)
    assert terminal.press(b"p") == "STOPPED; first release the stop: u"
    running.stays(Mode.STOPPED)
    assert terminal.press(b"u") == "released"
    running.stays(Mode.WAITING)
    assert "not stopped" in terminal.press(b"u")


def test_pause_asks_what_the_robot_does(running, terminal):
    assert "paused" in terminal.press(b"p")
    running.stays(Mode.PAUSED)
    running.loop.controls.resume()  # on the page
    running.stays(Mode.WAITING)
    assert "paused" in terminal.press(b"p")
    running.stays(Mode.PAUSED)
    terminal.press(b"x")
    running.stays(Mode.STOPPED)
    terminal.press(b"u")
    running.stays(Mode.PAUSED)  # the clutch is as it was
    assert terminal.press(b"p") == "resumed"
    running.stays(Mode.WAITING)


def test_a_key_that_goes_wrong_is_not_the_last(running, terminal, capfd):
    os.write(terminal.master, b"g")
    terminal.press(b" ")
    running.stays(Mode.STOPPED)
    assert "IndexError" in capfd.readouterr().err


def test_the_page_is_told_both_wrists(loop):
    session = session_of(loop, MethodSwitcher(loop, make_request(method="joint_angle")))
    (pipeline,) = loop.pipelines.values()
    target = WristCommand(np.array([0.4, 0.0, 3.0, 0.0, 1.0, 0.0, 0.0]), True, True)
    poses = (None, np.array([0.1, 0.2, 1.0, 1.0, 0.0, 0.0, 0.0]), np.full(7, np.nan))
    for k, pose in enumerate(poses):
        frame = HandFrame(FLAT_HAND, float(k), T_world_wrist=pose, world="room")
        pipeline.latest = Arrival(frame, loop.mailbox.clock())
        tick = make_tick(pipeline.retargeter.hand, k)
        session.watch(replace(tick, wrist=None if pose is None else target))
        latest = json.loads(json.dumps(session.look(text=False)))
        wrist = latest["hands"]["right"]["wrist"]
        if pose is None:
            assert wrist is None
        else:
            assert wrist["tracked"] == (k == 1)
    session.close()


def test_a_key_and_a_message_release_the_wrist_alone(loop):
    said: list[str] = []
    (pipeline,) = loop.pipelines.values()
    press = actions(loop, read_bindings(), said.append)["wrist"]
    for released in (True, False):
        press()
        loop._change()
        assert pipeline.clutch.released is released
        assert not pipeline.supervisor.paused
    assert said == [
        "wrist clutch released; to engage it: c; the fingers continue to follow",
        "wrist: engages",
    ]
    do = RpcHandlers(loop, SimpleNamespace()).by_command["wrist"]
    assert do({"engage": False}) == {"engage": False}
    loop._change()
    assert pipeline.clutch.released
    do({"engage": True})
    loop._change()
    assert not pipeline.clutch.released
    with pytest.raises(ConfigError, match="expected true or false"):
        do({})


def test_the_table_of_inputs(tmp_path):
    table = read_bindings()
    assert all(inputs_of(table, name) == list(own) for name, (_, own) in ACTIONS.items())
    file = tmp_path / "lab.toml"
    file.write_text('[bindings]\nrecord = ["pedal:48", "button:b"]\nstop = ["pinch:ring"]\n')
    table = read_bindings([str(file), "pause=R", "keep=", "home=h"], ["home"])
    assert inputs_of(table, "record") == ["pedal:48", "button:b"]
    assert inputs_of(table, "pause") == ["p", "r"]
    assert inputs_of(table, "keep") == []
    assert inputs_of(table, "home") == ["h"]
    assert inputs_of(table, "stop") == ["space", "escape", "x", "pinch:ring"]
    assert help_line(table, ["home", "keep", "stop"]) == (
        "space, escape, x or pinch:ring: EMERGENCY STOP   h: home"
    )


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["rekord=b"], "Did you mean 'record'"),
        (["record=space"], "space always stops the robot"),
        (["record=X"], "x always stops the robot"),
        (["stop="], "the inputs of stop can't be removed"),
        (["record=pinch:toe"], r"no input 'pinch:toe'; expected a key .*pedal:CODE"),
        (["record"], r"expected ACTION=INPUT, such as record=b"),
        (["missing.toml"], r"missing.toml: can't be read"),
        (["bad.toml"], r"expected a table \[bindings\]"),
    ],
)
def test_a_wrong_binding_is_explained(tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text('[bindings]\nrecord = "b"\n')
    with pytest.raises((ConfigError, UnknownNameError), match=expected):
        read_bindings(words)


@pytest.mark.parametrize("tracker", ["glove", "headset", "camera"])
def test_pinches_of_a_hand_count_once_each(tracker):
    """Gestures of the built-in operator, seen through a tracker; no fist is taken for a pinch."""
    gestures = ("open_close", "pinch_index", "pinch_middle", "spread", "pinch_ring", "pinch_pinky")
    operator = SyntheticOperator(1, "left", gestures=gestures, tracker=tracker_model(tracker))
    recording = operator.record(20.0)
    seen: list[str] = []
    inputs = {finger: f"pinch_{finger}" for finger in FINGERS[1:]}
    watch = watched({"left": inputs}, seen.append, known_gaps(tracker))
    for frame in recording:
        watch(frame, frame.time)
        watch(replace(frame, side="right"), frame.time)  # of the hand that drives the robot
    labels = recording.meta["gesture"]
    done = [name for name, after in pairwise([*labels, ""]) if name != after and "pinch" in name]
    assert len(done) >= 6
    if tracker == "camera":  # its tips may seem to touch at other times, too
        later = iter(seen)
        assert all(name in later for name in done[:-1])
    else:
        assert seen[: len(done) - 1] == done[:-1]  # the last one may have been cut off
        assert len(seen) <= len(done)


def test_with_two_robots_a_pinch_names_its_hand():
    table = read_bindings(["record=pinch:middle"])
    assert sides_of(table, ["right"]) == {"left": {"middle": "pinch:middle"}}
    assert sides_of(table, ["left"]) == {"right": {"middle": "pinch:middle"}}
    with pytest.raises(ConfigError, match="write pinch:left-middle or pinch:right-middle"):
        sides_of(table, ["right", "left"])
    named = read_bindings(["record=pinch:right-middle"])
    assert sides_of(named, ["right", "left"]) == {"right": {"middle": "pinch:right-middle"}}
    assert sides_of(read_bindings(), ["right", "left"]) == {}  # none unless the operator asks


@pytest.mark.skipif(sys.platform != "linux", reason="input devices of Linux")
def test_a_pedal_acts_without_the_focus_and_comes_back(tmp_path):
    """Events of the device as Linux describes them in Documentation/input/input.rst."""
    device, pressed, said = tmp_path / "event5", [], []
    os.mkfifo(device)

    def event(kind: int, code: int, value: int) -> bytes:
        return struct.pack("@llHHi", 1, 2, kind, code, value)

    with pedal(device, pressed.append, ["pedal:48"], said.append):
        for count in (1, 2):
            with device.open("wb", buffering=0) as plugged:
                # scan code, press, repetition, release, report
                for values in ((4, 4, 48), (1, 48, 1), (1, 48, 2), (1, 48, 0), (0, 0, 0)):
                    plugged.write(event(*values))
                plugged.write(event(1, 30, 1))
                until(lambda count=count: len(pressed) == 2 * count)
            until(
                lambda count=count: len([line for line in said if "disconnected" in line]) == count
            )
    assert pressed == 2 * ["pedal:48", "pedal:30"]
    assert said[0] == "this pedal has no action; to give it one: --bind ACTION=pedal:30"
    assert any(line.endswith("the pedal is connected again") for line in said)
    with (
        pytest.raises(SourceError, match="members of the group input"),
        pedal(tmp_path / "event6", pressed.append, [], said.append),
    ):
        pass
