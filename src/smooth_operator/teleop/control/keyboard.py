"""Keys in the terminal while a loop runs: stop, release, pause, quit, trials of a task."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from smooth_operator.teleop.control.reporter import Reporter
from smooth_operator.teleop.control.terminal_keys import keys
from smooth_operator.teleop.runtime.loop import TeleopLoop

STOP_KEYS: Final = (" ", "\x1b", "x", "X")
"""Each always stops, whatever the robot does; no other key does."""
WORDS: Final = (
    "space, Esc or x: EMERGENCY STOP   u: release it   p: pause / resume   c: wrist   q: end"
)


def actions(
    loop: TeleopLoop, say: Callable[[str], None], more: Mapping[str, Callable[[], None]] = {}
) -> dict[str, Callable[[], None]]:
    """Key -> what it does.

    What the robot does may be changed from the page or by another program, too, so nothing is
    remembered here: a stop is always asked for, and the rest asks the supervisors.

    Args:
        loop: the running loop.
        say: takes a line for the person at the keys.
        more: other keys.
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
    said: Reporter,
    more: Mapping[str, Callable[[], None]] = {},
    words: str = "",
) -> Iterator[None]:
    """Listens to the keys while the loop runs, where there is a terminal.

    Args:
        loop: the running loop.
        said: where lines for the person at the keys go.
        more: other keys.
        words: what those do.
    """
    with keys(actions(loop, lambda text: said.note(text, matters=True), more)) as there:
        if there:
            said.note(WORDS + words)
        yield
