"""External emergency stop: a button on a line of this machine, or a heartbeat.

All inputs fail safe: a broken wire, a missing file, an unplugged adapter or the end of a heartbeat
are a stop. The input is read two hundred times a second, on a thread of its own.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.errors import ConfigError, MissingExtraError, SourceError

if TYPE_CHECKING:
    from smooth_operator.teleop.runtime.loop import TeleopLoop

_POLL_S: Final = 0.005
_BEAT_S: Final = 0.3
"""Time for which a heartbeat counts [s]."""

FORMS: Final = "file:PATH, serial:PORT or udp:PORT"


class StopInput:
    """Input of an emergency stop.

    Args:
        text: ``file:PATH``: released while the file's first character is 1, as the value of a GPIO
            line whose button opens a closed contact, or a file that another program writes;
            ``serial:PORT``: a normally closed button between the pins RTS and CTS of a serial
            adapter, released while CTS is high (extra ``dynamixel``, for pyserial);
            ``udp:PORT`` or ``udp:ADDRESS:PORT``: released while datagrams that begin with 1 come,
            one every 0.3 s at least; it listens on this machine unless an address is given.

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
        except Exception:  # of a file or adapter that is gone
            return True

    def close(self) -> None:
        """Close port or socket."""
        with contextlib.suppress(Exception):
            self._close()


@contextlib.contextmanager
def stopped_by(loop: TeleopLoop, stop: str | Callable[[], bool] | None) -> Iterator[None]:
    """Stops the loop by an input, while the block runs.

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
        raise MissingExtraError("an emergency stop on a serial adapter", "dynamixel") from error
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
        with contextlib.suppress(BlockingIOError):
            while True:
                good = receiver.recv(64)[:1] == b"1"
                beat[0] = time.monotonic() if good else -1e9
        return time.monotonic() - beat[0] < _BEAT_S

    return released, receiver.close
