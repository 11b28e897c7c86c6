"""Keys in the terminal while a loop runs: stop, release, pause, quit, trials of a task."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from smooth_operator.teleop.control.reporter import Reporter
from smooth_operator.teleop.runtime.loop import TeleopLoop

STOP_KEYS: Final = (" ", "\x1b", "x", "X")
"""Each always stops, whatever the robot does; no other key does."""
WORDS: Final = (
    "space, Esc or x: EMERGENCY STOP   u: release it   p: pause / resume   c: wrist   q: end"
)


def actions(
    loop: TeleopLoop, say: Callable[[str], None], more: Mapping[str, Callable[[], None]] = {}
) -> dict[str, Callable[[], None]]:
    """Key -> action.

    The page or another program may change the robot's mode, too, so no state is kept here: a stop
    is always requested, and the other keys ask the supervisors.

    Args:
        say: shows a line to the person at the keys.
    """
    controls = loop.controls
    supervisors = [pipeline.supervisor for pipeline in loop.pipelines.values()]

    def stop() -> None:
        controls.stop()
        say("STOPPED; u releases")

    def release() -> None:
        if any(supervisor.stopped for supervisor in supervisors):
            controls.release()
            say("released")
        else:
            say("not stopped: there is nothing to release")

    def pause() -> None:
        if any(supervisor.stopped for supervisor in supervisors):
            say("STOPPED, which p does not change; u releases")
        elif any(supervisor.paused for supervisor in supervisors):
            controls.resume()
            say("resumed")
        else:
            controls.pause()
            say("paused; p resumes")

    def follow() -> None:
        released = any(pipeline.clutch.released for pipeline in loop.pipelines.values())
        controls.follow(released)
        say("wrist: engages" if released else "wrist released; c engages it, the fingers go on")

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
    """Listens to the keys while the loop runs, where there is a terminal.

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

    On POSIX systems arrows and other keys that send several characters count as Esc, with which
    they begin; their other characters are dropped.

    Args:
        actions: key -> action, run on a thread of this function. An error of an action is printed
            on standard error, and listening goes on.

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
                    actions.get(key, _nothing)()
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


def _nothing() -> None:
    """Action of a key without a meaning."""


@contextlib.contextmanager
def _reader() -> Iterator[Callable[[float], str | None]]:
    """A function that waits a while for keys; the terminal hands them over one by one. None where
    it was closed."""
    if sys.platform == "win32":
        import msvcrt

        def read(seconds: float) -> str | None:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                if msvcrt.kbhit():
                    key = msvcrt.getwch()
                    if key not in ("\x00", "\xe0"):
                        return key
                    msvcrt.getwch()  # of an arrow, whose second character is no key
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
                return None  # read again at a closed terminal, it would return immediately
            pressed = data.decode(errors="ignore")
            before_escape, escape, _ = pressed.partition("\x1b")
            return before_escape + escape

        try:
            tty.setcbreak(terminal)  # Ctrl-C stays a signal
            yield read
        finally:
            with contextlib.suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(terminal, termios.TCSADRAIN, before)
