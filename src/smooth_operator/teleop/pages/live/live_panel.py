"""Control panel of the live page, which also shows the state of the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import viser

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.teleop.control.bindings import ACTIONS, DEFAULT_KEYS, label_of
from smooth_operator.teleop.pages.live import live_texts
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.stop_panel import StopPanel
from smooth_operator.teleop.pages.viser_server import add_hotkeys, from_person, name_panel, plain
from smooth_operator.teleop.recording.take_quality import TakeQuality, take_quality
from smooth_operator.types import Side


class LivePanel:
    """Control panel with buttons and texts beside the scene.

    Args:
        server: server of the page.
        hands: side -> robot hand.
        do: sends an action's name and values to the loop's process.
        scene: the scene, which the switches change.
        stop: the emergency stop above the panel.
        blind: hide the method from the operator, who then can't change it.
        keys: action -> its keys.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        hands: Mapping[Side, Hand],
        do: Callable[..., None],
        scene: LiveScene,
        stop: StopPanel,
        blind: bool = False,
        keys: Mapping[str, Sequence[str]] = DEFAULT_KEYS,
    ) -> None:
        self._do, self._scene, self._stop = do, scene, stop
        self._blind = blind
        self._keys = {name: label_of(keys, name) for name in ACTIONS}
        self._take: Mapping[str, Any] = {}
        self._cameras: list[_CameraView] = []
        self._quality: Sequence[TakeQuality] | str = ""
        gui = self._gui = server.gui
        self._set_hands(hands)
        self._build_main(gui, keys)
        panel = gui.add_panel()
        with panel.add_tab("Timing"):
            self._timing = gui.add_html("")
        if not blind:
            with panel.add_tab("Method"):
                self._build_method(gui)
        with panel.add_tab("View"):
            self._build_view(gui)
        panel.dock_below(gui.main_panel)

    def change_hands(self, hands: Mapping[Side, Hand], scene: LiveScene) -> None:
        """Shows other hands. The selected tab and the switches stay as they are."""
        self._scene = scene
        self._set_hands(hands)
        self.show_meshes(False, "")
        scene.set_overlay(self._overlay.value)
        scene.set_keyvectors(self._vectors.value)
        scene.set_meshes(self._meshes_box.value)
        if scene.simulated:
            scene.set_own(self._own.value)
            scene.set_simulated(self._simulated.value)

    def _set_hands(self, hands: Mapping[Side, Hand]) -> None:
        self._hands, hand = hands, next(iter(hands.values()))
        self._fingers, self._hand_name = hand.fingers, hand.name
        name_panel(self._gui, hand.name)

    def show(self, state: Mapping[str, Any], delay: float = 0.0) -> None:
        """Shows the state that ``LoopLink.look`` returns, and the delay of the slowest browser
        [s]."""
        if "trouble" in state:
            # an error may name a method
            trouble = "some parts can't be shown" if self._blind else state["trouble"]
            self._show_notice(live_texts.notice("", f"{trouble}; the stop button still works"))
            return
        self._modes.content = live_texts.modes(state["hands"], state.get("notice", ""))
        if "stopped" in state:  # between two loops
            self._stop.show(state["stopped"])
            for handle in (self._summary, self._timing):
                handle.content = ""
        level = live_texts.contact_level(state["hands"]) if self._sound.value else ""
        if level != self._contact.content:
            self._contact.content = level
        shown = live_texts.trial(state.get("trial"))
        if shown != self._trial.content:
            self._trial.content = shown
            self._trial.visible = bool(shown)
        if "cameras" in state:
            self._show_cameras(state["cameras"])
        if "status" in state:
            self._summary.content = live_texts.summary(state["status"])
            self._timing.content = live_texts.timing(state["status"])
            self._legend.content = live_texts.legend(
                self._fingers, self._scene.simulated, self._scene.has_task
            )
            self._slow.content = live_texts.slow(delay)
            self._slow.visible = bool(self._slow.content)
        if "controls" in state:
            self._show_controls(state["controls"])

    def _build_main(self, gui: viser.GuiApi, keys: Mapping[str, Sequence[str]]) -> None:
        do, shown = self._do, self._keys
        self._trial = gui.add_html("", visible=False)
        self._contact = gui.add_html("")
        self._modes = gui.add_html("")
        self._pause = gui.add_button(f"Pause{shown['pause']}", icon=viser.Icon.PLAYER_PAUSE)
        self._record = gui.add_button(
            f"Record{shown['record']}", color="gray", icon=viser.Icon.PLAYER_RECORD
        )
        self._name = gui.add_text(
            "Name",
            "",
            visible=False,
            hint=("name of the take; Space and X also stop the robot while you type"),
        )
        self._keep = gui.add_button(f"Keep{shown['keep']}", icon=viser.Icon.CHECK, visible=False)
        self._discard = gui.add_button(
            f"Discard{shown['discard']}", color="gray", icon=viser.Icon.TRASH, visible=False
        )
        self._take_text = gui.add_html("", visible=False)
        self._summary = gui.add_html("")
        self._slow = gui.add_html("", visible=False)
        self._notice = gui.add_html("", visible=False)
        self._legend = gui.add_html("")
        self._pause.on_click(from_person(lambda _: do("pause")))
        self._record.on_click(from_person(lambda _: do("record")))
        self._keep.on_click(from_person(lambda _: self._do_action("keep")))
        self._discard.on_click(from_person(lambda _: do("discard")))
        add_hotkeys(
            gui,
            *(
                (ACTIONS[name][0] if name in ACTIONS else name, key, partial(self._do_action, name))
                for name, inputs in keys.items()
                if name not in ("stop", "release")  # of the stop panel
                for key in inputs
            ),
        )

    def _build_method(self, gui: viser.GuiApi) -> None:
        do = self._do
        self._hand = gui.add_dropdown(
            "Hand", (self._hand_name,), visible=False, hint="the run restarts with this hand"
        )
        self._hand.on_update(from_person(lambda event: do("hand", event.target.value)))
        # the loop sends the choices later
        self._method = gui.add_dropdown("Method", (DEFAULT_METHOD,))
        self._preset = gui.add_dropdown("Preset", ("default",))
        self._method.on_update(from_person(lambda event: do("method", event.target.value)))
        self._preset.on_update(
            from_person(lambda event: do("method", self._method.value, event.target.value))
        )

    def _build_view(self, gui: viser.GuiApi) -> None:
        def switch(name: str, initial: bool, setter: str, hint: str, visible: bool = True) -> Any:
            """A checkbox that calls a method of the current scene."""
            box = gui.add_checkbox(name, initial, hint=hint, visible=visible)
            box.on_update(
                from_person(lambda event: getattr(self._scene, setter)(event.target.value))
            )
            return box

        self._overlay = switch("Overlay", False, "set_overlay", "human inside robot")
        self._vectors = switch("Keyvectors", True, "set_keyvectors", "thumb tip to fingertips")
        hint = "show the vendor's meshes or simple shapes"
        self._meshes_box = switch("Meshes", True, "set_meshes", hint, visible=False)
        if self._scene.simulated:
            self._own = switch("Own hand at a task", False, "set_own", "as tracked")
            hint = "transparent, in its measured pose"
            self._simulated = switch("Simulated hand", True, "set_simulated", hint)
        self._sound = gui.add_checkbox(
            "Sound of contact",
            False,
            visible=self._scene.simulated,
            hint="when the robot's fingers touch something",
        )
        view = gui.add_button("Reset view", color="gray", icon=viser.Icon.FOCUS_CENTERED)
        view.on_click(from_person(lambda event: self._scene.aiming.aim(event.client)))
        self._meshes_note = gui.add_markdown("", visible=False)

    def _do_action(self, name: str) -> None:
        """Carries out an action of the operator."""
        self._do(name, *([self._name.value] if name == "keep" else []))

    def show_meshes(self, there: bool, note: str) -> None:
        """Shows the switch for meshes, or the reason why there are no meshes."""
        self._meshes_box.visible = there
        self._meshes_note.content = plain(note)
        self._meshes_note.visible = bool(note)

    def _show_controls(self, controls: Mapping[str, Any]) -> None:
        self._show_notice(live_texts.notice(controls["building"], controls["message"]))
        paused = controls["paused"]
        self._stop.show(controls["stopped"])
        self._pause.disabled = controls["stopped"]
        self._pause.label = f"{'Resume' if paused else 'Pause'}{self._keys['pause']}"
        self._pause.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE
        self._show_take(controls["take"])
        if "method" in controls:
            self._hand.visible = True
            _choose(self._hand, controls["hands"], self._hand_name)
            presets = controls["presets"]
            _choose(self._method, list(presets), controls["method"])
            _choose(self._preset, presets[controls["method"]], controls["preset"])

    @property
    def pictures(self) -> list[int]:
        """Numbers of the camera pictures that are currently shown."""
        return [camera.number for camera in self._cameras]

    def _show_cameras(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Shows the cameras' pictures with their ages, in a panel of their own."""
        if not self._cameras and states:
            panel = self._gui.add_panel()
            with panel.add_tab("Cameras"):
                self._cameras = [_CameraView(self._gui) for _ in states]
            panel.dock_left()
        for view, state in zip(self._cameras, states, strict=True):
            view.show(state)

    def _show_notice(self, notice: str) -> None:
        self._notice.content, self._notice.visible = notice, bool(notice)

    def _show_take(self, take: Mapping[str, Any]) -> None:
        """Shows the current or the last take with its controls."""
        self._record.label = (
            f"{'End take' if take['recording'] else 'Record'}{self._keys['record']}"
        )
        self._record.color = "red" if take["recording"] else "gray"
        if take["last"] != self._take.get("last"):
            self._quality = "measuring its quality …" if take["last"] else ""
            self._name.value = ""  # type: ignore[misc]  # it has a setter
            if take["last"]:
                threading.Thread(target=self._measure, args=(take["last"],), daemon=True).start()
        self._take = take
        self._take_text.content = live_texts.take(take, self._quality)
        self._take_text.visible = bool(self._take_text.content)
        for handle in (self._name, self._keep, self._discard):
            handle.visible = take["open"]

    def _measure(self, files: Sequence[str]) -> None:
        """Measures a take's quality. It takes seconds, but runs in the page's process, so it does
        not delay the loop."""

        def hand_of(file: str) -> Hand:
            """The hand of a file; if there are two hands, the one that the file's name states."""
            own = [hand for side, hand in self._hands.items() if f".{side}." in Path(file).name]
            return (own or list(self._hands.values()))[0]

        try:
            quality: Sequence[TakeQuality] | str = [
                take_quality(Path(file), hand_of(file)) for file in files
            ]
        except SmoothOperatorError as error:
            quality = f"its quality can't be measured: {error}"
        if files == self._take.get("last"):
            self._quality = quality


class _CameraView:
    """Picture of a camera, and a line with its age."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self.number = 0
        self._jpeg = ""
        self._picture, self._line = gui.add_html(""), gui.add_html("")

    def show(self, state: Mapping[str, Any]) -> None:
        """Shows a state from ``Cameras.states``; a late picture is dimmed."""
        self.number, self._jpeg = state["number"], state.get("jpeg", self._jpeg)
        late = live_texts.is_late(state)
        for handle, content in (
            (self._picture, live_texts.picture(state["name"], self._jpeg, late)),
            (self._line, live_texts.camera(state, late)),
        ):
            if handle.content != content:
                handle.content = content


def _choose(dropdown: Any, options: list[str], value: str) -> None:
    """Sets a dropdown's options and value; a value that is a file becomes an additional option."""
    options = options if value in options else [*options, value]
    if tuple(dropdown.options) != tuple(options):
        dropdown.options = tuple(options)
    if dropdown.value != value:
        dropdown.value = value
