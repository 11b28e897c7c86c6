"""The process of the live page, which the process of the loop starts."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
import warnings
from collections import deque
from importlib import resources
from typing import IO, Any, Final

import viser

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hand_files.vendor_model import hand_with_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.signals import leave_to_parent
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.live.live_panel import LivePanel
from smooth_operator.teleop.pages.live.live_scene import LiveScene
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
                self._server, hands, link.do, self._scene, None if setup["blind"] else self.download
            )
        keys = resources.files(__package__).joinpath("stop_keys.js").read_text("utf-8")
        run_script(self._server, keys)
        self._server.on_client_connect(self._greet)
        self._server.on_client_disconnect(self._forget)
        self._pace = Pace(self._server)
        self._drawn: tuple[dict[Side, HandView], str] | None = None
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
            configuration, self._configuration_wanted = self._configuration_wanted, False
            text = watched and begun >= next_text
            state = self._link.look(
                text=text,
                settings=self._panel.settings_number,
                scenery=self._scene.scenery_number,
                configuration=configuration,
            )
            if watched:
                self._show_meshes()
                self._draw(state)
            if configuration:
                self._server.send_file_download(
                    "configuration.json", state["configuration"].encode(), save_immediately=True
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
            self._drawn = views, ""
        except (SmoothOperatorError, ValueError, IndexError, ArithmeticError) as error:
            self._drawn = {}, f"simple shapes are drawn: {error}"
        self._wake.set()

    def _show_meshes(self) -> None:
        """Draw the meshes from now on, when they are read."""
        if self._drawn is not None:
            (views, note), self._drawn = self._drawn, None
            with self._server.atomic():
                self._scene.add_meshes(views)
                self._panel.show_meshes(bool(views), note)

    def _draw(self, state: dict[str, Any]) -> None:
        """Send what has changed; to a slow browser in two steps, see ``Pace``."""
        with self._server.atomic():
            self._scene.draw_lines(state["hands"])
            self._panel.show(state, self._pace.delay)
        if self._pace.slow:
            self._server.flush()
            self._pace.wait()
        with self._server.atomic():
            self._scene.draw_bodies(state["hands"])
            if "scenery" in state:
                self._scene.draw_scenery(state["scenery"])
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


class LoopEnded(Exception):
    """Nobody answers any more: the loop's process has closed the pipe, or is gone."""


class Link:
    """Asks the loop's process what to show, and sends it what was clicked.

    Args:
        incoming: answers.
        outgoing: questions and clicks; from any thread.
    """

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._in, self._out = incoming, outgoing
        self._writing = threading.Lock()

    def hear(self) -> dict[str, Any]:
        """The next answer.

        Raises:
            LoopEnded: there is none.
        """
        line = self._in.readline()
        if not line:
            raise LoopEnded
        answer: dict[str, Any] = json.loads(line)
        return answer

    def say(self, message: dict[str, Any]) -> None:
        """Send a message.

        Raises:
            LoopEnded: nobody listens.
        """
        try:
            with self._writing:
                self._out.write(json.dumps(message).encode() + b"\n")
                self._out.flush()
        except OSError as error:
            raise LoopEnded from error

    def do(self, name: str, *values: Any) -> None:
        """Have something done; a click into the void does nothing."""
        try:
            self.say({"do": [name, *values]})
        except LoopEnded:
            return

    def look(
        self, *, text: bool, settings: int, scenery: int, configuration: bool = False
    ) -> dict[str, Any]:
        """The state to show; see ``LiveSession.look``."""
        request = {"text": text, "settings": settings, "scenery": scenery}
        self.say({"look": request, "configuration": configuration})
        return self.hear()


_FASTEST_S: Final = 1 / 30
_SLOWEST_S: Final = 1.0
_LATE_S: Final = 0.1
_RECENT: Final = 12  # questions; the slowest answer counts
_SETTLE: Final = 3  # pictures of a slow browser in which it shows nothing else
_EVERY_S: Final = 0.3  # between two questions
_PATIENCE_S: Final = 2.0


class Pace:
    """Occasionally asks each browser for a message, and measures how long the answer takes.

    Browsers handle messages in order, so a browser that can't keep up answers late. What it has
    not shown yet would grow without bound otherwise, and a page that is seconds late is dangerous.

    viser's page puts poses of nodes into its next picture and all other changes into the one
    after, and draws no further picture once 250 ms are over. Where a picture takes longer, bodies
    and lines on it are of different moments. So a slow browser gets the lines first, and the bodies
    one picture later.

    Args:
        server: whose browsers they are.

    Attributes:
        period: least time between two drawn frames [s].
        delay: how late the slowest browser shows what it is sent, at worst in the last few
            seconds [s]; the time of one picture varies a lot without a graphics card.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.period, self.delay = _FASTEST_S, 0.0
        self._server = server
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._thread = threading.Thread(target=self._run, name="pace", daemon=True)
        self._thread.start()

    @property
    def slow(self) -> bool:
        """True if what belongs together has to be sent in two steps, with a ``wait`` between
        them."""
        return self.delay >= _LATE_S

    def wait(self) -> None:
        """Until all browsers have handled what they were sent; two seconds at most for each."""
        for client in self._server.get_clients().values():
            _round_trip(client)

    def _run(self) -> None:
        while True:
            time.sleep(_EVERY_S)
            clients = list(self._server.get_clients().values())
            slowest = max((_round_trip(client) for client in clients), default=0.0)
            self._recent.append(slowest)
            self.period, self.delay = period_for(slowest), max(self._recent)


def period_for(delay: float) -> float:
    """Least time between two drawn frames for a browser that shows them so late [s]."""
    period = delay if delay < _LATE_S else _SETTLE * delay
    return min(max(_FASTEST_S, period), _SLOWEST_S)


def _round_trip(client: Any) -> float:
    """Until a browser has handled all that it was sent before now [s]; 0 if it has left."""
    start = time.monotonic()
    try:
        client.local_storage.get_item("pace", timeout=_PATIENCE_S)
    except TimeoutError:
        return _PATIENCE_S
    except RuntimeError:  # it has left, or keeps no such things, and says so
        pass
    return time.monotonic() - start


if __name__ == "__main__":
    main()
