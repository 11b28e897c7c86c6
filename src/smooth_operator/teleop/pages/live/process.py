"""The process of the live page, which the process of the loop starts."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import warnings
from importlib import resources
from typing import Any, Final

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hand_files.menagerie import hand_with_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.signals import leave_to_parent
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.live.live_panel import LivePanel
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.pace import Pace
from smooth_operator.teleop.pages.live.page_link import Link, LoopEnded
from smooth_operator.teleop.pages.viser_server import open_server, page_url, run_script
from smooth_operator.types import Side

_TEXT_S: Final = 0.25  # between two updates of text, which costs a browser more than poses [s]
_IDLE_S: Final = 0.5  # while nobody watches
_NICE: Final = 5
"""The loop goes first; the page still gets its share on a busy machine."""


def main() -> None:
    """Serves the page until the loop's process closes the pipe."""
    # What a library prints must not get between the messages.
    outgoing = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    # viser warns of each message to a browser that has just left, which happens
    warnings.filterwarnings("ignore", message="Queued a", category=UserWarning)
    leave_to_parent()
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    link = Link(sys.stdin.buffer, outgoing)
    with contextlib.suppress(LoopEnded):
        try:
            page = _Page(link.hear(), link)
        except SmoothOperatorError as error:
            link.say({"failed": str(error)})
            return
        with contextlib.suppress(LoopEnded):
            page.run()
        # The system closes the port now. viser would wait for its browsers and threads, for
        # seconds on a busy machine, and the run does not end before this process.
        os._exit(0)


class _Page:
    """Scene and panel on a server, drawn by one thread."""

    def __init__(self, setup: dict[str, Any], link: Link) -> None:
        self._link = link
        self._wake = threading.Event()
        self._configuration_wanted = False
        hands = {
            side: load_hand(setup["hand"], side, fingers=setup["fingers"])
            for side in setup["sides"]
        }
        self._server = open_server(setup["host"], setup["port"])
        with self._server.atomic():
            if not setup["details"]:
                self._server.scene.configure_environment_map(None)
            arm = None if setup["arm"] is None else ArmSettings(**setup["arm"])
            self._scene = LiveScene(self._server, hands, setup["simulated"], arm=arm)
            self._panel = LivePanel(
                self._server, hands, link, self._scene, None if setup["blind"] else self.download
            )
        keys = resources.files(__package__).joinpath("stop_keys.js").read_text("utf-8")
        run_script(self._server, keys)
        self._server.on_client_connect(self._greet)
        self._server.on_client_disconnect(self._forget)
        self._pace = Pace(self._server)
        self._found: tuple[dict[Side, HandView], str] | None = None
        if setup["meshes"]:
            threading.Thread(
                target=self._find_meshes, args=(hands, setup["model"]), name="meshes", daemon=True
            ).start()
        link.say({"url": page_url(setup["host"], self._server)})

    def run(self) -> None:
        """Draw until the loop ends."""
        next_text = 0.0
        while True:
            begun = time.monotonic()
            watched = bool(self._server.get_clients())
            wanted, self._configuration_wanted = self._configuration_wanted, False
            text = watched and begun >= next_text
            seen = self._link.look(
                text=text,
                fields=self._panel.fields_number,
                scenery=self._scene.scenery_number,
                picture=self._panel.picture_number if watched else None,
                configuration=wanted,
            )
            if watched:
                self._show_meshes()
                self._draw(seen)
            if wanted:
                self._server.send_file_download(
                    "configuration.json", seen["configuration"].encode(), save_immediately=True
                )
            if text:
                next_text = begun + _TEXT_S
            spent = time.monotonic() - begun
            # At most half of a core, whatever the machine: a slow one draws less often.
            self._wake.wait(max(self._pace.period - spent, spent) if watched else _IDLE_S)
            self._wake.clear()

    def _find_meshes(self, hands: dict[Side, Hand], model: str | None) -> None:
        """Read the hands' meshes, which takes seconds; the page shows simple shapes until then."""
        try:
            there = {side: hand_with_meshes(hand, model) for side, hand in hands.items()}
            views = {side: HandView(hand) for side, hand in there.items() if hand is not None}
            self._found = views, ""
        except (SmoothOperatorError, ValueError, IndexError, ArithmeticError) as error:
            self._found = {}, f"simple shapes are drawn: {error}"
        self._wake.set()

    def _show_meshes(self) -> None:
        """Draw the meshes from now on, when they are read."""
        if self._found is not None:
            (views, note), self._found = self._found, None
            with self._server.atomic():
                self._scene.add_meshes(views)
                self._panel.show_meshes(bool(views), note)

    def _draw(self, seen: dict[str, Any]) -> None:
        """Send what has changed; to a slow browser in two steps, see ``Pace``."""
        with self._server.atomic():
            self._scene.draw_lines(seen["hands"])
            self._panel.show(seen, self._pace.delay)
        if self._pace.slow:
            self._server.flush()
            self._pace.wait()
        with self._server.atomic():
            self._scene.draw_bodies(seen["hands"])
            if "scenery" in seen:
                self._scene.draw_scenery(seen["scenery"])
        self._server.flush()

    def download(self) -> None:
        """Have the configuration sent to all browsers."""
        self._configuration_wanted = True
        self._wake.set()

    async def _greet(self, client: Any) -> None:
        self._scene.aiming.greet(client)
        self._wake.set()

    async def _forget(self, client: Any) -> None:
        self._scene.aiming.forget(client)


if __name__ == "__main__":
    main()
