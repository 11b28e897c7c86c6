"""Switches of a running loop: operator actions, terminal keys, and an external emergency stop.

All inputs of the external stop fail safe: a broken wire, a missing file, an unplugged adapter or a
missing heartbeat stops the robot. The input is read 200 times a second, on a thread of its own.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final

from smooth_operator.errors import ConfigError, MissingExtraError, SourceError
from smooth_operator.teleop.control.bindings import ACTIONS, spoken
from smooth_operator.teleop.runtime.loop import TeleopLoop

_NAMES: Final = {
    " ": "space",
    "\x1b": "escape",
    "\r": "enter",
    "\n": "enter",
    "\t": "tab",
    "\x7f": "backspace",
    "\b": "backspace",
}
"""Character from a terminal -> name of its key in a table of inputs."""


def actions(
    loop: TeleopLoop, bindings: Mapping[str, str], say: Callable[[str], None]
) -> dict[str, Callable[[], None]]:
    """Returns the actions of a loop, by their names in ``ACTIONS``.

    The page or another program may also change the robot's mode, so no state is kept here: a stop
    is always requested, and the other actions read the mode from the supervisors.

    Args:
        bindings: input -> action.
        say: shows a line to the operator.
    """
    controls = loop.controls
    supervisors = [pipeline.supervisor for pipeline in loop.pipelines.values()]

    def by(action: str) -> str:
        return spoken(bindings, action)

    def stop() -> None:
        controls.stop()
        say(f"STOPPED; to release: {by('release')}")

    def release() -> None:
        if any(supervisor.stopped for supervisor in supervisors):
            controls.release()
            say("released")
        else:
            say("the robot is not stopped, so there is nothing to release")

    def pause() -> None:
        if any(supervisor.stopped for supervisor in supervisors):
            say(f"STOPPED; first release the stop: {by('release')}")
        elif any(supervisor.paused for supervisor in supervisors):
            controls.resume()
            say("resumed")
        else:
            controls.pause()
            say(f"paused; to resume: {by('pause')}")

    def wrist() -> None:
        released = any(pipeline.clutch.released for pipeline in loop.pipelines.values())
        controls.follow(released)
        say(
            "wrist: engages"
            if released
            else (
                f"wrist clutch released; to engage it: {by('wrist')}; the fingers continue to "
                "follow"
            )
        )

    return {"stop": stop, "release": release, "pause": pause, "wrist": wrist, "quit": controls.quit}


def help_line(bindings: Mapping[str, str], offered: Collection[str]) -> str:
    """Line for a terminal that lists all offered actions that have an input, with their inputs."""
    order = dict.fromkeys((*ACTIONS, *offered))
    return "   ".join(
        f"{spoken(bindings, name)}: {ACTIONS[name][0] if name in ACTIONS else name}"
        for name in order
        if name in offered and name in bindings.values()
    )


@contextlib.contextmanager
def background(name: str, work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Runs a function on a thread with a name while the block runs.

    Args:
        work: gets an event that is set at the end of the block, after which it should return.
    """
    over = threading.Event()
    thread = threading.Thread(target=work, args=(over,), name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(1.0)


@contextlib.contextmanager
def pressing(
    bindings: Mapping[str, str], actions: Mapping[str, Callable[[], None]]
) -> Iterator[Callable[[str], None]]:
    """Carries out the actions of inputs on a separate thread while the block runs.

    Args:
        bindings: input -> action.
        actions: name -> action. ``stop`` runs on the caller's thread, the others in order on one of
            this function. Their errors are printed on standard error.

    Yields:
        Function that takes an input, from any thread, and does not wait. An input without an action
        does nothing.
    """
    waiting: SimpleQueue[str | None] = SimpleQueue()

    def act(name: str) -> None:
        try:
            actions[name]()
        except Exception as error:  # the next input may be a stop
            print(f"error: {name}: {type(error).__name__}: {error}", file=sys.stderr)

    def press(source: str) -> None:
        name = bindings.get(source)
        if name == "stop":
            act(name)
        elif name in actions:
            waiting.put(name)

    def work() -> None:
        while (name := waiting.get()) is not None:
            act(name)

    thread = threading.Thread(target=work, name="actions", daemon=True)
    thread.start()
    try:
        yield press
    finally:
        waiting.put(None)
        thread.join(1.0)


@contextlib.contextmanager
def terminal_keys(press: Callable[[str], None]) -> Iterator[None]:
    """Passes on each key of the terminal at ``sys.stdin`` as soon as it is pressed.

    On POSIX systems, arrow keys and others that send several characters count as Esc, because
    their sequence begins with it; the other characters are dropped.

    Args:
        press: called with each key's name in a table of inputs, on a thread of this function.
    """
    with _reader() as read:

        def listen(over: threading.Event) -> None:
            while not over.is_set():
                pressed = read(0.1)
                if pressed is None:
                    return
                for key in pressed:
                    press(_NAMES.get(key, key.lower()))

        with background("keys", listen):
            yield


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
    """An external input for the emergency stop.

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
        """Closes the port or socket."""
        with contextlib.suppress(Exception):
            self._close()


@contextlib.contextmanager
def stopped_by(loop: TeleopLoop, stop: Callable[[], bool] | None) -> Iterator[None]:
    """Watches an external emergency stop while the block runs, and stops the loop.

    After the input is released, the loop stays stopped until a release by page, key or message.

    Args:
        stop: returns True while the stop is pressed; a ``StopInput`` is closed at the end. None for
            no input.
    """
    if stop is None:
        yield
        return

    def watch(over: threading.Event) -> None:
        was = False
        while not over.wait(_POLL_S):
            try:
                now = bool(stop())
            except Exception:  # an error of the caller's function counts as a broken wire
                now = True
            running = any(not hand.supervisor.stopped for hand in loop.pipelines.values())
            if now and (running or not was):
                loop.controls.stop()
            if now and not was:
                loop.controls.change(lambda hand: hand.note("the emergency stop was pressed"))
            was = now

    try:
        with background("emergency stop", watch):
            yield
    finally:
        if isinstance(stop, StopInput):
            stop.close()


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
