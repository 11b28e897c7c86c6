"""The controls of the live page; each sends the loop's process what was asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import viser

from smooth_operator.hands.hand import Hand
from smooth_operator.methods.default import DEFAULT_METHOD
from smooth_operator.teleop.pages.callbacks import asked
from smooth_operator.teleop.pages.live import live_texts, trial_texts
from smooth_operator.teleop.pages.live.camera import OLD_S, camera
from smooth_operator.teleop.pages.live.config_controls import ConfigControls
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.pages.live.page_link import Link
from smooth_operator.teleop.pages.markup import plain
from smooth_operator.types import Side

_UNKNOWN: Final = -1
_STYLE: Final = """<style>
button:has(.icon-tabler-hand-stop), button:has(.icon-tabler-lock-open) {
  height: 3.2em !important; font-size: 1.25em !important; font-weight: 700}
button:has(.icon-tabler-hand-stop) .mantine-Button-label {white-space: pre-line; line-height: 1.15}
button:has(.icon-tabler-hand-stop) .mantine-Button-section,
button:has(.icon-tabler-lock-open) .mantine-Button-section {margin-inline-end: 0.6em !important}
div:has(> button :is(.icon-tabler-player-pause, .icon-tabler-player-play,
    .icon-tabler-player-record)) {
  display: inline-block; width: calc(50% - 1.25em); vertical-align: top}
@media (min-width: 700px) {
  #live-legend {position: fixed; left: 12px; bottom: 12px; max-width: 44vw; z-index: 5;
    padding: 0.4em 0.8em !important; border-radius: 6px; background: rgba(20, 22, 26, 0.75);
    pointer-events: none}}
#live-camera {
  position: fixed; left: 12px; top: 12px; width: clamp(110px, 22vw, 320px); z-index: 5;
  overflow: hidden; border-radius: 6px; pointer-events: none}
@media (min-width: 700px) {  /* between the hands: the panel takes 324 pixels on the right */
  #live-camera {left: calc(50vw - 162px); transform: translateX(-50%)}
  body:has([data-side] ~ [data-side]) #live-camera {width: clamp(110px, 16vw, 320px)}}
body:has([data-mode="stopped"])::after {
  content: "\\25A0  STOPPED"; position: fixed; inset: 0; z-index: 1000; pointer-events: none;
  box-sizing: border-box; padding: 0.3em 0.6em; border: 12px solid #ff2a2a;
  background: rgba(255, 0, 0, 0.18); color: #ff4d4d; text-shadow: 0 0 0.2em #000;
  font: 800 clamp(2rem, 6vw, 4.5rem) system-ui, sans-serif}
</style>"""
"""viser has buttons of one size; the style finds these two by their icons. An emergency stop tints
the whole page."""
_STOP: Final = "EMERGENCY STOP\nSpace, Esc or X"
_STOPPED: Final = "STOPPED\nrelease it below"


class LivePanel:
    """Builds the controls and shows what the loop sends.

    Args:
        server: where to build.
        hands: side -> robot hand.
        link: to the loop's process.
        scene: whose switches stand in the panel.
        download: has the configuration sent to the browser; None where the operator is not to
            know the method, and there is nothing that shows or changes it.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        hands: Mapping[Side, Hand],
        link: Link,
        scene: LiveScene,
        download: Callable[[], None] | None,
    ) -> None:
        self._link, self._scene, self._hands = link, scene, hands
        self.fields_number = _UNKNOWN
        self._pictures = True  # of the camera: whether they are wanted
        self._picture: dict[str, Any] = {"number": 0}
        self._operators: Mapping[str, Any] | None = None
        self._stopped = self._paused = self._released = False
        gui = server.gui
        hand = next(iter(hands.values()))
        self._fingers = hand.fingers
        gui.set_panel_label(hand.name)
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self._build_main(gui)
        panel = gui.add_panel()
        with panel.add_tab("Timing"):
            self._timing = gui.add_html("")
        with panel.add_tab("Limits" if download is None else "Method"):
            if download is not None:
                self._build_method(gui, download)
            self._limits = self._config_controls(gui, "Safety and limits", "set_loop")
        with panel.add_tab("Calibrate"):
            self._build_calibration(gui)
        with panel.add_tab("View"):
            self._build_view(gui)
        gui.main_panel.dock_right()
        panel.dock_below(gui.main_panel)

    def show(self, seen: Mapping[str, Any], delay: float = 0.0) -> None:
        """Show what the loop sends.

        Args:
            seen: what ``LiveSession.look`` gave.
            delay: how late the slowest browser shows it [s].
        """
        self._modes.content = live_texts.modes(seen["hands"])
        wrists = [hand.get("wrist") for hand in seen["hands"].values()]
        self._released = any(wrist is not None and wrist["released"] for wrist in wrists)
        self._show_calibration(seen["calibration"])
        self._show_camera(seen.get("camera"))
        shown = trial_texts.trial(seen.get("trial"))
        if shown != self._trial.content:
            self._trial.content = shown
            self._trial.visible = bool(shown)
        if "status" in seen:
            self._summary.content = live_texts.summary(seen["status"])
            self._timing.content = live_texts.timing(seen["status"])
            self._legend.content = live_texts.legend(
                self._fingers, self._scene.simulated, self._scene.has_task
            )
            self._slow.content = live_texts.slow(delay)
            self._slow.visible = bool(self._slow.content)
            self._show_controls(seen["controls"])

    @property
    def picture_number(self) -> int | None:
        """Which of the camera's pictures is shown; None if none is wanted."""
        return self._picture["number"] if self._pictures else None

    # -- building -----------------------------------------------------------------------------

    def _build_main(self, gui: viser.GuiApi) -> None:
        do = self._link.do
        self._stop = gui.add_button(_STOP, color="red", icon=viser.Icon.HAND_STOP)
        self._release = gui.add_button(
            "Release the stop (U)", color="orange", icon=viser.Icon.LOCK_OPEN, visible=False
        )
        gui.add_html(_STYLE + trial_texts.STYLE)
        self._trial = gui.add_html("", visible=False)
        self._modes = gui.add_html(live_texts.modes({}))
        self._pause = gui.add_button("Pause (P)", icon=viser.Icon.PLAYER_PAUSE)
        self._record = gui.add_button("Record (R)", color="gray", icon=viser.Icon.PLAYER_RECORD)
        self._summary = gui.add_html("")
        self._slow = gui.add_html("", visible=False)
        self._notice = gui.add_html("")
        self._legend = gui.add_html("")
        self._camera = gui.add_html("", visible=False)
        self._stop.on_click(asked(lambda _: do("stop")))
        self._release.on_click(asked(lambda _: do("release")))
        self._pause.on_click(asked(lambda _: self._toggle_pause()))
        self._record.on_click(asked(lambda _: do("record")))
        # Space and Esc come as X, from the script of the page (stop_keys.js)
        gui.add_command("Emergency stop", hotkey="X").on_trigger(asked(lambda _: do("stop")))
        gui.add_command("Release the stop", hotkey="U").on_trigger(asked(lambda _: do("release")))
        gui.add_command("Pause / resume", hotkey="P").on_trigger(
            asked(lambda _: self._toggle_pause())
        )
        gui.add_command("Wrist: release / engage", hotkey="C").on_trigger(
            asked(lambda _: do("follow", self._released))
        )
        gui.add_command("Record / end the recording", hotkey="R").on_trigger(
            asked(lambda _: do("record"))
        )

    def _build_method(self, gui: viser.GuiApi, download: Callable[[], None]) -> None:
        do = self._link.do
        # until the loop says what it runs
        self._method = gui.add_dropdown("Method", (DEFAULT_METHOD,))
        self._preset = gui.add_dropdown("Preset", ("default",))
        save = gui.add_button(
            "Save configuration", color="gray", icon=viser.Icon.DOWNLOAD, hint="as JSON"
        )
        self._method.on_update(asked(lambda event: do("method", event.target.value)))
        self._preset.on_update(
            asked(lambda event: do("method", self._method.value, event.target.value))
        )
        save.on_click(asked(lambda _: download()))
        self._settings = self._config_controls(gui, "Settings", "set")

    def _config_controls(self, gui: viser.GuiApi, title: str, word: str) -> ConfigControls:
        return ConfigControls(
            gui, title, lambda path, value: self._link.do(word, path, value), expanded=True
        )

    def _build_calibration(self, gui: viser.GuiApi) -> None:
        do = self._link.do
        self._prompt = gui.add_html("")
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._begin = [
            (gui.add_button(f"Calibrate the {side} hand", icon=viser.Icon.HAND_FINGER), side)
            for side in self._hands
        ]
        self._cancel = gui.add_button("Cancel", color="gray", visible=False)
        self._use = gui.add_button("Use it", color="green", visible=False)
        self._save = gui.add_button("Save operator.json", color="gray", visible=False)
        self._drop = [
            (gui.add_button(f"Drop the calibration ({side})", color="gray", visible=False), side)
            for side in self._hands
        ]
        for button, side in self._begin:
            button.on_click(asked(self._for_side("calibrate", side)))
        for button, side in self._drop:
            button.on_click(asked(self._for_side("drop_operator", side)))
        self._cancel.on_click(asked(lambda _: do("cancel_calibration")))
        self._use.on_click(asked(lambda _: do("use_operator")))
        self._save.on_click(asked(lambda _: do("save_operator")))

    def _build_view(self, gui: viser.GuiApi) -> None:
        scene = self._scene
        overlay = gui.add_checkbox("Overlay", False, hint="human inside robot")
        vectors = gui.add_checkbox("Keyvectors", True, hint="thumb tip to fingertips")
        overlay.on_update(asked(lambda event: scene.set_overlay(event.target.value)))
        vectors.on_update(asked(lambda event: scene.set_keyvectors(event.target.value)))
        self._pictures_box = gui.add_checkbox("Camera picture", True, visible=False)
        self._pictures_box.on_update(asked(lambda event: self._want_pictures(event.target.value)))
        self._meshes_box = gui.add_checkbox(
            "Meshes", True, hint="the maker's, or simple shapes", visible=False
        )
        self._meshes_box.on_update(asked(lambda event: scene.set_meshes(event.target.value)))
        if scene.simulated:
            own = gui.add_checkbox("Own hand at a task", False, hint="as tracked")
            own.on_update(asked(lambda event: scene.set_own(event.target.value)))
            simulated = gui.add_checkbox("Simulated hand", True, hint="see-through, where it is")
            simulated.on_update(asked(lambda event: scene.set_simulated(event.target.value)))
        view = gui.add_button("Reset view", color="gray", icon=viser.Icon.FOCUS_CENTERED)
        view.on_click(asked(lambda event: scene.aiming.aim(event.client)))

        self._meshes_note = gui.add_markdown("", visible=False)

    # -- showing ------------------------------------------------------------------------------

    def _for_side(self, name: str, side: Side) -> Callable[[Any], None]:
        return lambda _: self._link.do(name, side)

    def _toggle_pause(self) -> None:
        """What the button says; in an emergency stop nothing, which only a release ends."""
        if not self._stopped:
            self._link.do("resume" if self._paused else "pause")

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
        self._record.label = "End recording (R)" if controls["recording"] else "Record (R)"
        if controls["operators"] != self._operators:
            self._operators = controls["operators"]
            self._scene.set_operators(controls["operators"])
        for button, side in self._drop:
            button.visible = controls["operators"].get(side) is not None
        if "loop_fields" not in controls:
            return
        self.fields_number = controls["fields_number"]
        self._limits.show(controls["loop_fields"])
        if "fields" in controls:
            presets = controls["presets"]
            _choose(self._method, list(presets), controls["method"])
            _choose(self._preset, presets[controls["method"]], controls["preset"])
            self._settings.show(controls["fields"])

    def _want_pictures(self, wanted: bool) -> None:
        self._pictures = wanted
        self._camera.visible = wanted and "jpeg" in self._picture

    def _show_camera(self, seen: Mapping[str, Any] | None) -> None:
        """Show a picture; where there is no new one, how long there has been none."""
        if seen is None or not self._pictures:
            return
        self._picture |= seen
        if "jpeg" in seen or ("jpeg" in self._picture and seen["age_s"] > OLD_S):
            self._camera.content = camera(self._picture)
            self._camera.visible = self._pictures_box.visible = True

    def _show_calibration(self, state: Mapping[str, Any]) -> None:
        phase = state["phase"]
        running = phase in ("settle", "hold", "wait")
        self._prompt.content = live_texts.calibration(state)
        self._progress.visible = running
        if running:
            self._progress.value = 100 * state["done"]  # type: ignore[misc]  # it has a setter
        for button, _ in self._begin:
            button.visible = phase == "idle"
        self._cancel.visible = running
        found = phase == "idle" and bool(state["figures"])
        self._use.visible = self._save.visible = found


def _choose(dropdown: Any, options: list[str], value: str) -> None:
    """Set a dropdown's options and its choice; a file that stands for a preset is one more."""
    options = options if value in options else [*options, value]
    if tuple(dropdown.options) != tuple(options):
        dropdown.options = tuple(options)
    if dropdown.value != value:
        dropdown.value = value
