"""``teleoperate``: a whole run as one call, without a terminal, a page or a main thread."""

import itertools
import json
import logging
import os
import signal
import socket
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from live_time import PATIENCE_S, until
from ticks import KeptTicks

from smooth_operator import Retargeter, load_hand
from smooth_operator.calibration.operator_file import read_operator
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, SourceError
from smooth_operator.hand_files.spec_writer import temporary_spec
from smooth_operator.teleop import TeleopLoop, TeleopRequest, read_log, teleoperate
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.control import switches
from smooth_operator.teleop.control.switches import StopInput, stopped_by
from smooth_operator.teleop.runtime.pipeline import COMPILED, COMPILING
from smooth_operator.teleop.sinks.tick import Mode

METHOD = {"method": "joint_angle"}
"""It compiles in a second."""


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_hand_may_be_an_object(side, tmp_path):
    """A loaded hand, a description or its file; the other side is the mirror image."""
    hand = load_hand("leap_hand", "right", fingers=("thumb", "index", "middle"))
    kept = KeptTicks()
    teleoperate(TeleopRequest(side=side, duration=0.4, **METHOD), sinks=[kept], hand=hand)
    assert kept.config["hand"] == hand.name
    assert {tick.side for tick in kept.ticks} == {side}
    assert kept.ticks[-1].command.joint_names == hand.joint_names
    with temporary_spec(hand.spec.mirrored) as text:
        again = load_hand(text, side)
        assert (again.name, again.spec.side, again.fingers) == (hand.name, side, hand.fingers)
    assert not Path(text).exists()
    with temporary_spec("leap_hand") as text:
        assert text == "leap_hand"


def test_a_run_is_one_call_from_text_or_objects_to_a_summary(tmp_path, caplog):
    caplog.set_level(logging.INFO, "smooth_operator.teleop")
    kept, log, loops = KeptTicks(), tmp_path / "take.mcap", []
    request = TeleopRequest(
        source="webcam",
        sink=(f"record:{log}",),
        hand="leap_hand",
        rate=50.0,
        duration=0.6,
        **METHOD,
    )
    source = build_source("synthetic")
    summary = teleoperate(request, source=source, sinks=[kept], started=loops.append)
    assert json.loads(json.dumps(summary)) == summary
    assert not summary["interrupted"]
    assert summary["duration_s"] >= 0.6
    assert 0 < summary["frames_answered"] <= summary["frames_received"]
    assert [sink["failed"] for sink in summary["sinks"]] == [0, 0]
    assert set(summary["stages_ms"]) == {"tracker", "receive", "solve", "limit", "send"}
    assert len(kept.ticks) == summary["commands"]["right"]
    assert not kept.is_open
    assert kept.config["hand"] == "leap_hand"
    assert kept.config["sinks"] == ["kept", f"record:{log}"]
    recorded = read_log(log)
    assert recorded.commands.joint_names == kept.ticks[-1].command.joint_names
    assert isinstance(loops[0], TeleopLoop)
    said = [record.message for record in caplog.records]
    assert any(text.startswith("compiling joint_angle for leap_hand right") for text in said)
    assert any("frames in" in text for text in said)


def test_an_operators_file_is_made_and_kept(tmp_path):
    source = build_source("synthetic", "right")
    camera = type("Camera", (type(source),), {"pinch_gaps": {"index": 0.3}})()
    path = tmp_path / "anna.json"
    run = {"operator": path, "duration": 0.3}
    teleoperate(TeleopRequest(pinch_gaps="off", **run), source=camera, sinks=[KeptTicks()])
    assert not path.exists()  # nothing was learnt
    teleoperate(TeleopRequest(**run), source=camera, sinks=[KeptTicks()])
    assert read_operator(path).pinch_gaps == {"index": 0.3}
    kept = KeptTicks()
    # another session, with a tracker that closes pinches
    teleoperate(TeleopRequest(**run), source=source, sinks=[kept])
    assert kept.config["pinch_gaps"] == {"right": {"index": 0.3}}
    with pytest.raises(ConfigError, match="is for the right hand"):
        teleoperate(TeleopRequest(side="left", **run), sinks=[KeptTicks()])


def test_another_thread_may_run_and_end_it():
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    summaries: list[dict[str, Any]] = []

    def quit_soon(loop: TeleopLoop) -> None:
        threading.Timer(0.2, loop.controls.quit).start()

    request = TeleopRequest(methods=("joint_angle",), **METHOD)
    thread = threading.Thread(
        target=lambda: summaries.append(teleoperate(request, started=quit_soon))
    )
    thread.start()
    thread.join(PATIENCE_S)
    assert summaries[0]["frames_answered"] > 0
    assert not summaries[0]["interrupted"]
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers


def test_the_robot_holds_until_the_method_is_compiled(monkeypatch):
    kept, go, warm_up = KeptTicks(), threading.Event(), Retargeter.warm_up

    def slow(retargeter: Retargeter) -> float:
        assert go.wait(PATIENCE_S)
        return warm_up(retargeter)

    def watch(loop: TeleopLoop) -> None:
        until(lambda: len(kept.ticks) >= 30)
        go.set()
        until(lambda: kept.ticks[-1].status is not None)
        loop.controls.quit()

    def start(loop: TeleopLoop) -> None:
        threading.Thread(target=watch, args=(loop,)).start()

    monkeypatch.setattr(Retargeter, "warm_up", slow)
    monkeypatch.setattr(Retargeter, "compiled", property(lambda _: go.is_set()))
    teleoperate(TeleopRequest(**METHOD), sinks=[kept], started=start)
    assert kept.ticks[0].events == (COMPILING,)
    assert {(tick.mode, tick.status) for tick in kept.ticks[:30]} == {(Mode.WAITING, None)}
    assert any(COMPILED in tick.events for tick in kept.ticks[30:])
    assert kept.ticks[-1].status is not None


@pytest.mark.skipif(sys.platform == "win32", reason="sends a POSIX signal")
def test_ctrl_c_ends_a_run_and_everything_is_as_before(tmp_path, capsys):
    handler, turn = signal.getsignal(signal.SIGINT), sys.getswitchinterval()
    log = tmp_path / "take.mcap"

    def interrupt() -> None:
        until(lambda: log.exists() and log.stat().st_size > 2000)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    command = f"teleop --no-view --json --method joint_angle --sink record:{log}"
    assert main(command.split()) == 130
    summary = json.loads(capsys.readouterr().out)
    assert summary["interrupted"]
    assert summary["frames_answered"] > 0
    assert read_log(log).commands is not None
    assert signal.getsignal(signal.SIGINT) is handler
    assert sys.getswitchinterval() == turn
    assert [t.name for t in threading.enumerate() if t.name in ("watchdog", "keys", "page")] == []


class FakeLoop:
    """The part of a loop that ``stopped_by`` uses."""

    def __init__(self) -> None:
        self.stops, self.supervisor = 0, SimpleNamespace(stopped=False)
        self.pipelines = {"right": SimpleNamespace(supervisor=self.supervisor)}
        self.controls: Any = SimpleNamespace(stop=self._stop, change=lambda change: None)

    def _stop(self) -> None:
        self.stops += 1
        self.supervisor.stopped = True


def test_a_file_stops_when_it_changes_or_is_gone(tmp_path):
    line = tmp_path / "value"
    line.write_text("1\n")
    loop = FakeLoop()
    with stopped_by(loop, StopInput(f"file:{line}")):
        time.sleep(0.05)
        assert loop.stops == 0
        line.write_text("0\n")
        until(lambda: loop.supervisor.stopped)
        loop.supervisor.stopped = False  # somebody releases while it is pressed
        until(lambda: loop.supervisor.stopped)
        line.write_text("1\n")
        time.sleep(0.05)
        loop.supervisor.stopped = False
        time.sleep(0.05)
        assert not loop.supervisor.stopped
        line.unlink()
        until(lambda: loop.supervisor.stopped)


def test_a_flood_of_heartbeats_hides_no_stop(monkeypatch):
    """Datagrams come faster than they are read; one of them was the button's."""
    beats = itertools.chain([b"1", b"0"], itertools.repeat(b"1", 100_000))

    class Flooded:
        def bind(self, where: object) -> None: ...
        def setblocking(self, on: bool) -> None: ...
        def close(self) -> None: ...
        def recv(self, size: int) -> bytes:
            if (beat := next(beats, None)) is None:
                raise BlockingIOError
            return beat

    monkeypatch.setattr(switches.socket, "socket", lambda *_: Flooded())
    pressed = StopInput("udp:5000")
    assert pressed()
    assert sum(1 for _ in beats) > 90_000  # it does not wait for the end of the flood
    beats = iter([b"1", b"0", b"1"])
    assert pressed()  # a short press between two beats
    beats = iter([b"1"])
    assert not pressed()


def test_a_heartbeat_counts_for_0_3_s_and_from_this_machine_alone(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(switches, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    pressed = StopInput(f"udp:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        if sys.platform == "linux":  # where all of 127.0.0.0/8 is there
            sender.sendto(b"1", ("127.0.0.2", port))
            assert pressed()
        sender.sendto(b"1", ("127.0.0.1", port))
        until(lambda: not pressed())
        now[0] += 0.29
        assert not pressed()
        now[0] += 0.02
        assert pressed()
        sender.sendto(b"1", ("127.0.0.1", port))
        until(lambda: not pressed())
        sender.sendto(b"0", ("127.0.0.1", port))
        until(pressed)  # though the beat before it would still count
        with pytest.raises(SourceError, match="can't be opened"):
            StopInput(f"udp:{port}")
    pressed.close()
    assert pressed()


def test_a_serial_line(monkeypatch):
    serial = pytest.importorskip("serial", reason="pyserial is not installed")

    class Line:
        cts = True

        def __init__(self, port: str, exclusive: bool) -> None:
            assert port == "/dev/ttyX"
            assert exclusive

        def close(self) -> None:
            Line.cts = False

    monkeypatch.setattr(serial, "Serial", Line)
    pressed = StopInput("serial:/dev/ttyX")
    assert not pressed()
    pressed.close()
    assert pressed()
    monkeypatch.undo()
    with pytest.raises(SourceError, match="can't be opened"):
        StopInput("serial:/dev/ttyNONE")


@pytest.mark.parametrize("text", ["file:", "pin:4", "udp:x", "udp:99999", ""])
def test_other_texts_are_refused(text):
    with pytest.raises(ConfigError, match="an emergency stop"):
        StopInput(text)


def test_a_function_that_raises_stops_a_run_as_a_broken_wire_does():
    kept = KeptTicks()
    loops: list[Any] = []

    def pressed() -> bool:
        stopped = [tick for tick in kept.ticks if tick.mode is Mode.STOPPED]
        if len(stopped) > 3:
            loops[0].controls.quit()
        if len(kept.ticks) > 20:
            raise OSError("the line is gone")
        return False

    request = TeleopRequest(method="joint_angle", duration=20.0)
    teleoperate(request, sinks=[kept], stop=pressed, started=loops.append)
    modes = [tick.mode for tick in kept.ticks]
    assert Mode.STOPPED not in modes[:20]
    assert modes[-1] is Mode.STOPPED


def test_inputs_that_this_run_can_not_have_are_named(tmp_path):
    notes: list[str] = []
    reporter: Any = SimpleNamespace(note=lambda text, matters=False: notes.append(text))
    table = tmp_path / "lab.toml"
    table.write_text('[bindings]\nrecord = ["pedal:48", "pedal:30", "button:a"]\n')
    asked = TeleopRequest(bind=(str(table),), feedback=("udp:127.0.0.1:9000",))
    with pytest.raises(ConfigError, match="a sink that measures contact"):
        teleoperate(asked, reporter=reporter)
    assert notes == [
        "pedal:48, pedal:30: no effect in this run; name its device with --pedal",
        "button:a: no effect in this run; controllers need --source webxr",
    ]
    both = TeleopRequest(bind=("record=pinch:index",), side="both")
    with pytest.raises(ConfigError, match="pinch:left-index or pinch:right-index"):
        teleoperate(both, reporter=reporter)
