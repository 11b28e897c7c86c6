"""The page's controls; they only report what was asked for, the player decides what happens."""

from __future__ import annotations

from typing import Protocol

import viser
from viser import uplot

from smooth_operator.ui.callbacks import asked
from smooth_operator.ui.palette import css, finger_colors
from smooth_operator.ui.playback import Playback
from smooth_operator.ui.readout import WINDOW, GapPlot, legend, metrics_table, status_line

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

    def aim(self, client: viser.ClientHandle) -> None:
        """Reset one browser's camera."""


class Panel:
    """Builds the controls and keeps them in step with the player.

    Args:
        gui: where to build.
        playback: what is played.
        controls: who is told.
        loop: initial state of the loop box.
    """

    def __init__(
        self, gui: viser.GuiApi, playback: Playback, controls: Controls, loop: bool
    ) -> None:
        self._playback = playback
        gui.set_panel_label(playback.title)
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self._status = gui.add_html(status_line(playback, 0))
        self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="key K")
        last = max(len(playback) - 1, 1)
        self._slider = gui.add_slider(
            "Frame", min=0, max=last, step=1, initial_value=0, disabled=len(playback) == 1
        )
        step = gui.add_button_group("Step", ("-1", "+1"), hint="keys J and L")
        speed = gui.add_slider(
            "Speed", min=SPEEDS[0], max=SPEEDS[1], step=0.1, initial_value=1.0,
            hint="times real time",
        )  # fmt: skip
        looping = gui.add_checkbox("Loop", loop)
        overlay = gui.add_checkbox("Overlay", False, hint="human inside robot")
        vectors = gui.add_checkbox("Keyvectors", True, hint="thumb tip to fingertips")
        view = gui.add_button("Reset view", color="gray", icon=viser.Icon.FOCUS_CENTERED)
        gui.add_html(legend(playback))

        self._play.on_click(asked(lambda _: controls.toggle()))
        self._slider.on_update(asked(lambda event: controls.scrub(event.target.value)))
        step.on_click(asked(lambda event: controls.step(int(event.target.value))))
        speed.on_update(asked(lambda event: controls.set_speed(event.target.value)))
        looping.on_update(asked(lambda event: controls.set_loop(event.target.value)))
        overlay.on_update(asked(lambda event: controls.set_overlay(event.target.value)))
        vectors.on_update(asked(lambda event: controls.set_keyvectors(event.target.value)))
        view.on_click(asked(lambda event: controls.aim(event.client)))
        # letters, not space and arrows: those also press the button or slider that has the focus
        gui.add_command("Play / pause", hotkey="K").on_trigger(asked(lambda _: controls.toggle()))
        gui.add_command("Step back", hotkey="J").on_trigger(asked(lambda _: controls.step(-1)))
        gui.add_command("Step forward", hotkey="L").on_trigger(asked(lambda _: controls.step(1)))
        self._build_side_panel(gui)

    def show_frame(self, frame: int) -> None:
        """Move slider, status line and plot to a frame."""
        self._slider.value = frame  # type: ignore[misc]  # it has a setter; mypy loses sight of it
        self._status.content = status_line(self._playback, frame)
        self._plot.data = self._gaps.window(frame)

    def show_playing(self, playing: bool) -> None:
        """Make the button say what it would do."""
        self._play.label = "Pause" if playing else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _build_side_panel(self, gui: viser.GuiApi) -> None:
        # A panel of its own: on a phone it starts folded, so that the hands stay visible.
        panel = gui.add_panel()
        with panel.add_tab("Distances", icon=viser.Icon.CHART_LINE):
            gui.add_html(
                '<div style="padding:0.4em 0.8em 0;font-size:0.8em">thumb to finger [mm], '
                "last seconds<br>— robot &nbsp; - - human</div>"
            )
            self._gaps = GapPlot(self._playback)
            self._plot = gui.add_uplot(
                self._gaps.window(0),
                self._series(),
                scales={
                    "x": uplot.Scale(time=False, range=(-WINDOW, 0.0)),
                    "y": uplot.Scale(range=(0.0, self._gaps.top)),
                },
                legend=uplot.Legend(show=False),
                height=190,
                padding=(10, 14, 0, 0),
            )
        if self._playback.metrics:
            with panel.add_tab("Metrics", icon=viser.Icon.TABLE):
                gui.add_markdown(metrics_table(self._playback.metrics))
        gui.main_panel.dock_right()
        panel.dock_below(gui.main_panel)

    def _series(self) -> tuple[uplot.Series, ...]:
        fingers = self._playback.fingers
        colors = [css(color) for color in finger_colors(len(fingers))]
        human = [
            uplot.Series(label=f"{name} human", stroke=color, width=1.5, dash=(5.0, 4.0),
                         points=uplot.Series_Points(show=False))
            for name, color in list(zip(fingers, colors, strict=True))[1:]
        ]  # fmt: skip
        robot = [
            uplot.Series(label=f"{name} robot", stroke=color, width=2.0,
                         points=uplot.Series_Points(show=False))
            for name, color in list(zip(fingers, colors, strict=True))[1:]
        ]  # fmt: skip
        return (uplot.Series(label="time"), *human, *robot)
