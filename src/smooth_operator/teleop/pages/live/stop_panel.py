"""Emergency stop of the live page: buttons, keys, and a warning when the stop can't work.

It needs nothing but viser, so it is on the page before the hand has been read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import viser

from smooth_operator.teleop.control.bindings import DEFAULT_KEYS, label_of
from smooth_operator.teleop.pages.front import ALIVE_PATH, GuardedServer
from smooth_operator.teleop.pages.live.live_page import LOADING
from smooth_operator.teleop.pages.viser_server import (
    add_hotkeys,
    from_person,
    read_script,
)

_STOP: Final = "EMERGENCY STOP\nSpace, Esc or X"
_KEYS: Final = "To stop, press Space, Esc or X in the terminal where teleop runs."
_NO_KEYS: Final = "To stop, press Ctrl-C in the terminal where teleop runs."


class StopPanel:
    """Emergency stop buttons and keys, placed above all later elements of the page.

    Args:
        server: server of the page.
        do: sends ``stop`` or ``release`` to the loop's process.
        attended: True if the terminal of the run accepts keys.
        keys: action -> its keys.
    """

    def __init__(
        self,
        server: GuardedServer,
        do: Callable[[str], None],
        *,
        attended: bool,
        keys: Mapping[str, Sequence[str]] = DEFAULT_KEYS,
    ) -> None:
        gui = server.gui
        self._do = do
        self._stopped = f"STOPPED\nRelease it below{label_of(keys, 'release')}"
        self._stop = gui.add_button(_STOP, color="red", icon=viser.Icon.HAND_STOP)
        self._release = gui.add_button(
            f"Release the stop{label_of(keys, 'release')}",
            color="orange",
            icon=viser.Icon.LOCK_OPEN,
            visible=False,
        )
        style = read_script(__package__, "live_page.css")
        elsewhere = _KEYS if attended else _NO_KEYS
        self._state = gui.add_html(f"{LOADING} …")
        self._alone = True
        gui.add_html(f'<style>{style}</style><span id="live-elsewhere" hidden>{elsewhere}</span>')
        self._stop.on_click(from_person(lambda _: self._press("stop")))
        self._release.on_click(from_person(lambda _: self._press("release")))
        # ``stop_keys.js`` sends Space and Esc as X.
        stops = [key for key in keys["stop"] if key not in ("space", "escape")]
        add_hotkeys(
            gui,
            *(("Emergency stop", key, lambda: self._press("stop")) for key in stops),
            *(("Release the stop", key, lambda: self._press("release")) for key in keys["release"]),
        )
        for name in ("stop_keys.js", "connection.js", "contact_sound.js"):
            script = read_script(__package__, name)
            server.front.scripts.append(script.replace("ALIVE_PATH", ALIVE_PATH))

    def show(self, stopped: bool) -> None:
        """Shows whether an emergency stop is holding the robot."""
        self._alone = False
        self._show(stopped)

    def _show(self, stopped: bool) -> None:
        self._stop.label = self._stopped if stopped else _STOP
        self._stop.color = "dark" if stopped else "red"
        self._release.visible = stopped
        self._state.content = "<i data-stopped></i>" if stopped else ""

    def _press(self, name: str) -> None:
        self._do(name)
        if self._alone:  # the loop does not show the state yet
            self._show(name == "stop")
