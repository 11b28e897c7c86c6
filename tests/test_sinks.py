"""Sinks side by side: one that fails harms nobody, and each says what it is told to say."""

import io
import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from free_port import free_port
from live_time import PATIENCE_S, until
from rich.console import Console
from ticks import KeptTicks, make_tick

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop.components import SINKS, build_sink
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.table import HandPanel, TableSink
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.teleop.sinks.zmq_sink import ZmqSink


def test_runner_opens_all_or_none(hand):
    good, bad, never = KeptTicks("good"), KeptTicks("bad"), KeptTicks("never")
    bad.raises["open"] = SinkError("no such port")
    runner = SinkRunner([good, bad, never])
    with pytest.raises(SinkError, match="no such port"):
        runner.open({"right": hand}, {})
    assert good.calls == ["open", "close"]
    assert never.calls == []
    del bad.raises["open"]
    runner.open({"right": hand}, {})
    with pytest.raises(ConfigError, match="already open"):
        runner.open({"right": hand}, {})
    runner.close()
    runner.close()
    assert [s.calls[-2:] for s in (good, bad, never)] == [["open", "close"]] * 3


def test_runner_isolates_a_failure_and_mends_it_in_its_time(hand):
    now = [100.0]
    good, bad = KeptTicks("good"), KeptTicks("bad")
    runner = SinkRunner([bad, good], retry_s=1.0, clock=lambda: now[0])
    runner.open({"right": hand}, {})
    bad.raises["send"] = ZeroDivisionError("odd")
    for i in range(5):
        runner.send(make_tick(hand, i))
    assert len(good.ticks) == 5
    until(lambda: bad.calls == ["open", "send", "close"])
    time.sleep(0.15)
    assert bad.calls == ["open", "send", "close"]  # not before its time
    first, second = runner.health()
    assert (first.state, first.sent, first.failed, first.missed) == ("failed", 0, 1, 5)
    assert first.detail == "ZeroDivisionError: odd"
    assert (second.state, second.sent, second.failed, second.detail) == ("open", 5, 0, "")
    bad.raises = {"open": SinkError("still away")}
    now[0] += 1.01
    until(lambda: runner.health()[0].detail == "still away")
    bad.raises = {}
    now[0] += 1.01
    until(lambda: runner.health()[0].state == "open")
    runner.send(make_tick(hand, 6))
    assert [t.number for t in bad.ticks] == [6]
    runner.close()
    report = runner.report()
    assert [h.state for h in report] == ["closed", "closed"]
    assert [h.failed for h in report] == [2, 0]
    assert report[0].detail == "still away"


def test_runner_closes_all_even_when_one_fails_in_closing(hand):
    bad, good = KeptTicks("bad"), KeptTicks("good")
    bad.raises["close"] = OSError("disk gone")
    runner = SinkRunner([bad, good])
    runner.open({"right": hand}, {})
    runner.close()
    assert good.calls[-1] == "close"
    assert "disk gone" in runner.report()[0].detail


def test_runner_takes_in_and_lets_go_while_running(hand):
    base = KeptTicks("base")
    runner = SinkRunner([base], retry_s=0.05)
    runner.open({"right": hand}, {})
    stop = threading.Event()
    sent = [0]

    def loop() -> None:
        while not stop.is_set():
            runner.send(make_tick(hand, sent[0]))
            sent[0] += 1

    thread = threading.Thread(target=loop)
    thread.start()
    for i in range(60):
        extra = KeptTicks(f"extra {i}")
        if i % 3 == 0:
            extra.raises["send"] = SinkError("bad")
        runner.add(extra)
        time.sleep(0.002)
        runner.remove(extra)
        assert not extra.is_open
    stop.set()
    thread.join()
    refused = KeptTicks("refused")
    refused.raises["open"] = SinkError("taken")
    with pytest.raises(SinkError, match="taken"):
        runner.add(refused)
    runner.remove(refused)
    assert [h.label for h in runner.health()] == ["base"]
    runner.close()
    assert len(base.ticks) == sent[0] == runner.health()[0].sent
    report = runner.report()
    assert len(report) == 61
    assert all("AssertionError" not in h.detail for h in report)


def test_the_watchdog_does_not_wait_for_a_sink_that_hangs(hand):
    class Hanging(KeptTicks):
        def send(self, tick: Tick) -> None:
            inside.set()
            gate.wait(PATIENCE_S)

    gate, inside = threading.Event(), threading.Event()
    stuck, other = Hanging("stuck"), KeptTicks("other")
    runner = SinkRunner([stuck, other])
    runner.open({"right": hand}, {})
    loop = threading.Thread(target=runner.send, args=(make_tick(hand),))
    loop.start()
    assert inside.wait(PATIENCE_S)
    runner.stalled(0.3)
    assert loop.is_alive()  # the one that hangs was not waited for
    assert other.calls == ["open", "stalled"]
    assert stuck.calls == ["open", "stalled"]
    gate.set()
    loop.join()
    runner.close()


def test_every_word_of_the_catalogue_is_a_sink(tmp_path):
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    for word in SINKS:
        sink = build_sink(f"record:{tmp_path}/a.mcap" if word == "record" else word)
        assert sink.label.startswith(word)
        sink.close()  # never opened: nothing to do
        sink.stalled(1.0)


@pytest.fixture
def listen() -> Iterator[Callable[..., Any]]:
    import zmq

    with zmq.Context() as context:
        sockets = []

        def heard(sink: ZmqSink, tick: Tick, prefix: bytes = b"") -> Any:
            """A subscriber, after its first message: it needs a moment to connect."""
            socket = context.socket(zmq.SUB)
            socket.setsockopt(zmq.SUBSCRIBE, prefix)
            socket.connect(sink.address)
            sockets.append(socket)
            until(lambda: sink.send(tick) or socket.poll(20))
            return socket

        yield heard
        for socket in sockets:
            socket.close(0)


def test_zmq_says_all_of_a_command(hands, listen):
    sink = ZmqSink(f"tcp://127.0.0.1:{free_port()}", valid_for_s=0.15)
    sink.open(hands, {})
    sink.actions["success"]()
    socket = listen(sink, make_tick(hands["left"], 2), b'{"side":"left"')
    tick = make_tick(hands["left"], 3, mode=Mode.BLENDING)
    sink.send(make_tick(hands["right"], 9))  # not subscribed to
    sink.send(tick)
    while (message := json.loads(socket.recv()))["number"] != 3:
        pass
    assert message.pop("unix_time") == pytest.approx(time.time(), abs=PATIENCE_S)
    assert message == {
        "side": "left",
        "type": "command",
        "format": 1,
        "hand": "mimic_p050",
        "number": 3,
        "mode": "blending",
        "names": list(hands["left"].joint_names),
        "positions": tick.command.joint_positions.tolist(),
        "velocities": [0.0] * len(tick.command.joint_names),
        "stamp": tick.command.stamp,
        "time": tick.time,
        "valid_for_s": 0.15,
        "landmarks": tick.arrival.frame.landmarks.tolist(),
        "episode": {"success": 1, "end": 0, "again": 0},
    }
    sink.stalled(0.25)
    stalled = json.loads(socket.recv())
    assert (stalled["type"], stalled["side"], stalled["seconds"]) == ("stalled", "left", 0.25)
    sink.close()
    assert json.loads(socket.recv())["type"] == "end"
    sink.close()
    with pytest.raises(SinkError, match="not open"):
        sink.send(tick)


def test_zmq_subscribers_come_and_go_and_get_no_old_commands(hand, listen):
    sink = ZmqSink(f"tcp://127.0.0.1:{free_port()}")
    sink.open({"right": hand}, {})
    for number in (500, 1000):
        for k in range(200):  # nobody listens
            sink.send(make_tick(hand, k))
        time.sleep(0.1)  # they are gone
        socket = listen(sink, make_tick(hand, number))
        assert json.loads(socket.recv())["number"] == number
        socket.close(0)
    sink.close()


def test_zmq_address_in_use_and_reopened(hand, listen):
    sink = ZmqSink(f"tcp://127.0.0.1:{free_port()}")
    other = ZmqSink(sink.address)
    sink.open({"right": hand}, {})
    with pytest.raises(SinkError, match="choose another address"):
        other.open({"right": hand}, {})
    sink.close()
    other.open({"right": hand}, {})  # as it is given back
    assert json.loads(listen(other, make_tick(hand, 1)).recv())["number"] == 1
    other.close()


def test_zmq_never_sends_what_is_not_finite(hand):
    sink = ZmqSink(f"tcp://127.0.0.1:{free_port()}")
    sink.open({"right": hand}, {})
    tick = make_tick(hand)
    tick.command.joint_positions[2] = np.nan
    with pytest.raises(SinkError, match="not finite"):
        until(lambda: sink.send(tick))  # its thread fails, and the next command tells
    sink.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("zmq:5556", "not a ZeroMQ address"),
        ("zmq:valid_for_s=0", "valid_for_s must be greater than 0"),
        ("table:0", "table: rate"),
        ("mujoco:rate=50", "mujoco: rate"),
        ("mujoco:bandwidth=100", "mujoco: bandwidth"),
        ("mujoco:bandwidth=0", "mujoco: bandwidth"),
        ("record:a.txt", "MCAP"),
        ("record:a.mcap,flush_s=0", "record: flush_s"),
        ("record:a,buffer=0", "record: buffer"),
    ],
)
def test_bad_settings(text, words):
    with pytest.raises(ConfigError, match=words):
        build_sink(text)


def test_table_shows_joints_mode_and_latency(hand):
    panel = HandPanel("right", hand)
    console = Console(file=io.StringIO(), width=100)
    console.print(panel.table())
    assert "no command yet" in console.file.getvalue()
    for i in range(200):
        panel.see(make_tick(hand, i, at=10.0 + 0.01 * i))
    line = panel.line()
    assert "tracking, 100 Hz, latency p50 2.00 ms, p99 2.00 ms" in line
    console.print(panel.table())
    text = console.file.getvalue()
    last = make_tick(hand, 199)
    for name, q in zip(hand.joint_names, last.command.joint_positions, strict=True):
        (row,) = [row for row in text.splitlines() if f"│{name} " in row]
        assert f"{q:+.3f}" in row
        low, high = hand.joint_limits[hand.joint_names.index(name)]
        assert row.count("█") == round(24 * (q - low) / (high - low))
    panel.silence = 1.5
    assert "stalled" in panel.line()


def test_table_writes_lines_where_no_terminal_is(hands, capfd):
    sink = TableSink()
    sink.open(hands, {})
    for i in range(50):
        for hand in hands.values():
            sink.send(make_tick(hand, i, at=10.0 + 0.01 * i))
    sink.stalled(0.5)
    sink.close()
    out, err = capfd.readouterr()
    assert out == ""
    said = [line.split(",")[0] for line in err.splitlines()]
    assert said == ["mimic_p050 right: stalled", "mimic_p050 left: stalled"]


def test_table_draws_in_a_terminal(hand, monkeypatch):
    class Screen(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm-256color")
    sink = TableSink(rate=20)
    sink.open({"right": hand}, {})
    for i in range(30):
        sink.send(make_tick(hand, i, at=10.0 + 0.01 * i))
        time.sleep(0.01)
    sink.close()
    text = screen.getvalue()
    assert text.count("index_mcp2pp") >= 3
    assert "█" in text
