"""Draws the live page, no faster than the slowest browser can follow."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import viser

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hand_files.vendor_model import hand_with_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.pages.front import GuardedServer
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.live.live_panel import LivePanel
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.viser_server import name_tab
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.teleop.pages.live.live_page import LoopLink
    from smooth_operator.teleop.pages.live.stop_panel import StopPanel


_TEXT_S: Final = 0.25  # period of the text, which takes a browser longer than poses [s]
_IDLE_S: Final = 0.5  # period without a browser [s]


class LiveDrawing:
    """Draws the scene and the control panel of the live page from one thread.

    Args:
        server: server of the page.
        link: link to the loop's process.
        setup: a ``PageSetup`` as JSON values.
        stop: the emergency stop, which is already on the page.

    Raises:
        SmoothOperatorError: the hand can't be read.
    """

    def __init__(
        self,
        server: GuardedServer,
        link: LoopLink,
        setup: Mapping[str, Any],
        stop: StopPanel,
    ) -> None:
        self._server, self._link, self._stop = server, link, stop
        self._wake = threading.Event()
        self._builds = 0
        self._trouble = ""
        # Not in one update: it takes seconds, in which no browser would get the stop.
        hands = self._hands_of(setup)
        self._scene = self._built(setup, hands)
        self._panel = LivePanel(
            server, hands, link.do, self._scene, stop, setup["blind"], setup["keys"]
        )
        self._see(setup, hands)
        self._server.on_client_connect(self._greet)
        self._server.on_client_disconnect(self._forget)
        self._pace = Pace(self._server)

    def _change(self, setup: Mapping[str, Any]) -> None:
        """Replaces the hands with those of another setup."""
        hands = self._hands_of(setup)
        with self._server.atomic():
            self._scene.remove()
            self._scene = self._built(setup, hands)
            self._panel.change_hands(hands, self._scene)
        self._see(setup, hands)

    def _hands_of(self, setup: Mapping[str, Any]) -> dict[Side, Hand]:
        return {
            side: load_hand(setup["hand"], side, fingers=setup["fingers"])
            for side in setup["sides"]
        }

    def _built(self, setup: Mapping[str, Any], hands: dict[Side, Hand]) -> LiveScene:
        name_tab(self._server, f"{next(iter(hands.values())).name} live – smooth-operator")
        if not setup["details"]:
            self._server.scene.configure_environment_map(None)
        arm = None if setup["arm"] is None else ArmSettings(**setup["arm"])
        # A browser keeps the pose of a removed node for the next node with its name, so each scene
        # has names of its own.
        self._builds += 1
        return LiveScene(self._server, hands, setup["simulated"], arm=arm, root=f"/{self._builds}")

    def _see(self, setup: Mapping[str, Any], hands: dict[Side, Hand]) -> None:
        """Aims the cameras at the hands, and starts to read their meshes."""
        for client in self._server.get_clients().values():
            self._scene.aiming.greet(client)
        self._hands = hands
        self._drawn: tuple[dict[Side, HandView], str] | None = None
        if setup["meshes"]:
            threading.Thread(
                target=self._find_meshes, args=(hands, setup["model"]), name="meshes", daemon=True
            ).start()

    def run(self) -> None:
        """Draws until the loop ends."""
        next_text = 0.0
        while True:
            begun = time.monotonic()
            watched = bool(self._server.get_clients())
            text = watched and begun >= next_text
            state = self._link.look(
                text=text, scenery=self._scene.scenery_number, pictures=self._panel.pictures
            )
            try:
                if "setup" in state:
                    self._change(state["setup"])
                elif watched:
                    self._show_meshes()
                    self._draw(state)
            except Exception as error:  # the page must go on because of its stop
                trouble = f"the page can't draw the run: {type(error).__name__}: {error}"
                if trouble != self._trouble:
                    self._trouble = trouble
                    print_note(f"note: {trouble}")
                self._panel.show({"trouble": trouble})
            if text:
                next_text = begun + _TEXT_S
            spent = time.monotonic() - begun
            if watched:
                self._pace.wait()
            # Use at most half of a core: a slow machine draws less often.
            rest = max(begun + _FASTEST_S - time.monotonic(), spent) if watched else _IDLE_S
            self._wake.wait(rest)
            self._wake.clear()

    def _find_meshes(self, hands: dict[Side, Hand], model: str | None) -> None:
        """Reads the hands' meshes, which takes seconds; meanwhile the page shows simple shapes."""
        try:
            there = {side: hand_with_meshes(hand, model) for side, hand in hands.items()}
            views = {side: HandView(hand) for side, hand in there.items() if hand is not None}
            drawn: tuple[dict[Side, HandView], str] = views, ""
        except (SmoothOperatorError, ValueError, IndexError, ArithmeticError) as error:
            drawn = {}, f"the meshes can't be drawn, so simple shapes are shown: {error}"
        if hands is self._hands:  # the page has no other hand since
            self._drawn = drawn
            self._wake.set()

    def _show_meshes(self) -> None:
        """Draws the meshes once they have been read."""
        if self._drawn is not None:
            (views, note), self._drawn = self._drawn, None
            with self._server.atomic():
                self._scene.add_meshes(views)
                self._panel.show_meshes(bool(views), note)

    def _draw(self, state: dict[str, Any]) -> None:
        """Sends all changes as one update."""
        with self._server.atomic():
            self._panel.show(state, self._pace.delay)
            self._scene.draw(state.get("hands", {}))
            if "scenery" in state:
                self._scene.draw_scenery(state["scenery"])
        self._server.flush()

    async def _greet(self, client: Any) -> None:
        self._scene.aiming.greet(client)
        self._wake.set()

    async def _forget(self, client: Any) -> None:
        self._scene.aiming.forget(client)


_FASTEST_S: Final = 1 / 30  # shortest time between two drawn frames [s]
_RECENT_S: Final = 4.0  # time over which the delay is measured [s]
_PATIENCE_S: Final = 2.0  # longest wait for one browser [s]


class Pace:
    """Waits until the browsers have processed a frame, so that at most one frame is in transit.

    Browsers handle messages in order. Without the wait, a slow browser would lag more and more, and
    a page that is seconds late is dangerous.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._recent: deque[tuple[float, float]] = deque()

    @property
    def delay(self) -> float:
        """Longest time that the slowest browser took for a frame in the last few seconds [s]."""
        return max((seconds for _, seconds in self._recent), default=0.0)

    def wait(self) -> None:
        """Waits for all browsers, at most two seconds for each."""
        clients = list(self._server.get_clients().values())
        slowest = max((_round_trip(client) for client in clients), default=0.0)
        now = time.monotonic()
        self._recent.append((now, slowest))
        while self._recent[0][0] < now - _RECENT_S:
            self._recent.popleft()


def _round_trip(client: Any) -> float:
    """Waits until a browser has handled all messages; returns the time this took [s], 0 if it has
    disconnected."""
    start = time.monotonic()
    try:
        client.local_storage.get_item("pace", timeout=_PATIENCE_S)
    except TimeoutError:
        return _PATIENCE_S
    except RuntimeError:  # it has left, or has no such storage and answers so
        pass
    return time.monotonic() - start
