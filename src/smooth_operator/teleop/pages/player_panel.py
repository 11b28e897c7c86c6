"""The page's controls; they only report what was asked for, the player decides what happens."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import viser

from smooth_operator.teleop.pages.playback import Playback
from smooth_operator.teleop.pages.status_panel import legend, metrics_table, status_line
from smooth_operator.teleop.pages.timeline import Timeline
from smooth_operator.teleop.pages.viser_server import add_hotkeys, from_person

SPEEDS = (0.1, 4.0)
"""Slowest and fastest playback, as a multiple of real time."""


class Controls(Protocol):
    """What the panel can ask for; implemented by the player, callable from any thread."""

    def toggle(self) -> None:
        """Play if paused, pause if playing."""

    def step(self, frames: int) -> None:
        """Pause and move by some frames."""

    def scrub(self, frame: int) -> None:
        """Go to a frame by hand; playback waits until the hand rests."""

    def set_speed(self, speed: float) -> None:
        """Set the playback speed."""

    def set_loop(self, loop: bool) -> None:
        """Start over at the end, or stop."""

    def set_overlay(self, overlay: bool) -> None:
        """Both hands in one place, or side by side."""

    def set_keyvectors(self, visible: bool) -> None:
        """Show or hide the keyvectors."""

    def set_meshes(self, visible: bool) -> None:
        """Show the makers' meshes, or simple shapes."""

    def aim(self, client: viser.ClientHandle) -> None:
        """Reset one browser's camera."""


class Panel:
    """Builds the controls and keeps them in step with the player.

    Args:
        gui: where to build.
        runs: what is played.
        controls: what carries out what is asked for.
        loop: initial state of the loop box.
    """

    def __init__(
        self, gui: viser.GuiApi, runs: Sequence[Playback], controls: Controls, loop: bool
    ) -> None:
        self._runs = runs
        gui.set_panel_label(runs[0].title)
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self._status = gui.add_html(status_line(runs, 0))
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key K")
        step = gui.add_button_group("Step", ("-1", "+1"), hint="keys J and L")
        speed = gui.add_slider(
            "Speed", min=SPEEDS[0], max=SPEEDS[1], step=0.1, initial_value=1.0,
            hint="times real time",
        )  # fmt: skip
        looping = gui.add_checkbox("Loop", loop)
        overlay = gui.add_checkbox("Overlay", False, hint="all hands in one place")
        vectors = gui.add_checkbox("Keyvectors", True, hint="thumb tip to fingertips")
        if any(run.simple is not None for run in runs):
            meshes = gui.add_checkbox(
                "Meshes", runs[0].show_meshes, hint="the maker's, or simple shapes"
            )
            meshes.on_update(from_person(lambda event: controls.set_meshes(event.target.value)))
        view = gui.add_button("Reset view", color="gray", icon=viser.Icon.FOCUS_CENTERED)
        gui.add_html(legend(runs))

        self._play.on_click(from_person(lambda _: controls.toggle()))
        step.on_click(from_person(lambda event: controls.step(int(event.target.value))))
        speed.on_update(from_person(lambda event: controls.set_speed(event.target.value)))
        looping.on_update(from_person(lambda event: controls.set_loop(event.target.value)))
        overlay.on_update(from_person(lambda event: controls.set_overlay(event.target.value)))
        vectors.on_update(from_person(lambda event: controls.set_keyvectors(event.target.value)))
        view.on_click(from_person(lambda event: controls.aim(event.client)))
        # letters, not space and arrows: those also press the button or slider that has the focus
        add_hotkeys(
            gui,
            ("Play / pause", "K", controls.toggle),
            ("Step back", "J", lambda: controls.step(-1)),
            ("Step forward", "L", lambda: controls.step(1)),
        )
        self._timeline = Timeline(gui, runs, controls.scrub)
        self._build_side_panel(gui)

    def show_frame(self, frame: int) -> None:
        """Move status line and timeline to a frame."""
        self._status.content = status_line(self._runs, frame)
        self._timeline.show(frame)

    def fit(self, client: int, canvas_width: float | None) -> None:
        """Fit the timeline to a browser's canvas [px]; None once the browser has left."""
        self._timeline.fit(client, canvas_width)

    def show_playing(self, playing: bool) -> None:
        """Make the button say what it would do."""
        self._play.label = "Pause" if playing else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _build_side_panel(self, gui: viser.GuiApi) -> None:
        gui.main_panel.dock_right()
        if any(run.metrics for run in self._runs):
            # A separate panel: on a phone it starts folded, so that the hands stay visible.
            panel = gui.add_panel()
            with panel.add_tab("Metrics", icon=viser.Icon.TABLE):
                gui.add_html(metrics_table(self._runs))
            panel.dock_below(gui.main_panel)
