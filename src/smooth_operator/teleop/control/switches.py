"""Local switches of a running loop: keys of the terminal and an external emergency stop.

All inputs of the external stop fail safe: a broken wire, a missing file, an unplugged adapter or a
missing heartbeat stops the robot. The input is read 200 times a second, on a thread of its own.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError, MissingExtraError, SourceError
from smooth_operator.reporter import Reporter
from smooth_operator.teleop.runtime.loop import TeleopLoop

STOP_KEYS: Final = (" ", "\x1b", "x", "X")
"""Keys that trigger the emergency stop, in every mode of the robot."""
WORDS: Final = (
    "space, Esc or x: EMERGENCY STOP   u: release it   p: pause / resume   c: wrist   q: end"
)


def actions(
    loop: TeleopLoop, say: Callable[[str], None], more: Mapping[str, Callable[[], None]] = {}
) -> dict[str, Callable[[], None]]:
    """Actions by their keys.

    The page or another program may also change the robot's mode, so no state is kept here: a stop
    is always requested, and the other keys read the mode from the supervisors.

    Args:
        say: shows a line to the person at the keys.
    """
    controls = loop.controls
    supervisors = [pipeline.supervisor for pipeline in loop.pipelines.values()]

    def stop() -> None:
        controls.stop()
        say("STOPPED; press u to release")

    def release() -> None:
        if any(supervisor.stopped for supervisor in supervisors):
            controls.release()
            say("released")
        else:
            say("not stopped: there is nothing to release")

    def pause() -> None:
        if any(supervisor.stopped for supervisor in supervisors):
            say("STOPPED; p has no effect, press u to release")
        elif any(supervisor.paused for supervisor in supervisors):
            controls.resume()
            say("resumed")
        else:
            controls.pause()
            say("paused; press p to resume")

    def follow() -> None:
        released = any(pipeline.clutch.released for pipeline in loop.pipelines.values())
        controls.follow(released)
        say(
            "wrist: engages"
            if released
            else "wrist released; press c to engage it; the fingers continue"
        )

    own = {
        "c": follow,
        **dict.fromkeys(STOP_KEYS, stop),
        "u": release,
        "p": pause,
        "q": controls.quit,
    }
    assert not set(own) & set(more)
    return {**more, **own}


@contextlib.contextmanager
def keyboard(
    loop: TeleopLoop,
    reporter: Reporter,
    more: Mapping[str, Callable[[], None]] = {},
    words: str = "",
) -> Iterator[None]:
    """Listens to the keys while the loop runs, if there is a terminal.

    Args:
        reporter: shows lines to the person at the keys.
    """
    with keys(actions(loop, lambda text: reporter.note(text, matters=True), more)) as there:
        if there:
            reporter.note(WORDS + words)
        yield


@contextlib.contextmanager
def keys(actions: Mapping[str, Callable[[], None]]) -> Iterator[bool]:
    """Runs actions as keys are pressed, without waiting for a line.

    On POSIX systems, arrow keys and others that send several characters count as Esc, because
    their sequence begins with it; the other characters are dropped.

    Args:
        actions: key -> action, run on a thread of this function. An error of an action is printed
            on standard error, and listening continues.

    Yields:
        True if there is a terminal; its mode is restored at the end.
    """
    if not sys.stdin or not sys.stdin.isatty():
        yield False
        return
    done = threading.Event()

    def listen(read: Callable[[float], str | None]) -> None:
        while not done.is_set():
            pressed = read(0.1)
            if pressed is None:
                return
            for key in pressed:
                try:
                    if action := actions.get(key):
                        action()
                except Exception as error:  # the next key may be a stop
                    print(f"error: {type(error).__name__}: {error}", file=sys.stderr)

    with _reader() as read:
        thread = threading.Thread(target=listen, args=(read,), name="keys", daemon=True)
        thread.start()
        try:
            yield True
        finally:
            done.set()
            thread.join(1.0)


@contextlib.contextmanager
def _reader() -> Iterator[Callable[[float], str | None]]:
    """Yields a function that waits some seconds for keys; None means a closed terminal."""
    if sys.platform == "win32":
        import msvcrt

        def read(seconds: float) -> str | None:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                if msvcrt.kbhit():
                    key = msvcrt.getwch()
                    if key not in ("\x00", "\xe0"):
                        return key
                    msvcrt.getwch()  # the second character of an arrow
                time.sleep(0.01)
            return ""

        yield read
    else:
        import os
        import select
        import termios
        import tty

        terminal = sys.stdin.fileno()
        before = termios.tcgetattr(terminal)

        def read(seconds: float) -> str | None:
            ready, _, _ = select.select([terminal], [], [], seconds)
            if not ready:
                return ""
            try:
                data = os.read(terminal, 64)
            except OSError:
                return None
            if not data:
                return None  # the terminal is closed
            pressed = data.decode(errors="ignore")
            before_escape, escape, _ = pressed.partition("\x1b")
            return before_escape + escape

        try:
            tty.setcbreak(terminal)  # Ctrl-C stays a signal
            yield read
        finally:
            with contextlib.suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(terminal, termios.TCSADRAIN, before)


_POLL_S: Final = 0.005
_BEAT_S: Final = 0.3
"""Time for which a heartbeat counts [s]."""
_BEATS: Final = 1000
"""Largest number of datagrams to read at a time; a button sends fewer in 5 ms."""

FORMS: Final = "file:PATH, serial:PORT or udp:PORT"


class StopInput:
    """Input of an emergency stop.

    Args:
        text: ``file:PATH``: released while the file's first character is 1, such as the value file
            of a GPIO line with a normally closed button, or a file that another program writes;
            ``serial:PORT``: a normally closed button between the pins RTS and CTS of a serial
            adapter, released while CTS is high (needs the ``serial`` extra);
            ``udp:PORT`` or ``udp:ADDRESS:PORT``: released while datagrams that begin with 1 arrive
            at least every 0.3 s; without an address, accepts them from this machine only.

    Raises:
        ConfigError: the text is none of these.
        SourceError: the port can't be opened.
        MissingExtraError: pyserial is not installed.
    """

    def __init__(self, text: str) -> None:
        kind, _, what = text.partition(":")
        self._close: Callable[[], object] = lambda: None
        if kind == "file" and what:
            self._released = _file(Path(what).expanduser())
        elif kind == "serial" and what:
            self._released, self._close = _serial(what)
        elif kind == "udp" and what:
            self._released, self._close = _udp(what)
        else:
            raise ConfigError(f"an emergency stop is {FORMS}, not {text!r}")

    def __call__(self) -> bool:
        """True if the stop is pressed, or can't be read."""
        try:
            return not self._released()
        except Exception:  # the file or adapter is gone
            return True

    def close(self) -> None:
        """Close port or socket."""
        with contextlib.suppress(Exception):
            self._close()


@contextlib.contextmanager
def stopped_by(loop: TeleopLoop, stop: str | Callable[[], bool] | None) -> Iterator[None]:
    """Watches an emergency stop input while the block runs, and stops the loop.

    After the input is released, the loop stays stopped until a release by page, key or message.

    Args:
        stop: text of a ``StopInput``, or a function that returns True while the stop is pressed;
            None for no input.

    Raises:
        ConfigError, SourceError, MissingExtraError: as ``StopInput``.
    """
    if stop is None:
        yield
        return
    pressed = StopInput(stop) if isinstance(stop, str) else stop
    over = threading.Event()

    def watch() -> None:
        was = False
        while not over.wait(_POLL_S):
            try:
                now = bool(pressed())
            except Exception:  # an error of the caller's function counts as a broken wire
                now = True
            running = any(not hand.supervisor.stopped for hand in loop.pipelines.values())
            if now and (running or not was):
                loop.controls.stop()
            if now and not was:
                loop.controls.change(lambda hand: hand.note("the emergency stop was pressed"))
            was = now

    thread = threading.Thread(target=watch, name="emergency stop", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(1.0)
        if isinstance(pressed, StopInput):
            pressed.close()


def _file(path: Path) -> Callable[[], bool]:
    def released() -> bool:
        with path.open("rb", buffering=0) as file:
            return file.read(1) == b"1"

    return released


def _serial(port: str) -> tuple[Callable[[], bool], Callable[[], object]]:
    try:
        import serial
    except ImportError as error:
        raise MissingExtraError("an emergency stop on a serial adapter", "serial") from error
    try:
        line: Any = serial.Serial(port, exclusive=True)
        line.rts = True  # feeds the button
    except (OSError, ValueError) as error:
        raise SourceError(f"the emergency stop's port can't be opened: {error}") from error
    return lambda: bool(line.cts), line.close


def _udp(text: str) -> tuple[Callable[[], bool], Callable[[], object]]:
    address, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"an emergency stop over UDP is udp:PORT, not 'udp:{text}'")
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.bind((address or "127.0.0.1", int(port)))
    except OSError as error:
        receiver.close()
        raise SourceError(f"the emergency stop's port {text} can't be opened: {error}") from error
    receiver.setblocking(False)
    beat = [-1e9]

    def released() -> bool:
        pressed = False
        for _ in range(_BEATS):
            try:
                good = receiver.recv(64)[:1] == b"1"
            except BlockingIOError:
                return not pressed and time.monotonic() - beat[0] < _BEAT_S
            beat[0] = time.monotonic() if good else -1e9
            pressed |= not good
        return False  # a flood of datagrams could hide a press

    return released, receiver.close
