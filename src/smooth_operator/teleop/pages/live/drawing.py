"""Scene and panel of the live page on its server, at the pace of the slowest browser."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import viser

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hand_files.vendor_model import hand_with_meshes
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.methods.registry import DEFAULT_METHOD
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.live import live_texts
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.viser_server import (
    add_hotkeys,
    from_person,
    name_panel,
    name_tab,
    plain,
    run_script,
)
from smooth_operator.teleop.recording.take_quality import TakeQuality, take_quality
from smooth_operator.types import Side

if TYPE_CHECKING:
    from smooth_operator.teleop.pages.live.live_page import Link


_STOP: Final = "EMERGENCY STOP\nSpace, Esc or X"
_STOPPED: Final = "STOPPED\nrelease it below"


class LivePanel:
    """Builds the controls and shows what the loop sends.

    Args:
        server: where to build.
        hands: side -> robot hand.
        do: sends the loop's process an action's name and values.
        scene: whose switches stand in the panel.
        blind: the operator is not to know the method: nothing shows or changes it.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        hands: Mapping[Side, Hand],
        do: Callable[..., None],
        scene: LiveScene,
        blind: bool = False,
    ) -> None:
        self._do, self._scene = do, scene
        self._operators: Mapping[str, Any] | None = None
        self._stopped = self._paused = self._released = False
        self._hands = hands
        self._take: Mapping[str, Any] = {}
        self._quality: Sequence[TakeQuality] | str = ""
        gui = server.gui
        hand = next(iter(hands.values()))
        self._fingers, self._hand_name = hand.fingers, hand.name
        name_panel(gui, hand.name)
        self._build_main(gui)
        panel = gui.add_panel()
        with panel.add_tab("Timing"):
            self._timing = gui.add_html("")
        if not blind:
            with panel.add_tab("Method"):
                self._build_method(gui)
        with panel.add_tab("View"):
            self._build_view(gui)
        gui.main_panel.dock_right()
        panel.dock_below(gui.main_panel)

    def show(self, state: Mapping[str, Any], delay: float = 0.0) -> None:
        """Show what the loop sends.

        Args:
            state: result of ``LiveSession.look``.
            delay: delay of the slowest browser [s].
        """
        self._modes.content = live_texts.modes(state["hands"])
        wrists = [hand.get("wrist") for hand in state["hands"].values()]
        self._released = any(wrist is not None and wrist["released"] for wrist in wrists)
        shown = live_texts.trial(state.get("trial"))
        if shown != self._trial.content:
            self._trial.content = shown
            self._trial.visible = bool(shown)
        if "status" in state:
            self._summary.content = live_texts.summary(state["status"])
            self._timing.content = live_texts.timing(state["status"])
            self._legend.content = live_texts.legend(
                self._fingers, self._scene.simulated, self._scene.has_task
            )
            self._slow.content = live_texts.slow(delay)
            self._slow.visible = bool(self._slow.content)
            self._show_controls(state["controls"])

    # -- building -----------------------------------------------------------------------------

    def _build_main(self, gui: viser.GuiApi) -> None:
        do = self._do
        self._stop = gui.add_button(_STOP, color="red", icon=viser.Icon.HAND_STOP)
        self._release = gui.add_button(
            "Release the stop (U)", color="orange", icon=viser.Icon.LOCK_OPEN, visible=False
        )
        style = resources.files(__package__).joinpath("live_page.css").read_text("utf-8")
        gui.add_html(f"<style>{style}</style>")
        self._trial = gui.add_html("", visible=False)
        self._modes = gui.add_html(live_texts.modes({}))
        self._pause = gui.add_button("Pause (P)", icon=viser.Icon.PLAYER_PAUSE)
        self._record = gui.add_button("Record (R)", color="gray", icon=viser.Icon.PLAYER_RECORD)
        self._name = gui.add_text(
            "Name", "", visible=False, hint="of the take; Space and X stop the robot here, too"
        )
        self._keep = gui.add_button("Keep", icon=viser.Icon.CHECK, visible=False)
        self._discard = gui.add_button(
            "Discard", color="gray", icon=viser.Icon.TRASH, visible=False
        )
        self._take_text = gui.add_html("", visible=False)
        self._summary = gui.add_html("")
        self._slow = gui.add_html("", visible=False)
        self._notice = gui.add_html("")
        self._legend = gui.add_html("")
        self._stop.on_click(from_person(lambda _: do("stop")))
        self._release.on_click(from_person(lambda _: do("release")))
        self._pause.on_click(from_person(lambda _: self._toggle_pause()))
        self._record.on_click(from_person(lambda _: do("record")))
        self._keep.on_click(from_person(lambda _: do("keep", self._name.value)))
        self._discard.on_click(from_person(lambda _: do("discard")))
        # Space and Esc come as X, from the script of the page (live_page.js)
        add_hotkeys(
            gui,
            ("Emergency stop", "X", lambda: do("stop")),
            ("Release the stop", "U", lambda: do("release")),
            ("Pause / resume", "P", self._toggle_pause),
            ("Wrist: release / engage", "C", lambda: do("follow", self._released)),
            ("Record / end the recording", "R", lambda: do("record")),
        )

    def _build_method(self, gui: viser.GuiApi) -> None:
        do = self._do
        self._hand = gui.add_dropdown(
            "Hand", (self._hand_name,), visible=False, hint="the run begins again with it"
        )
        self._hand.on_update(from_person(lambda event: do("hand", event.target.value)))
        # until the loop says what it runs
        self._method = gui.add_dropdown("Method", (DEFAULT_METHOD,))
        self._preset = gui.add_dropdown("Preset", ("default",))
        self._method.on_update(from_person(lambda event: do("method", event.target.value)))
        self._preset.on_update(
            from_person(lambda event: do("method", self._method.value, event.target.value))
        )

    def _build_view(self, gui: viser.GuiApi) -> None:
        scene = self._scene
        overlay = gui.add_checkbox("Overlay", False, hint="human inside robot")
        vectors = gui.add_checkbox("Keyvectors", True, hint="thumb tip to fingertips")
        overlay.on_update(from_person(lambda event: scene.set_overlay(event.target.value)))
        vectors.on_update(from_person(lambda event: scene.set_keyvectors(event.target.value)))
        self._meshes_box = gui.add_checkbox(
            "Meshes", True, hint="the maker's, or simple shapes", visible=False
        )
        self._meshes_box.on_update(from_person(lambda event: scene.set_meshes(event.target.value)))
        if scene.simulated:
            own = gui.add_checkbox("Own hand at a task", False, hint="as tracked")
            own.on_update(from_person(lambda event: scene.set_own(event.target.value)))
            simulated = gui.add_checkbox("Simulated hand", True, hint="see-through, where it is")
            simulated.on_update(from_person(lambda event: scene.set_simulated(event.target.value)))
        view = gui.add_button("Reset view", color="gray", icon=viser.Icon.FOCUS_CENTERED)
        view.on_click(from_person(lambda event: scene.aiming.aim(event.client)))

        self._meshes_note = gui.add_markdown("", visible=False)

    # -- showing ------------------------------------------------------------------------------

    def _toggle_pause(self) -> None:
        """Pauses or resumes; does nothing in an emergency stop, which only a release ends."""
        if not self._stopped:
            self._do("resume" if self._paused else "pause")

    def show_meshes(self, there: bool, note: str) -> None:
        """Show whether the hand's meshes can be drawn, and if not, why."""
        self._meshes_box.visible = there
        self._meshes_note.content = plain(note)
        self._meshes_note.visible = bool(note)

    def _show_controls(self, controls: Mapping[str, Any]) -> None:
        self._notice.content = live_texts.notice(controls)
        self._stopped, self._paused = controls["stopped"], controls["paused"]
        self._stop.label = _STOPPED if self._stopped else _STOP
        self._stop.color = "dark" if self._stopped else "red"
        self._release.visible = self._pause.disabled = self._stopped
        self._pause.label = "Resume (P)" if self._paused else "Pause (P)"
        self._pause.icon = viser.Icon.PLAYER_PLAY if self._paused else viser.Icon.PLAYER_PAUSE
        self._show_take(controls["take"])
        if controls["operators"] != self._operators:
            self._operators = controls["operators"]
            self._scene.set_operators(controls["operators"])
        if "hands" in controls:
            self._hand.visible = True
            _choose(self._hand, controls["hands"], self._hand_name)
        if "method" in controls:
            presets = controls["presets"]
            _choose(self._method, list(presets), controls["method"])
            _choose(self._preset, presets[controls["method"]], controls["preset"])

    def _show_take(self, take: Mapping[str, Any]) -> None:
        """The take that is recorded or the last one, and what can be done about it."""
        self._record.label = "End recording (R)" if take["recording"] else "Record (R)"
        self._record.color = "red" if take["recording"] else "gray"
        if take["last"] != self._take.get("last"):
            self._quality = "its quality is measured …" if take["last"] else ""
            self._name.value = ""  # type: ignore[misc]  # it has a setter
            if take["last"]:
                threading.Thread(target=self._measure, args=(take["last"],), daemon=True).start()
        self._take = take
        self._take_text.content = live_texts.take(take, self._quality)
        self._take_text.visible = bool(self._take_text.content)
        for handle in (self._name, self._keep, self._discard):
            handle.visible = take["open"]

    def _measure(self, files: Sequence[str]) -> None:
        """Measure a take, for seconds; in this process, which does not slow the loop down."""
        try:
            quality: Sequence[TakeQuality] | str = [
                take_quality(Path(file), _hand_of(file, self._hands)) for file in files
            ]
        except SmoothOperatorError as error:
            quality = f"its quality can't be measured: {error}"
        if files == self._take.get("last"):
            self._quality = quality


def _hand_of(file: str, hands: Mapping[Side, Hand]) -> Hand:
    """The hand that a file of a take is of, by its name where there are two."""
    own = [hand for side, hand in hands.items() if f".{side}." in Path(file).name]
    return (own or list(hands.values()))[0]


def _choose(dropdown: Any, options: list[str], value: str) -> None:
    """Set a dropdown's options and its choice; a file that stands for a preset is one more."""
    options = options if value in options else [*options, value]
    if tuple(dropdown.options) != tuple(options):
        dropdown.options = tuple(options)
    if dropdown.value != value:
        dropdown.value = value


_TEXT_S: Final = 0.25  # between two updates of text, which costs a browser more than poses [s]
_IDLE_S: Final = 0.5  # while nobody watches


class LiveDrawing:
    """Scene and panel on a server, drawn by one thread.

    Args:
        server: where to draw.
        link: to the loop's process.
        setup: a ``PageSetup`` as JSON values.

    Raises:
        SmoothOperatorError: the hand can't be read.
    """

    def __init__(self, server: viser.ViserServer, link: Link, setup: Mapping[str, Any]) -> None:
        self._server, self._link = server, link
        self._wake = threading.Event()
        self._build(setup)
        script = resources.files(__package__).joinpath("live_page.js").read_text("utf-8")
        run_script(self._server, script)
        self._server.on_client_connect(self._greet)
        self._server.on_client_disconnect(self._forget)
        self._pace = Pace(self._server)

    def _build(self, setup: Mapping[str, Any]) -> None:
        """Puts scene and panel of a setup on the page, in the place of what is there."""
        hands = {
            side: load_hand(setup["hand"], side, fingers=setup["fingers"])
            for side in setup["sides"]
        }
        name_tab(self._server, f"{next(iter(hands.values())).name} live – smooth-operator")
        with self._server.atomic():
            self._server.scene.reset()
            self._server.gui.reset()
            if not setup["details"]:
                self._server.scene.configure_environment_map(None)
            arm = None if setup["arm"] is None else ArmSettings(**setup["arm"])
            self._scene = LiveScene(self._server, hands, setup["simulated"], arm=arm)
            self._panel = LivePanel(self._server, hands, self._link.do, self._scene, setup["blind"])
        for client in self._server.get_clients().values():
            self._scene.aiming.greet(client)
        self._hands = hands
        self._drawn: tuple[dict[Side, HandView], str] | None = None
        if setup["meshes"]:
            threading.Thread(
                target=self._find_meshes, args=(hands, setup["model"]), name="meshes", daemon=True
            ).start()

    def run(self) -> None:
        """Draw until the loop ends."""
        next_text = 0.0
        while True:
            begun = time.monotonic()
            watched = bool(self._server.get_clients())
            text = watched and begun >= next_text
            state = self._link.look(text=text, scenery=self._scene.scenery_number)
            if "setup" in state:
                self._build(state["setup"])
                continue
            if watched:
                self._show_meshes()
                self._draw(state)
            if text:
                next_text = begun + _TEXT_S
            spent = time.monotonic() - begun
            if watched:
                self._pace.wait()
            # At most half of a core, whatever the machine: a slow one draws less often.
            rest = max(begun + _FASTEST_S - time.monotonic(), spent) if watched else _IDLE_S
            self._wake.wait(rest)
            self._wake.clear()

    def _find_meshes(self, hands: dict[Side, Hand], model: str | None) -> None:
        """Read the hands' meshes, which takes seconds; the page shows simple shapes until then."""
        try:
            there = {side: hand_with_meshes(hand, model) for side, hand in hands.items()}
            views = {side: HandView(hand) for side, hand in there.items() if hand is not None}
            drawn: tuple[dict[Side, HandView], str] = views, ""
        except (SmoothOperatorError, ValueError, IndexError, ArithmeticError) as error:
            drawn = {}, f"simple shapes are drawn: {error}"
        if hands is self._hands:  # not another hand by now
            self._drawn = drawn
            self._wake.set()

    def _show_meshes(self) -> None:
        """Draw the meshes from now on, when they are read."""
        if self._drawn is not None:
            (views, note), self._drawn = self._drawn, None
            with self._server.atomic():
                self._scene.add_meshes(views)
                self._panel.show_meshes(bool(views), note)

    def _draw(self, state: dict[str, Any]) -> None:
        """Send all that has changed, as one update."""
        with self._server.atomic():
            self._panel.show(state, self._pace.delay)
            self._scene.draw(state["hands"])
            if "scenery" in state:
                self._scene.draw_scenery(state["scenery"])
        self._server.flush()

    async def _greet(self, client: Any) -> None:
        self._scene.aiming.greet(client)
        self._wake.set()

    async def _forget(self, client: Any) -> None:
        self._scene.aiming.forget(client)


_FASTEST_S: Final = 1 / 30
"""Least time between two drawn frames [s]."""
_RECENT_S: Final = 4.0
_PATIENCE_S: Final = 2.0


class Pace:
    """Waits until the browsers have handled a frame, so that at most one is on its way.

    Browsers handle messages in order, so one that can't keep up answers late. What it has not shown
    yet would grow without bound otherwise, and a page that is seconds late is dangerous: frames in
    between are never sent to it.

    Args:
        server: whose browsers they are.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._recent: deque[tuple[float, float]] = deque()

    @property
    def delay(self) -> float:
        """Time that the slowest browser took for a frame, at worst in the last few seconds [s]; the
        time of one picture varies a lot without a graphics card."""
        return max((seconds for _, seconds in self._recent), default=0.0)

    def wait(self) -> None:
        """Until all browsers have handled what they were sent; two seconds at most for each."""
        clients = list(self._server.get_clients().values())
        slowest = max((_round_trip(client) for client in clients), default=0.0)
        now = time.monotonic()
        self._recent.append((now, slowest))
        while self._recent[0][0] < now - _RECENT_S:
            self._recent.popleft()


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
