"""Parts of the player's panel: status, legend, timeline with its curves."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import viser
from jaxtyping import Float
from viser import uplot

from smooth_operator.teleop.pages.hand_view import RUN_COLORS, css, finger_colors
from smooth_operator.teleop.pages.playback import PINCH_DISTANCE, Playback
from smooth_operator.teleop.pages.viser_server import from_person
from smooth_operator.types import Status

SPEEDS = (0.1, 4.0)
"""Slowest and fastest playback, as a multiple of real time."""


def status_line(runs: Sequence[Playback], frame: int) -> str:
    """The line under the title as HTML: frame, time; of each run what it said, and its latency."""
    times = runs[0].times
    parts = (
        f"<b>frame {frame}</b>/{len(times) - 1}",
        f"<b>{times[frame]:.2f}</b>/{times[-1]:.2f} s",
    )
    lines = [_status_text(run, frame, named=len(runs) > 1) for run in runs]
    return (
        f'<div id="playback-status" data-frame="{frame}" role="status" '
        'style="padding:0.4em 0.8em;font-size:0.875em;font-variant-numeric:tabular-nums">'
        f"{' · '.join(parts)}<br>{'<br>'.join(lines)}</div>"
    )


def _status_text(run: Playback, frame: int, named: bool) -> str:
    try:
        status = Status(int(run.status[frame]))
        reason, good = status.reason, status is Status.OK
    except ValueError:  # a file from a newer release; say what it holds
        reason, good = f"status {int(run.status[frame])}", False
    latency = run.latency_ms[frame]
    time = f"{latency:.2f} ms" if np.isfinite(latency) else "no latency"
    name = f"{html.escape(run.label)}: " if named else ""
    return f"{name}<b>{'✓' if good else '⚠'}</b> {html.escape(reason)} · {time}"


def legend(runs: Sequence[Playback]) -> str:
    """Colours of the fingers, and of the runs where there are several, as HTML."""
    fingers = runs[0].fingers
    chips = _chips(fingers, [css(color) for color in finger_colors(len(fingers))], "⬤")
    if len(runs) == 1:
        lines = "— robot &nbsp; - - human"
    else:
        colors = [run_color(i) for i in range(len(runs))]
        lines = (
            _chips([run.label for run in runs], colors, "━")
            + "<span style='white-space:nowrap'>- - human</span>"
        )
    return f'<div style="padding:0 0.8em 0.5em;font-size:0.75em">{chips}<br>{lines}</div>'


def _chips(names: Sequence[str], colors: Sequence[str], sign: str) -> str:
    return "".join(
        f'<span style="white-space:nowrap;margin-right:0.7em"><span style="color:{color}">'
        f"{sign}</span> {html.escape(name)}</span>"
        for name, color in zip(names, colors, strict=True)
    )


HEIGHT: Final = 255
"""Height of the whole panel [px]; the camera keeps the hands above it."""
_PLOT_HEIGHT: Final = 150
_FRAME, _GAP = 10, 2  # around the plot, and between it and what follows [px]
_EDGE: Final = 6  # free space at the right of the panel [px]
_LEAST: Final = 300  # width of the panel [px]
_POINTS: Final = 1500
"""Samples of a curve at most; a screen shows hardly more."""
_TOP, _RIGHT, _BELOW, _BESIDE, _LABEL = 10, 14, 34, 44, 18
"""Around the curves: free space above and at the right, the axes and their labels [px]."""
_HUMAN: Final = "#9aa5af"
_INK, _GRID = "#b4bcc4", "#3a4046"


class GapCurves:
    """Thumb-to-finger distances of the whole recording [mm].

    Of one run, all fingers in their colours, the human's dashed. Of several runs, one finger in the
    colours of the runs, the human's grey and dashed.

    Args:
        runs: runs to play; the same frames in each.
    """

    def __init__(self, runs: Sequence[Playback]) -> None:
        self._runs = tuple(runs)
        first = self._runs[0]
        self.times = first.times
        self.fingers = first.fingers[1:]
        self._rows = np.unique(
            np.linspace(0, len(first) - 1, min(len(first), _POINTS)).round().astype(int)
        )
        self._human = 1e3 * first.human_gaps()
        self._robots = [1e3 * run.robot_gaps() for run in self._runs]
        values = np.concatenate([self._human, *self._robots], axis=1)
        finite = values[np.isfinite(values)]
        self.top = float(np.ceil(max(finite.max(initial=0.0), 2e3 * PINCH_DISTANCE) / 10) * 10)
        self.show(0)

    def show(self, finger: int) -> None:
        """Choose the finger (0 for the index finger) that several runs are compared by."""
        if len(self._runs) == 1:
            curves = np.concatenate([self._human, self._robots[0]], axis=1)
        else:
            columns = [self._human, *self._robots]
            curves = np.stack([gaps[:, finger] for gaps in columns], axis=1)
        self._curves = curves[self._rows].astype(np.float32)

    @property
    def series(self) -> tuple[uplot.Series, ...]:
        """Looks of the curves: the time, then the curves."""
        plain = uplot.Series_Points(show=False)
        if len(self._runs) == 1:
            colors = [css(color) for color in finger_colors(len(self.fingers) + 1)][1:]
            human = [
                uplot.Series(label=f"{name} human", stroke=color, width=1.5, dash=(5.0, 4.0),
                             points=plain)
                for name, color in zip(self.fingers, colors, strict=True)
            ]  # fmt: skip
            robots = [
                uplot.Series(label=f"{name} robot", stroke=color, width=2.0, points=plain)
                for name, color in zip(self.fingers, colors, strict=True)
            ]
        else:
            human = [
                uplot.Series(label="human", stroke=_HUMAN, width=1.5, dash=(5.0, 4.0), points=plain)
            ]
            robots = [
                uplot.Series(label=run.label, stroke=run_color(i), width=2.0, points=plain)
                for i, run in enumerate(self._runs)
            ]
        return (uplot.Series(label="time"), *human, *robots)

    def data(self) -> tuple[Float[np.ndarray, " P"], ...]:
        """Times [s], then the curves [mm]."""
        return (self.times[self._rows], *self._curves.T)


class Timeline:
    """Builds the panel and keeps it at a frame.

    Args:
        gui: where to build.
        runs: runs to play.
        scrub: called with the frame that the slider is moved to.
    """

    def __init__(
        self, gui: viser.GuiApi, runs: Sequence[Playback], scrub: Callable[[int], None]
    ) -> None:
        self._curves = GapCurves(runs)
        count = len(runs[0])
        self._frame = 0
        # Playback moves the cursor in its thread while a browser's thread may replace it.
        self._lock = threading.Lock()
        self._widths: dict[int, float] = {}
        self._gui, self._end = gui, float(max(runs[0].times[-1], 1e-3))
        self._panel = gui.add_panel()
        self._tab = self._panel.add_tab("Timeline", icon=viser.Icon.TIMELINE)
        with self._tab:
            self.slider = gui.add_slider(
                "Frame", min=0, max=max(count - 1, 1), step=1, initial_value=0, disabled=count == 1
            )
            if len(runs) > 1:
                finger = gui.add_dropdown(
                    "Finger", self._curves.fingers, initial_value=self._curves.fingers[0],
                    hint="whose distance from the thumb is drawn",
                )  # fmt: skip
                finger.on_update(from_person(lambda event: self._choose(event.target.value)))
        self._add_plot()
        self._panel.float(x=0, y=-1, width=_LEAST)
        self.slider.on_update(from_person(lambda event: scrub(int(event.target.value))))

    def show(self, frame: int) -> None:
        """Move slider and cursor."""
        self._frame = frame
        self.slider.value = frame  # type: ignore[misc]  # it has a setter; mypy loses sight of it
        with self._lock:
            self._cursor.content = cursor_line(self._curves.times[frame] / self._end)

    def fit(self, client: int, canvas_width: float | None) -> None:
        """Make the panel as wide as the narrowest browser's canvas.

        Args:
            client: number of the browser.
            canvas_width: width of its canvas [px]; None once it has left.
        """
        with self._lock:
            before = min(self._widths.values(), default=0.0)
            if canvas_width is None:
                self._widths.pop(client, None)
            else:
                self._widths[client] = max(canvas_width - _EDGE, _LEAST)
            now = min(self._widths.values(), default=0.0)
            if not now or now == before:
                return
            self._panel.set_width(now)
            if now < before:  # the browser makes a plot wider with its panel, but not narrower
                self._plot.remove()
                self._cursor.remove()
                self._add_plot()

    def _add_plot(self) -> None:
        with self._tab:
            self._plot = self._gui.add_uplot(
                self._curves.data(),
                self._curves.series,
                scales={
                    "x": uplot.Scale(time=False, range=(0.0, self._end)),
                    "y": uplot.Scale(range=(0.0, self._curves.top)),
                },
                axes=(_axis("time [s]", _BELOW), _axis("gap [mm]", _BESIDE)),
                legend=uplot.Legend(show=False),
                height=_PLOT_HEIGHT,
                padding=(_TOP, _RIGHT, 0, 0),
            )
            share = self._curves.times[self._frame] / self._end
            self._cursor = self._gui.add_html(cursor_line(share))

    def _choose(self, finger: str) -> None:
        with self._lock:
            self._curves.show(self._curves.fingers.index(finger))
            self._plot.data = self._curves.data()


def cursor_line(share: float) -> str:
    """An upright line over the plot above it, as HTML.

    A series of the plot could draw it, but then all curves would be sent with each move.

    Args:
        share: where, from 0 at the beginning to 1 at the end.
    """
    left, low = _BESIDE + _LABEL + _FRAME, _BELOW + _LABEL + _FRAME + _GAP
    place = f"calc({left}px + (100% - {left + _RIGHT + _FRAME}px) * {share:.5f})"
    line = (
        f"position:absolute;left:{place};bottom:{low}px;"
        f"height:{_PLOT_HEIGHT - _TOP - _BELOW - _LABEL}px;width:1.5px;background:#fff"
    )
    return (
        f'<div id="timeline-cursor" style="position:relative;height:0;pointer-events:none">'
        f'<div style="{line}"></div></div>'
    )


def _axis(label: str, size: int) -> uplot.Axis:
    grid = uplot.Axis_Grid(stroke=_GRID, width=1)
    return uplot.Axis(label=label, labelSize=_LABEL, size=size, stroke=_INK, grid=grid)


def run_color(index: int) -> str:
    """Colour of a run among several, in plots and tables."""
    return css(RUN_COLORS[index % len(RUN_COLORS)])
