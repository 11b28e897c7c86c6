"""Tables of methods: values, means and the best method for each use; also compares two
benchmarks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from scipy.stats import rankdata

from smooth_operator.errors import counted
from smooth_operator.metrics import METRICS, Metric
from smooth_operator.metrics.pinches import LEAST_PINCHED
from smooth_operator.metrics.table import plugin_metrics
from smooth_operator_benchmark.suite import (
    Row,
    row_key,
    row_method,
    row_tracker,
    row_unit,
    value_of,
)

_BY_NAME: Final = {metric.name: metric for metric in METRICS}

HEADLINES: Final[tuple[Metric, ...]] = tuple(
    _BY_NAME[name]
    for name in (
        "cosine_similarity",
        "scale_ratio",
        "motion_preservation",
        "flatness",
        "workspace_utilisation",
        "latency_ms.p50",
    )
)
"""The six columns of the paper's table."""

COLUMN_GROUPS: Final[Mapping[str, tuple[Metric, ...]]] = {
    group: tuple(_BY_NAME[name] for name in names)
    for group, names in {
        "looks": (
            "finger_extension_error",
            "finger_direction_error_deg",
            "thumb_direction_error_deg",
        ),
        "grasping": ("pinch_touch_share", "pinch_deep_share", "self_collision.share"),
        "motion": ("motion_preservation", "jumps_per_1000"),
        "speed": ("latency_ms.p50",),
        "the paper's": (
            "cosine_similarity",
            "scale_ratio",
            "flatness",
            "workspace_utilisation",
        ),
    }.items()
}
"""Columns of a benchmark's tables, group by group; the paper's six are among them."""

COLUMNS: Final[tuple[Metric, ...]] = tuple(m for group in COLUMN_GROUPS.values() for m in group)
"""All columns of a benchmark's tables."""

NUMBERS: Final[tuple[Metric, ...]] = tuple(
    metric
    for metric in METRICS
    if metric.name
    not in (
        "status",
        "definition",
        "human_fit",
        "workspace_utilisation_per_finger",
        "pinch_touch_share_per_finger",
    )
)
"""All built-in metrics that are one number."""


def columns() -> tuple[Metric, ...]:
    """Columns of the tables: ``COLUMNS``, and the metrics of plugins that define a column
    heading."""
    return (*COLUMNS, *(metric for metric in plugin_metrics() if metric.short))


def numbers() -> tuple[Metric, ...]:
    """Metrics with numeric values: ``NUMBERS``, and the metrics of plugins."""
    return (*NUMBERS, *plugin_metrics())


@dataclass(frozen=True)
class Line:
    """Values of one method, as one line of a table.

    Attributes:
        method: name of the method.
        values: metric name -> value; None for a missing value.
        failed: reason why there are no values; None if there are values.
        count: number of recordings over which the values are averaged.
        of: number of all recordings; if it is larger than ``count``, the line is not ranked.
    """

    method: str
    values: Mapping[str, float | None]
    failed: str | None = None
    count: int = 1
    of: int = 1


def lines_of(rows: Iterable[Row]) -> list[Line]:
    """Returns one line for each row of one recording and one hand, with all ``numbers``."""
    metrics = numbers()
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
    """Means over trackers for the rows of one hand, one line per method.

    Parts of one recording are one unit. A value is averaged over the units of each tracker, then
    over the trackers, so that many recordings of one tracker do not dominate. A metric that some
    recordings do not have (no pinch) is averaged over the others, which are the same for all
    methods. Recordings on which every method failed are ignored.
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
    """Groups rows by tracker, in the order of the rows; trackers on which no method succeeded are
    left out."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row_tracker(row), []).append(row)
    return {t: own for t, own in groups.items() if any(row["status"] == "ok" for row in own)}


def sample_text(rows: Iterable[Row]) -> str:
    """Says how many recordings of each tracker there are: ``3 recordings: 2 glove, 1 camera``."""
    rows = [row for row in rows if row["status"] == "ok"]
    counts = {
        tracker: len({row_unit(row) for row in own}) for tracker, own in by_tracker(rows).items()
    }
    total = sum(counts.values())
    words = counted(total, "recording")
    parts = len({row["recording"] for row in rows})
    words += f" in {parts} parts" if parts > total else ""
    listed = ", ".join(f"{count} {tracker}" for tracker, count in counts.items())
    return f"{words}: {listed}" if len(counts) > 1 else words


def by_panel(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Groups rows by recording, hand and side, in the order of the rows."""
    return _grouped(rows, ("recording", "hand", "side"))  # type: ignore[return-value]


def by_hand(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Groups rows by robot hand, with left and right in one group; keeps the order of the rows."""
    return {hand: group for (hand,), group in _grouped(rows, ("hand",)).items()}


def failures(rows: Iterable[Row]) -> list[tuple[str, str, str]]:
    """Lists the failures as (recording and hand, methods that failed for the same reason,
    reason)."""
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


def footnotes(rows: Iterable[Row]) -> list[str]:
    """Footnotes that explain empty cells of self-collision and pinch metrics: one sentence for each
    hand and each recording that was not measured."""
    share, touch = _BY_NAME["self_collision.share"], _BY_NAME["pinch_touch_share"]
    measured = [row for row in rows if row["status"] == "ok"]
    hands = {
        f"{row['hand']} {row['side']}": None for row in measured if value_of(row, share) is None
    }
    pinched = {row["recording"] for row in measured if value_of(row, touch) is not None}
    recordings = dict.fromkeys(row["recording"] for row in measured)
    return [
        *(
            f"– self-collision of {hand}: not measured, because no two of its parts can "
            "touch each other. It is not ranked and not used to choose a method."
            for hand in hands
        ),
        *(
            f"– 'touch' and 'deep' of {recording}: not measured, because the human pinches in "
            f"fewer than {LEAST_PINCHED} frames."
            for recording in recordings
            if recording not in pinched
        ),
    ]


def best(lines: Sequence[Line], metric: Metric) -> set[int]:
    """Indices of the best lines of a metric; empty if the metric has no better direction or all
    values are alike.

    Lines that are printed with the same value are equally good.
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
    """Converts a value to a merit, so that larger is better. For a metric whose best value is 1,
    the merit is at most 0."""
    if metric.goal == "->1":
        return -abs(value - 1.0)
    return -value if metric.goal == "down" else value


def shown_value(metric: Metric, value: float | None) -> str:
    """A value of a metric as tables print it."""
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


COLLISION_LIMIT: Final = 0.05
"""Largest fraction of frames in self-collision of a method that is recommended for grasping."""
MOTION_FLOOR: Final = 0.9
"""Smallest motion preservation of a method that is recommended for calm motion, because a hand that
does not move would be the calmest."""
FEW: Final = 5
"""Number of recordings below which the page warns that the ranking may differ on other
recordings."""

RULES: Final = (
    "Overall is the mean rank over the columns of the table; equal values share a rank. "
    "Looks: the smallest extension error. Grasping: the most pinches that touch, among the "
    f"methods with at most {100 * COLLISION_LIMIT:.0f} % of frames in self-collision (among "
    "all methods if self-collision was not measured). Directions: the cosine similarity "
    "closest to 1. Calm motion: the smallest flatness among the methods with a motion "
    f"preservation of at least {MOTION_FLOOR:g}. Speed: the smallest median latency."
)
"""Human-readable rules by which methods are chosen."""

RANK: Final = Metric("mean_rank", "", "down", "mean rank over these columns; 1 means first in all")
"""Column of the mean rank."""

_EXTENSION: Final = _BY_NAME["finger_extension_error"]
_FINGERS: Final = _BY_NAME["finger_direction_error_deg"]
_TOUCH: Final = _BY_NAME["pinch_touch_share"]
_COLLISION: Final = _BY_NAME["self_collision.share"]
_COSINE: Final = _BY_NAME["cosine_similarity"]
_MOTION: Final = _BY_NAME["motion_preservation"]
_FLATNESS: Final = _BY_NAME["flatness"]
_LATENCY: Final = _BY_NAME["latency_ms.p50"]


@dataclass(frozen=True)
class Use:
    """The recommended methods for one use.

    Attributes:
        name: the use.
        methods: the best methods, several if their values look the same; empty if no method
            qualifies.
        figures: values behind the choice, or the reason why no method qualifies.
    """

    name: str
    methods: tuple[str, ...]
    figures: str


def mean_ranks(lines: Sequence[Line]) -> dict[str, float]:
    """Mean rank of each method over the columns in which any method has a value; rank 1 is the
    best.

    Methods that failed on a recording are not ranked. A method without a value is last in that
    column; values that look the same in the table share a rank.
    """
    running = _competing(lines)
    ranks: list[np.ndarray] = []
    for metric in COLUMNS:
        values = [line.values.get(metric.name) for line in running]
        if metric.goal and any(value is not None for value in values):
            merits: dict[str, float] = {}  # the best of those that look the same
            for value in values:
                shown, worth = shown_value(metric, value), -np.inf
                if value is not None:
                    worth = merit(metric, value)
                merits[shown] = max(worth, merits.get(shown, -np.inf))
            ranks.append(rankdata([-merits[shown_value(metric, value)] for value in values]))
    if not ranks:
        return {}
    means = np.mean(ranks, axis=0)
    return {line.method: float(mean) for line, mean in zip(running, means, strict=True)}


def find_uses(lines: Sequence[Line]) -> list[Use]:
    """Finds the best method for each use, following ``RULES``; empty if fewer than two methods are
    ranked."""
    running = _competing(lines)
    if len(running) < 2:
        return []
    measured = any(line.values.get(_COLLISION.name) is not None for line in running)
    free = [line for line in running if _reaches(line, _COLLISION, COLLISION_LIMIT)]
    moving = [line for line in running if _reaches(line, _MOTION, MOTION_FLOOR)]
    crowded = (
        f"every method has more than {100 * COLLISION_LIMIT:.0f} % of frames in self-collision"
    )
    still = f"no method reaches a motion preservation of {MOTION_FLOOR:g}"
    return [
        _use("looks", running, running, _EXTENSION, (_EXTENSION, _FINGERS), ""),
        _use("pinching and grasping", free, running, _TOUCH, (_TOUCH, _COLLISION), crowded)
        if measured
        else _use("pinching and grasping", running, running, _TOUCH, (_TOUCH,), ""),
        _use("pointing as the human does", running, running, _COSINE, (_COSINE,), ""),
        _use("calm motion without lag", moving, running, _FLATNESS, (_FLATNESS, _MOTION), still),
        _use("speed", running, running, _LATENCY, (_LATENCY,), ""),
    ]


def verdict(lines: Sequence[Line]) -> str:
    """One sentence that names the best method overall and for each use; empty without ranked
    methods."""
    ranks = mean_ranks(lines)
    uses = find_uses(lines)
    if len(ranks) < 2 or not uses:
        return ""
    (first, rank), (second, next_rank) = sorted(ranks.items(), key=lambda item: item[1])[:2]
    overall = (
        f"{first} and {second} share the best mean rank over all columns ({rank:.1f} of "
        f"{len(ranks)})"
        if rank == next_rank
        else f"{first} has the best mean rank over all columns ({rank:.1f} of {len(ranks)}; next "
        f"{second}, {next_rank:.1f})"
    )
    parts = [
        f"for {use.name} {' and '.join(use.methods) or 'none'} ({use.figures})" for use in uses
    ]
    return f"{overall}; {'; '.join(parts)}."


def _use(
    name: str,
    lines: Sequence[Line],
    every: Sequence[Line],
    by: Metric,
    shown: Sequence[Metric],
    why_none: str,
) -> Use:
    """Chooses the best of ``lines``. If one of ``every`` has a better value, it is also named."""
    measured = [line for line in lines if line.values.get(by.name) is not None]
    if not measured:
        return Use(name, (), why_none if not lines else f"no {_words(by)} was measured")
    tops = best(measured, by) or set(range(len(measured)))
    top = measured[min(tops)]
    figures = ", ".join(f"{_words(m)} {_with_unit(m, top)}" for m in shown)
    barred = [
        line for line in every if line not in measured and line.values.get(by.name) is not None
    ]
    better = [i for i in best([*barred, top], by) if i < len(barred)]
    if better:
        other = barred[better[0]]
        why = ", ".join(f"{_words(m)} {_with_unit(m, other)}" for m in shown)
        figures += f"; {other.method} is excluded: {why}"
    return Use(name, tuple(measured[i].method for i in sorted(tops)), figures)


def _words(metric: Metric) -> str:
    return {
        "finger_extension_error": "extension error",
        "finger_direction_error_deg": "fingers off by",
        "pinch_touch_share": "fraction of pinches that touch",
        "self_collision.share": "self-collision",
        "latency_ms.p50": "median latency",
    }.get(metric.name, metric.name.replace("_", " "))


def _with_unit(metric: Metric, line: Line) -> str:
    unit = f" {metric.unit}" if metric.unit else ""
    return f"{shown_value(metric, line.values.get(metric.name))}{unit}"


def _competing(lines: Sequence[Line]) -> list[Line]:
    return [line for line in lines if line.failed is None and line.count == line.of]


def _reaches(line: Line, metric: Metric, bound: float) -> bool:
    value = line.values.get(metric.name)
    return value is not None and merit(metric, value) >= merit(metric, bound)


Verdict: TypeAlias = Literal["better", "worse", "same"]

NOISE: Final = 0.005
"""Relative difference below which values count as equal. For metrics whose goal is 1, it is
relative to the distance from 1. Rounding differences between processors are smaller than this."""
LATENCY_NOISE: Final = 0.1
"""Relative difference below which latencies count as equal; repeated runs differ by this much."""


@dataclass(frozen=True)
class Change:
    """One metric of a cell, compared between two benchmarks.

    Attributes:
        metric: the metric.
        now: its value in this benchmark.
        before: its value in the other benchmark.
        verdict: verdict by the metric's goal; ``same`` for metrics without a better direction.
    """

    metric: Metric
    now: float
    before: float
    verdict: Verdict

    @property
    def difference(self) -> float:
        """Difference ``now - before``."""
        return self.now - self.before


@dataclass(frozen=True)
class Compared:
    """One cell, compared between two benchmarks.

    Attributes:
        key: name of the cell.
        changes: changes of the metrics that both have, in their order.
        notes: other differences that may make the values incomparable.
    """

    key: tuple[str, ...]
    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    def change(self, metric: Metric) -> Change | None:
        """Change of a metric; None if one of the benchmarks lacks it."""
        return next((each for each in self.changes if each.metric.name == metric.name), None)


@dataclass(frozen=True)
class Comparison:
    """A benchmark, compared with another benchmark.

    Attributes:
        name: name of the other benchmark.
        cells: cells that succeeded in both.
        only_here: keys of cells that are missing or failed in the other benchmark.
        only_there: keys of cells that are missing or failed in this benchmark.
    """

    name: str
    cells: tuple[Compared, ...]
    only_here: tuple[tuple[str, ...], ...]
    only_there: tuple[tuple[str, ...], ...]

    def count(self, verdict: Verdict, metrics: Sequence[Metric] | None = None) -> int:
        """Number of values that have a verdict, by default over the metrics of ``numbers``."""
        judged = numbers() if metrics is None else metrics
        return sum(
            change.verdict == verdict and change.metric in judged
            for cell in self.cells
            for change in cell.changes
        )


def compare(rows: Iterable[Row], others: Iterable[Row], name: str) -> Comparison:
    """Compares a benchmark with another benchmark.

    Args:
        name: name of the other benchmark in texts.
    """
    here = {row_key(row): row for row in rows if row.get("metrics")}
    there = {row_key(row): row for row in others if row.get("metrics")}
    return Comparison(
        name,
        tuple(_compared(key, row, there[key]) for key, row in here.items() if key in there),
        tuple(key for key in here if key not in there),
        tuple(key for key in there if key not in here),
    )


def change_verdict(metric: Metric, now: float, before: float) -> Verdict:
    """Says whether a value is better, worse or the same as an earlier one; ``same`` if they differ
    by no more than the noise."""
    noise = LATENCY_NOISE if metric.name.startswith("latency_ms") else NOISE
    gain = merit(metric, now) - merit(metric, before) if metric.goal else 0.0
    size = max(abs(merit(metric, now)), abs(merit(metric, before)))
    if abs(gain) <= noise * size:
        return "same"
    return "better" if gain > 0 else "worse"


def _compared(key: tuple[str, ...], row: Row, other: Row) -> Compared:
    changes = []
    for metric in numbers():
        now, before = value_of(row, metric), value_of(other, metric)
        if now is not None and before is not None:
            changes.append(Change(metric, now, before, change_verdict(metric, now, before)))
    return Compared(key, tuple(changes), tuple(_notes(row, other)))


def _notes(row: Row, other: Row) -> Iterable[str]:
    """Differences that make the metrics of two rows less comparable."""

    def of(which: Row, name: str, inner: str) -> object:
        part = which.get(name)
        return part.get(inner) if isinstance(part, dict) else None

    if of(row, "source", "sha256") != of(other, "source", "sha256"):
        yield "other frames"
    for name in ("definition", "seed"):
        if row.get(name) != other.get(name):
            yield f"{name} {row.get(name)}, was {other.get(name)}"
    if row.get("hardware") != other.get("hardware"):
        yield "another machine"
    for package in ("smooth-operator", "jax"):
        now, before = of(row, "versions", package), of(other, "versions", package)
        if now != before:
            yield f"{package} {now}, was {before}"
