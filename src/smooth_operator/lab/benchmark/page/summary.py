"""The main table of a benchmark in Markdown, for a README or an issue."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.lab.benchmark.ranking import (
    COLUMNS,
    best,
    by_hand,
    overall,
    sample_text,
    shown_value,
)
from smooth_operator.lab.benchmark.results import Row
from smooth_operator.lab.benchmark.settings import Settings
from smooth_operator.metrics import Metric

SUMMARY: Final = "summary.md"
_LEFT_OUT: Final = ("scale_ratio", "workspace_utilisation")


def write_summary(rows: Sequence[Row], settings: Settings) -> Path:
    """Writes ``summary.md``: for each hand the main table, its sample, date and command.

    Raises:
        OutputError: it can't be written.
    """
    path = settings.output / SUMMARY
    with atomic_write(path) as file:
        file.write(summary_text(rows, settings).encode())
    return path


def summary_text(rows: Sequence[Row], settings: Settings) -> str:
    """The tables of ``write_summary``."""
    metrics = [metric for metric in COLUMNS if metric.name not in _LEFT_OUT]
    parts = []
    for hand, own in by_hand(rows).items():
        lines = [line for line in overall(own) if line.failed is None]
        heads = [" ".join(filter(None, (m.short, m.unit, m.sign))) for m in metrics]
        table = [["method", *heads], ["---", *("---:" for _ in metrics)]]
        tops = [best(lines, metric) for metric in metrics]
        for i, line in enumerate(lines):
            values = [_short(m, line.values.get(m.name)) for m in metrics]
            marked = [f"**{v}**" if i in top else v for v, top in zip(values, tops, strict=True)]
            name = f"`{line.method}`"
            partly = "" if line.count == line.of else f" ({line.count} of {line.of})"
            table.append([name + partly, *marked])
        day = max((str(row["date"])[:10] for row in own if row["date"]), default="")
        words = f"{hand}, n = {sample_text(own)}; mean over trackers. {day}:"
        parts.append("\n".join(f"| {' | '.join(cells)} |" for cells in table) + f"\n\n{words}")
    return "\n\n".join([*parts, f"```bash\n{command_of(settings)}\n```"]) + "\n"


def _short(metric: Metric, value: float | None) -> str:
    """A value in three digits."""
    if value is None or metric.name.endswith("share"):
        return shown_value(metric, value)
    return f"{value:.3f}" if metric.goal == "->1" else f"{value:.3g}"


def command_of(settings: Settings) -> str:
    """The command of a benchmark, with the names of recordings without their folders."""
    names = [Path(text).name for text in settings.recordings]
    words = ["smooth-operator", "bench", *names, "--methods", ",".join(settings.methods)]
    words += ["--hands", ",".join(settings.hands)]
    if settings.definition != "sound":
        words += ["--definition", settings.definition]
    return shlex.join([*words, "--output", settings.output.name])
