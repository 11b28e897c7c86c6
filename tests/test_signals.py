"""Signals end programs in order: torque off, recordings whole, the terminal as it was."""

import contextlib
import ctypes
import os
import re
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dynamixel_bank import ServoBank
from live_time import PATIENCE_S, until
from processes import python

from smooth_operator import signals
from smooth_operator.signals import ENDING, ended_by_signals
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.control.switches import terminal_keys
from smooth_operator.teleop.recording import read_log

LONG_S = PATIENCE_S
HIDDEN, SHOWN = "\x1b[?25l", "\x1b[?25h"
posix = pytest.mark.skipif(os.name == "nt", reason="POSIX signals and pseudo-terminals")

ON_TERMINAL = """
import os, signal, sys
for stream in (0, 1, 2):
    os.dup2(os.open(sys.argv[1], os.O_RDWR), stream)  # the first one becomes the session's own
os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
"""


class Terminal:
    """A command on a pseudo-terminal of its own, which it controls.

    Args:
        arguments: of Python.
        environment: more variables.
    """

    def __init__(self, *arguments: str, **environment: str) -> None:
        self._ours, theirs = os.openpty()
        self.output = ""
        self.process = subprocess.Popen(
            [sys.executable, "-c", ON_TERMINAL, os.ttyname(theirs), *arguments],
            start_new_session=True,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "200", **environment},
        )
        os.close(theirs)
        self._reading = True
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while self._reading:
            with contextlib.suppress(OSError):  # EIO: it has ended
                if select.select([self._ours], [], [], 0.05)[0]:
                    self.output += os.read(self._ours, 65536).decode(errors="replace")

    def shows(self, text: str) -> None:
        """Wait for a text."""

        def there() -> bool:
            assert self.process.poll() is None, self.output
            return text in self.output

        until(there, LONG_S)

    def close(self) -> None:
        """Close the window."""
        self._reading = False
        self._reader.join()
        os.close(self._ours)

    def end(self, how: str) -> int:
        """Close the window, or send a signal; the exit status."""
        if how == "closed":
            self.close()
        else:
            self.process.send_signal(getattr(signal, how))
        return self.process.wait(LONG_S)


@pytest.fixture
def bank() -> Iterator[ServoBank]:
    bank = ServoBank(list(range(16)))
    yield bank
    bank.unplug()


def powered(bank: ServoBank) -> int:
    return sum(servo.torque for servo in bank.servos.values())


TELEOP = (
    *("-m", "smooth_operator", "teleop", "--hand", "leap_hand"),
    *("--method", "joint_angle", "--methods", "joint_angle"),  # compiled before the loop starts
)


@posix
@pytest.mark.parametrize("how", [pytest.param("closed", marks=pytest.mark.weekly), "SIGTERM"])
def test_a_run_ends_with_torque_off_and_a_whole_recording(bank, tmp_path, how):
    log = tmp_path / "take.mcap"
    sinks = ("--sink", f"leap:{bank.path},baud=57600", f"record:{log}")
    terminal = Terminal(*TELEOP, "--no-view", *sinks)
    until(lambda: len(bank.goals) > 50, LONG_S)
    assert powered(bank) == 16
    assert terminal.end(how) == 130, terminal.output
    assert powered(bank) == 0
    assert not read_log(log).truncated
    if how != "closed":
        until(lambda: re.search(r"\d+ frames in ", terminal.output))
        terminal.close()


@posix
@pytest.mark.parametrize("how", ["closed", pytest.param("SIGTERM", marks=pytest.mark.weekly)])
def test_a_check_of_a_hand_ends_with_torque_off(bank, how):
    device = f"leap:{bank.path},baud=57600"
    terminal = Terminal("-m", "smooth_operator", "hardware", "check", device)
    until(lambda: powered(bank) == 16, LONG_S)
    assert terminal.end(how) == 130, terminal.output
    assert powered(bank) == 0
    if how != "closed":
        terminal.close()


@posix
@pytest.mark.parametrize("how", ["SIGINT", pytest.param("SIGHUP", marks=pytest.mark.weekly)])
def test_a_run_that_has_not_begun_ends_too(bank, tmp_path, how):
    sink = ("--sink", f"leap:{bank.path},baud=57600")
    waiting = ("--method", "smooth", "--duration", "9", "--no-browser", "--port", "0")
    terminal = Terminal(*TELEOP, *waiting, *sink)
    terminal.shows("compiling")
    assert terminal.end(how) == 130, terminal.output
    assert "Traceback" not in terminal.output
    until(lambda: terminal.output.endswith("smooth-operator: stopped\r\n"))
    assert powered(bank) == 0
    assert bank.goals == []
    terminal.close()


@posix
@pytest.mark.parametrize("how", ["SIGINT", pytest.param("SIGQUIT", marks=pytest.mark.weekly)])
def test_a_progress_bar_leaves_the_cursor_and_no_file(tmp_path, how):
    motion = SyntheticOperator().record(300.0)
    np.savez(tmp_path / "long.npz", landmarks=motion.landmarks, timestamps=motion.stamps)
    command = ("retarget", str(tmp_path / "long.npz"), "--method", "joint_angle")
    terminal = Terminal("-m", "smooth_operator", *command, "--output", str(tmp_path / "new/a.npz"))
    terminal.shows("retargeting")
    assert HIDDEN in terminal.output
    assert terminal.end(how) == 130, terminal.output
    until(lambda: "stopped" in terminal.output)
    until(lambda: terminal.output.rfind(SHOWN) > terminal.output.rfind(HIDDEN))
    assert "Traceback" not in terminal.output
    assert [path.name for path in tmp_path.iterdir()] == ["long.npz"]
    terminal.close()


IMPORTING = """
import os, signal, sys
where, how = sys.argv[1:]

class Signals:
    def find_spec(self, name, path=None, target=None):
        if name == where:
            exec("os.kill(os.getpid(), signal.Signals[how])")  # as in dataclasses

if where in ("contextlib", "threading"):  # which Python has loaded itself
    del sys.modules[where]
sys.meta_path.insert(0, Signals())
sys.argv[1:] = ["retarget", "none.npz", "--output", "a.npz"]
from smooth_operator.cli import program
sys.exit(program())
"""


@posix
@pytest.mark.parametrize(
    ("where", "how", "home", "ended"),
    [
        ("smooth_operator.errors", "SIGTERM", "cli", (130, "smooth-operator: stopped\n")),
        ("numpy", "SIGINT", "cli", (130, "smooth-operator: stopped\n")),
        # before the command has a handler the signal ends the process; shells report that as 130
        ("smooth_operator.cli.process", "SIGINT", "__main__", (-signal.SIGINT, "")),
        ("contextlib", "SIGINT", "__main__", (-signal.SIGINT, "")),
    ],
)
def test_a_signal_in_the_midst_of_the_imports_is_no_traceback(tmp_path, where, how, home, ended):
    text = IMPORTING.replace("smooth_operator.cli", f"smooth_operator.{home}")
    (tmp_path / "importing.py").write_text(text, encoding="utf-8")
    done = python("-m", "importing", where, how, cwd=tmp_path)
    assert (done.returncode, done.stderr) == ended


@pytest.mark.parametrize("number", ENDING)
def test_the_first_signal_raises_and_those_after_it_do_not(number):
    before = [signal.getsignal(other) for other in ENDING]

    with ended_by_signals() as ending:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert ending.came
        for other in ENDING:  # a clean-up is not cut off
            if other != signal.SIGINT:
                signal.raise_signal(other)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert [signal.getsignal(other) for other in ENDING] == before


def test_another_thread_changes_nothing():
    def inside() -> list[Any]:
        with ended_by_signals():
            return [signal.getsignal(number) for number in ENDING]

    with ThreadPoolExecutor() as pool:
        assert pool.submit(inside).result() == [signal.getsignal(number) for number in ENDING]


def test_an_outer_block_quits_and_ignored_signals_stay_ignored():
    with ended_by_signals() as outer:
        quits: list[int] = []
        outer.quit = lambda: quits.append(0)
        with pytest.raises(KeyboardInterrupt), ended_by_signals():
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert quits == [0, 0]
        outer.quit = None
        signal.raise_signal(signal.SIGTERM)
    if hasattr(signal, "SIGHUP"):
        before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
        with ended_by_signals() as ending:
            signal.raise_signal(signal.SIGHUP)
        assert not ending.came
        signal.signal(signal.SIGHUP, before)


@posix
def test_keys_end_with_their_terminal(monkeypatch):
    """Reading a closed terminal returns immediately: the thread would take a whole core."""
    ours, theirs = os.openpty()
    with open(theirs, encoding="utf-8") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with terminal_keys(print):
            thread = next(t for t in threading.enumerate() if t.name == "keys")
            os.close(ours)
            thread.join(LONG_S)
            assert not thread.is_alive()


@posix
def test_a_closed_window_of_windows_is_an_ending_signal(monkeypatch):
    """With the system's part made up: its handlers, and that it ends the process afterwards."""
    handlers: list[Any] = []
    slept: list[float] = []

    def register(handler: Any, add: bool) -> None:
        handlers.append(handler) if add else handlers.remove(handler)

    kernel = SimpleNamespace(SetConsoleCtrlHandler=register)
    monkeypatch.setattr(ctypes, "windll", SimpleNamespace(kernel32=kernel), raising=False)
    monkeypatch.setattr(ctypes, "WINFUNCTYPE", lambda *_: lambda f: f, raising=False)
    monkeypatch.setattr(signal, "SIGBREAK", signal.SIGTERM, raising=False)
    monkeypatch.setattr(signals.sys, "platform", "win32")
    monkeypatch.setattr(signals.time, "sleep", slept.append)
    with ended_by_signals() as ending:
        ending.quit = lambda: None
        assert not handlers[0](0)  # Ctrl-C is Python's own
        assert not ending.came
        assert handlers[0](2)
        assert ending.came
    assert (slept, handlers) == ([30.0], [])
