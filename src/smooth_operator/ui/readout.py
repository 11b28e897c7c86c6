"""What the page says in words and curves: the status line, the metrics table, the live plot."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.types import Status
from smooth_operator.ui.markup import plain
from smooth_operator.ui.palette import css, finger_colors
from smooth_operator.ui.playback import PINCH_DISTANCE, Playback

WINDOW = 4.0
"""Seconds of the past that the plot shows."""
_POINTS = 240  # samples in the plot at most; more than its pixels would be waste


def status_line(playback: Playback, frame: int) -> str:
    """The line under the title as HTML: frame, time, what the retargeter said, latency."""
    try:
        status = Status(int(playback.status[frame]))
        reason, good = status.reason, status is Status.OK
    except ValueError:  # a file from a newer release; say what it holds
        reason, good = f"status {int(playback.status[frame])}", False
    latency = playback.latency_ms[frame]
    times = playback.times
    parts = (
        f"<b>frame {frame}</b>/{len(playback) - 1}",
        f"<b>{times[frame]:.2f}</b>/{times[-1]:.2f} s",
        f"{latency:.2f} ms" if np.isfinite(latency) else "no latency",
    )
    mark = f"<b>{'✓' if good else '⚠'}</b> {html.escape(reason)}"
    return (
        f'<div id="playback-status" data-frame="{frame}" role="status" '
        'style="padding:0.4em 0.8em;font-size:0.875em;font-variant-numeric:tabular-nums">'
        f"{' · '.join(parts)}<br>{mark}</div>"
    )


def legend(playback: Playback) -> str:
    """Finger colours and line styles as HTML."""
    colors = finger_colors(len(playback.fingers))
    chips = "".join(
        f'<span style="white-space:nowrap;margin-right:0.7em"><span style="color:{css(color)}">'
        f"⬤</span> {html.escape(name)}</span>"
        for name, color in zip(playback.fingers, colors, strict=True)
    )
    return f'<div style="padding:0 0.8em 0.5em;font-size:0.75em">{chips}</div>'


def metrics_table(metrics: Mapping[str, Any]) -> str:
    """Figures as a Markdown table; nested names are joined, long arrays left out."""
    rows = [f"| {_cell(name)} | {_cell(value)} |" for name, value in _flatten(metrics)]
    return "\n".join(["| metric | value |", "|:--|--:|", *rows])


class GapPlot:
    """The last seconds of the thumb-to-finger distances, human and robot, in millimetres.

    Args:
        playback: what is played.
    """

    def __init__(self, playback: Playback) -> None:
        self._times = playback.times
        gaps = np.concatenate([playback.human_gaps(), playback.robot_gaps()], axis=1)
        self._gaps = (gaps * 1e3).astype(np.float32)
        finite = self._gaps[np.isfinite(self._gaps)]
        self.top = float(np.ceil(max(finite.max(initial=0.0), 2e3 * PINCH_DISTANCE) / 10) * 10)

    def window(self, frame: int) -> tuple[Float[np.ndarray, " P"], ...]:
        """Times before now [s, <= 0], then one curve [mm] per human and per robot gap."""
        now = self._times[frame]
        first = int(np.searchsorted(self._times, now - WINDOW))
        # from a fixed grid of frames, so that a curve does not shimmer while it scrolls by
        step = -(-(frame + 1 - first) // _POINTS)
        rows = np.unique(np.append(np.arange(-(-first // step) * step, frame + 1, step), frame))
        curves = self._gaps[rows].T.astype(np.float64)
        return (self._times[rows] - now, *curves)


def _flatten(metrics: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in metrics.items():
        name = str(key).replace("_", " ")
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name} ")
        elif not isinstance(value, (list, tuple, np.ndarray)) or len(np.atleast_1d(value)) <= 4:
            yield f"{prefix}{name}", value


def _cell(value: object) -> str:
    if isinstance(value, (list, tuple, np.ndarray)):
        return ", ".join(_cell(item) for item in np.atleast_1d(np.asarray(value)).tolist())
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    return "–" if value is None else plain(str(value))
