"""Verdict on the methods by use: one sentence from the figures of a benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import rankdata

from smooth_operator.lab.benchmark.ranking import COLUMNS, Line, best, merit, shown_value
from smooth_operator.metrics import METRICS, Metric

COLLISION_LIMIT: Final = 0.05
"""Largest share of frames in self-collision of a method that is named for grasping."""
MOTION_FLOOR: Final = 0.9
"""Least motion preservation of a method that is named for calm motion: a hand that does not move
would be the calmest."""
FEW: Final = 5
"""Recordings below which the page warns that the order may be another on others."""

RULES: Final = (
    "Overall is the mean rank over the columns of the table, where equal figures share a rank. "
    "Looks: the least extension error. Grasping: the least pinch gap over the human's of the "
    f"methods with at most {100 * COLLISION_LIMIT:.0f} % of frames in self-collision, or of all "
    "where self-collision was not measured. Directions: the cosine similarity nearest 1. Calm "
    "motion: the least flatness of the methods with a motion preservation of at least "
    f"{MOTION_FLOOR:g}. Speed: the least median latency."
)
"""How the methods are chosen, for a person."""

RANK: Final = Metric("mean_rank", "", "down", "mean rank over these columns; 1 is first in all")
"""Column of the mean rank."""

_METRIC: Final = {metric.name: metric for metric in METRICS}
_EXTENSION: Final = _METRIC["finger_extension_error"]
_FINGERS: Final = _METRIC["finger_direction_error_deg"]
_PINCH: Final = _METRIC["pinch_gap_excess_mm"]
_COLLISION: Final = _METRIC["self_collision.share"]
_COSINE: Final = _METRIC["cosine_similarity"]
_MOTION: Final = _METRIC["motion_preservation"]
_FLATNESS: Final = _METRIC["flatness"]
_LATENCY: Final = _METRIC["latency_ms.p50"]


@dataclass(frozen=True)
class Use:
    """The method for one use.

    Attributes:
        name: the use.
        methods: the best, several where they look the same; empty where none serves.
        figures: figures of the choice, or the reason for none.
    """

    name: str
    methods: tuple[str, ...]
    figures: str


def mean_ranks(lines: Sequence[Line]) -> dict[str, float]:
    """Mean rank of each method over the columns that any method has a value in; 1 is the best.

    Methods that failed on a recording do not compete. A method without a value is the last of its
    column; figures that look the same in the table share a rank.
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
    """The method for each use, by ``RULES``; empty where fewer than two methods compete."""
    running = _competing(lines)
    if len(running) < 2:
        return []
    measured = any(line.values.get(_COLLISION.name) is not None for line in running)
    free = [line for line in running if _at_most(line, _COLLISION, COLLISION_LIMIT)]
    moving = [line for line in running if _at_least(line, _MOTION, MOTION_FLOOR)]
    crowded = f"every method has over {100 * COLLISION_LIMIT:.0f} % of frames in self-collision"
    still = f"no method reaches a motion preservation of {MOTION_FLOOR:g}"
    return [
        _use("looks", running, running, _EXTENSION, (_EXTENSION, _FINGERS), ""),
        _use("pinching and grasping", free, running, _PINCH, (_PINCH, _COLLISION), crowded)
        if measured
        else _use("pinching and grasping", running, running, _PINCH, (_PINCH,), ""),
        _use("pointing as the human does", running, running, _COSINE, (_COSINE,), ""),
        _use("calm motion that keeps up", moving, running, _FLATNESS, (_FLATNESS, _MOTION), still),
        _use("speed", running, running, _LATENCY, (_LATENCY,), ""),
    ]


def verdict(lines: Sequence[Line]) -> str:
    """One sentence: the best overall, and the best for each use; empty where nothing competes."""
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
    """The best of ``lines``; where one of ``every`` has a better figure, it is named, too."""
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
        figures += f"; {other.method} does not count: {why}"
    return Use(name, tuple(measured[i].method for i in sorted(tops)), figures)


def _words(metric: Metric) -> str:
    return {
        "finger_extension_error": "extension error",
        "finger_direction_error_deg": "fingers off by",
        "pinch_gap_excess_mm": "pinch gap over the human's",
        "self_collision.share": "self-collision",
        "latency_ms.p50": "median latency",
    }.get(metric.name, metric.name.replace("_", " "))


def _with_unit(metric: Metric, line: Line) -> str:
    unit = f" {metric.unit}" if metric.unit else ""
    return f"{shown_value(metric, line.values.get(metric.name))}{unit}"


def _competing(lines: Sequence[Line]) -> list[Line]:
    return [line for line in lines if line.failed is None and line.count == line.of]


def _at_most(line: Line, metric: Metric, bound: float) -> bool:
    value = line.values.get(metric.name)
    return value is not None and value <= bound


def _at_least(line: Line, metric: Metric, bound: float) -> bool:
    value = line.values.get(metric.name)
    return value is not None and value >= bound
