"""Tables of methods: values, means over recordings, and which is the best."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from smooth_operator.lab.benchmark.results import (
    Row,
    row_method,
    row_tracker,
    row_unit,
    value_of,
)
from smooth_operator.metrics import METRICS, Metric
from smooth_operator.metrics.registry import plugin_metrics

_BY_NAME: Final = {metric.name: metric for metric in METRICS}

HEADLINES: Final[tuple[Metric, ...]] = tuple(
    _BY_NAME[name]
    for name in (
        "cosine_similarity", "scale_ratio", "motion_preservation", "flatness",
        "workspace_utilisation", "latency_ms.p50",
    )
)  # fmt: skip
"""The six columns of the paper's table."""

COLUMN_GROUPS: Final[Mapping[str, tuple[Metric, ...]]] = {
    group: tuple(_BY_NAME[name] for name in names)
    for group, names in {
        "looks": (
            "finger_extension_error", "finger_direction_error_deg", "thumb_direction_error_deg",
            "pinch_gap_excess_mm",
        ),
        "motion": ("motion_preservation", "jumps_per_1000"),
        "safety": ("self_collision.share",),
        "speed": ("latency_ms.p50",),
        "the paper's": (
            "cosine_similarity", "scale_ratio", "flatness", "workspace_utilisation",
        ),
    }.items()
}  # fmt: skip
"""Columns of a benchmark's tables, group by group; the paper's six are among them."""

COLUMNS: Final[tuple[Metric, ...]] = tuple(m for group in COLUMN_GROUPS.values() for m in group)
"""All columns of a benchmark's tables."""

NUMBERS: Final[tuple[Metric, ...]] = tuple(
    metric
    for metric in METRICS
    if metric.name
    not in (
        "status", "definition", "human_fit", "workspace_utilisation_per_finger",
        "pinch_error_per_finger_mm",
    )
)  # fmt: skip
"""All built-in metrics that are one number."""


def columns() -> tuple[Metric, ...]:
    """``COLUMNS``, and the metrics of plugins that have a heading for one."""
    return (*COLUMNS, *(metric for metric in plugin_metrics() if metric.short))


def numbers() -> tuple[Metric, ...]:
    """``NUMBERS``, and the metrics of plugins."""
    return (*NUMBERS, *plugin_metrics())


@dataclass(frozen=True)
class Line:
    """One method in a table.

    Attributes:
        method: name of the method.
        values: metric name -> value, None where there is none.
        failed: why it has no values at all; None where it has.
        count: over how many recordings the values are means.
        of: over how many they ought to be; where it is more, the line does not compete.
    """

    method: str
    values: Mapping[str, float | None]
    failed: str | None = None
    count: int = 1
    of: int = 1


def lines_of(rows: Iterable[Row], metrics: Sequence[Metric] | None = None) -> list[Line]:
    """One line for each row of one recording and one hand; of ``numbers`` if none are given."""
    metrics = numbers() if metrics is None else metrics
    return [
        Line(
            row_method(row),
            {metric.name: value_of(row, metric) for metric in metrics},
            None if row["status"] == "ok" else str(row["reason"]),
            int(row["status"] == "ok"),
        )
        for row in rows
    ]


def overall(rows: Iterable[Row], metrics: Sequence[Metric] | None = None) -> list[Line]:
    """Means over the trackers, one line for each method, of the rows of one hand.

    Parts of one recording are one unit. A figure is the mean of its units' for each tracker, then
    the mean over the trackers, so that many recordings of one tracker do not outweigh another. A
    metric that some recordings do not have (no pinch) is the mean of those that do, which are the
    same for all methods. Recordings on which every method failed do not count.
    """
    metrics = numbers() if metrics is None else metrics
    rows = list(rows)
    usable = {row["recording"] for row in rows if row["status"] == "ok"}
    by_method: dict[str, list[Row]] = {}
    for row in rows:
        by_method.setdefault(row_method(row), []).append(row)
    lines = []
    for method, own in by_method.items():
        good = [row for row in own if row["status"] == "ok"]
        values: dict[str, float | None] = {}
        for metric in metrics:
            figures: dict[str, dict[str, list[float]]] = {}
            for row in good:
                value = value_of(row, metric)
                if value is not None:
                    of_unit = figures.setdefault(row_tracker(row), {}).setdefault(row_unit(row), [])
                    of_unit.append(value)
            by_tracker = [_mean([_mean(unit) for unit in t.values()]) for t in figures.values()]
            values[metric.name] = _mean(by_tracker) if by_tracker else None
        failed = None if good else str(own[0]["reason"])
        of = sum(row["recording"] in usable for row in own)
        lines.append(Line(method, values, failed, len(good), of))
    return lines


def by_tracker(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Rows of each tracker that any method succeeded on, in their order."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row_tracker(row), []).append(row)
    return {t: own for t, own in groups.items() if any(row["status"] == "ok" for row in own)}


def sample_text(rows: Iterable[Row]) -> str:
    """Numbers of recordings of each tracker, for a person: ``3 recordings: 2 glove, 1 camera``."""
    rows = [row for row in rows if row["status"] == "ok"]
    counts = {
        tracker: len({row_unit(row) for row in own}) for tracker, own in by_tracker(rows).items()
    }
    total = sum(counts.values())
    words = f"{total} recording{'' if total == 1 else 's'}"
    parts = len({row["recording"] for row in rows})
    words += f" in {parts} parts" if parts > total else ""
    listed = ", ".join(f"{count} {tracker}" for tracker, count in counts.items())
    return f"{words}: {listed}" if len(counts) > 1 else words


def by_panel(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Rows of one recording, hand and side; in their order."""
    return _grouped(rows, ("recording", "hand", "side"))  # type: ignore[return-value]


def by_hand(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Rows of one hand, left and right together; in their order."""
    return {hand: group for (hand,), group in _grouped(rows, ("hand",)).items()}


def failures(rows: Iterable[Row]) -> list[tuple[str, str, str]]:
    """Failures: recording and hand, methods, reason; methods with one reason together."""
    grouped: list[tuple[str, str, str]] = []
    for (recording, hand, side), own in by_panel(rows).items():
        reasons: dict[str, list[str]] = {}
        for row in own:
            if row["status"] != "ok":
                reasons.setdefault(str(row["reason"]), []).append(row_method(row))
        for reason, methods in reasons.items():
            every = len(methods) == len(own) > 1
            named = f"all {len(own)} methods" if every else ", ".join(methods)
            grouped.append((f"{recording} on {hand} {side}", named, reason))
    return grouped


def collision_footnotes(rows: Iterable[Row]) -> list[str]:
    """Footnotes for empty cells of self-collision: one sentence for each hand not measured."""
    share = _BY_NAME["self_collision.share"]
    hands = {
        f"{row['hand']} {row['side']}": None
        for row in rows
        if row["status"] == "ok" and value_of(row, share) is None
    }
    return [
        f"– self-collision of {hand}: not measured, since some of its links have no collision "
        "shapes that can be read. It has no rank and no part in the choice of a method."
        for hand in hands
    ]


def best(lines: Sequence[Line], metric: Metric) -> set[int]:
    """Best lines at a metric; none where it is no merit, or all are alike.

    Lines that look the same are equally good: what can't be read can't be better.
    """
    if not metric.goal:
        return set()
    merits = {
        i: merit(metric, value)
        for i, line in enumerate(lines)
        if (value := line.values.get(metric.name)) is not None and line.count == line.of
    }
    shown = {i: shown_value(metric, lines[i].values[metric.name]) for i in merits}
    if len(merits) < 2 or len(set(shown.values())) < 2:
        return set()
    top = max(merits, key=lambda i: merits[i])
    return {i for i in merits if shown[i] == shown[top] or merits[i] == merits[top]}


def merit(metric: Metric, value: float) -> float:
    """Merit of a value: more is better; at most 0 for a metric whose best value is 1."""
    if metric.goal == "->1":
        return -abs(value - 1.0)
    return -value if metric.goal == "down" else value


def shown_value(metric: Metric, value: float | None) -> str:
    """A value as tables print it."""
    if value is None:
        return "–"
    if metric.name in ("frames",):
        return f"{value:.0f}"
    if metric.name.startswith("workspace_utilisation") or metric.name.endswith("share"):
        return f"{100 * value:.1f} %"
    if metric.name == "flatness" or (value and abs(value) < 1e-3):
        return f"{value:.2e}"
    return f"{value:.4f}" if metric.goal == "->1" else f"{value:.4g}"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _grouped(rows: Iterable[Row], names: Sequence[str]) -> dict[tuple[str, ...], list[Any]]:
    groups: dict[tuple[str, ...], list[Any]] = {}
    for row in rows:
        groups.setdefault(tuple(str(row[name]) for name in names), []).append(row)
    return groups
