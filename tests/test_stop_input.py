"""The emergency stop from outside: a file, a serial line, a heartbeat, a function."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from smooth_operator.errors import ConfigError, SourceError
from smooth_operator.teleop import teleoperate
from smooth_operator.teleop.runtime import stop_input
from smooth_operator.teleop.runtime.stop_input import StopInput, stopped_by
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Mode, Tick


def until(done: Callable[[], object], seconds: float = 10.0) -> None:
    end = time.perf_counter() + seconds
    while not done():
        assert time.perf_counter() < end, "it did not happen in time"
        time.sleep(0.002)


class FakeLoop:
    """What ``stopped_by`` needs of a loop."""

    def __init__(self) -> None:
        self.stops, self.supervisor = 0, SimpleNamespace(stopped=False)
        self.pipelines = {"right": SimpleNamespace(supervisor=self.supervisor)}
        self.controls: Any = SimpleNamespace(stop=self._stop, change=lambda change: None)

    def _stop(self) -> None:
        self.stops += 1
        self.supervisor.stopped = True


def test_a_file_stops_when_it_changes_or_is_gone(tmp_path: Path) -> None:
    line = tmp_path / "value"
    line.write_text("1\n")
    loop = FakeLoop()
    with stopped_by(loop, f"file:{line}"):  # type: ignore[arg-type]
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


def test_a_heartbeat_that_ends_is_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    pressed = StopInput(f"udp:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        assert pressed()
        sender.sendto(b"1", ("127.0.0.1", port))
        until(lambda: not pressed())
        monkeypatch.setattr("smooth_operator.teleop.runtime.stop_input._BEAT_S", 0.0)
        assert pressed()
        monkeypatch.undo()
        sender.sendto(b"1", ("127.0.0.1", port))
        until(lambda: not pressed())
        sender.sendto(b"0", ("127.0.0.1", port))
        until(pressed)
        with pytest.raises(SourceError, match="can't be opened"):
            StopInput(f"udp:{port}")
    pressed.close()
    assert pressed()


def test_a_heartbeat_counts_for_0_3_s_and_from_this_machine_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr(stop_input, "time", SimpleNamespace(monotonic=lambda: now[0]))
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
    pressed.close()


def test_a_serial_line(monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="an emergency stop"):
        StopInput(text)


def test_a_function_that_raises_stops_a_run_as_a_broken_wire_does() -> None:
    modes: list[Mode] = []
    loops: list[Any] = []

    class Seen(Sink):
        label = "seen"

        def open(self, hands: Any, config: Any) -> None: ...

        def send(self, tick: Tick) -> None:
            modes.append(tick.mode)
            if modes.count(Mode.STOPPED) > 3:
                loops[0].controls.quit()

        def close(self) -> None: ...

    def pressed() -> bool:
        if len(modes) > 20:
            raise OSError("the line is gone")
        return False

    teleoperate(
        "synthetic",
        [Seen()],
        method="joint_angle",
        duration=20.0,
        estop=pressed,
        started=loops.append,
    )
    assert Mode.STOPPED not in modes[:20]
    assert modes[-1] is Mode.STOPPED
