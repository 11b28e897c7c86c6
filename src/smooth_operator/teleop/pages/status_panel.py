"""Texts of the page: status line, legend, metrics."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from smooth_operator.metrics import Metric
from smooth_operator.metrics.metric import GROUPS
from smooth_operator.metrics.registry import known_metrics
from smooth_operator.teleop.pages.palette import css, finger_colors
from smooth_operator.teleop.pages.playback import Playback
from smooth_operator.teleop.pages.timeline import run_color
from smooth_operator.types import Status


def status_line(runs: Sequence[Playback], frame: int) -> str:
    """The line under the title as HTML: frame, time; of each run what it said, and its latency."""
    times = runs[0].times
    parts = (
        f"<b>frame {frame}</b>/{len(times) - 1}",
        f"<b>{times[frame]:.2f}</b>/{times[-1]:.2f} s",
    )
    said = [_said(run, frame, named=len(runs) > 1) for run in runs]
    return (
        f'<div id="playback-status" data-frame="{frame}" role="status" '
        'style="padding:0.4em 0.8em;font-size:0.875em;font-variant-numeric:tabular-nums">'
        f"{' · '.join(parts)}<br>{'<br>'.join(said)}</div>"
    )


def _said(run: Playback, frame: int, named: bool) -> str:
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


def metrics_table(runs: Sequence[Playback]) -> str:
    """Figures of each run as HTML, group by group: value, unit, the better direction, meaning."""
    flat = [dict(_flatten(run.metrics or {})) for run in runs]
    known = {metric.name: metric for metric in known_metrics()}
    names = list(dict.fromkeys(name for figures in flat for name in figures))
    parts = []
    for group, question in {**GROUPS, "": "Other"}.items():
        own = [n for n in names if _group_of(n) == group]
        if own:
            rows = "".join(_row(n, known.get(n), [figures.get(n) for figures in flat]) for n in own)
            title, _, asked = question.partition(": ")
            parts.append(
                f"<details open><summary style='cursor:pointer;font-weight:600;padding:0.5em 0 0'>"
                f"{html.escape(title)}</summary><div style='{_SOFT}'>{html.escape(asked)}</div>"
                f"<table style='width:100%;border-collapse:collapse'>{_head(runs)}{rows}</table>"
                "</details>"
            )
    style = "padding:0.2em 0.8em 0.8em;font-size:0.8em;font-variant-numeric:tabular-nums"
    return f'<div style="{style}">{"".join(parts)}</div>'


_SOFT: Final = "opacity:0.65;font-size:0.9em"


def _head(runs: Sequence[Playback]) -> str:
    if len(runs) == 1:
        return ""
    cells = "".join(
        f"<th style='text-align:right;color:{run_color(i)}'>{html.escape(run.label)}</th>"
        for i, run in enumerate(runs)
    )
    return f"<tr><th></th>{cells}</tr>"


def _row(name: str, metric: Metric | None, values: Sequence[Any]) -> str:
    unit = f" [{metric.unit}]" if metric and metric.unit else ""
    said = ""
    if metric:
        better = f"; {metric.better}" if metric.goal else ""
        said = f"<div style='{_SOFT}'>{html.escape(metric.meaning + better)}</div>"
    words = html.escape(name.replace("_", " ").replace(".", " "))
    cells = "".join(
        f"<td style='text-align:right;vertical-align:top;padding-left:0.6em'>{_cell(value)}</td>"
        for value in values
    )
    return f"<tr><td style='padding:0.25em 0'>{words}{unit}{said}</td>{cells}</tr>"


def _group_of(name: str) -> str:
    """Group of a figure, or of that which it is a part of, such as a finger's."""
    metrics = known_metrics()
    own = (m for m in metrics if name == m.name or name.startswith(f"{m.name}."))
    return next((m.group for m in own if m.group in GROUPS), "")


def _flatten(metrics: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in metrics.items():
        name = str(key)
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name}.")
        elif not isinstance(value, (list, tuple, np.ndarray)) or len(np.atleast_1d(value)) <= 4:
            yield f"{prefix}{name}", value


def _cell(value: object) -> str:
    if isinstance(value, (list, tuple, np.ndarray)):
        return ", ".join(_cell(item) for item in np.atleast_1d(np.asarray(value)).tolist())
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    return "–" if value is None else html.escape(str(value))
