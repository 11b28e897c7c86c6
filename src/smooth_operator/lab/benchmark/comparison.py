"""Compares two benchmarks cell by cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from smooth_operator.lab.benchmark.ranking import merit, numbers
from smooth_operator.lab.benchmark.results import Row, row_key, value_of
from smooth_operator.metrics import Metric

Verdict: TypeAlias = Literal["better", "worse", "same"]

NOISE: Final = 0.005
"""Figures that differ by less than this share count as the same: of their value, or where one is
the goal, of their distance from it. A processor that rounds in another way changes less."""
LATENCY_NOISE: Final = 0.1
"""The same for latencies: a repeated run differs as much."""


@dataclass(frozen=True)
class Change:
    """A metric of a cell in both benchmarks.

    Attributes:
        metric: which.
        now: its value here.
        before: its value there.
        verdict: by the metric's goal; ``same`` also for facts that are no merit.
    """

    metric: Metric
    now: float
    before: float
    verdict: Verdict

    @property
    def difference(self) -> float:
        """now - before."""
        return self.now - self.before


@dataclass(frozen=True)
class Compared:
    """A cell in both benchmarks.

    Attributes:
        key: name of the cell.
        changes: changes of the metrics that both have, in their order.
        notes: other differences, by which the figures may not be comparable.
    """

    key: tuple[str, ...]
    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    def change(self, metric: Metric) -> Change | None:
        """Change of a metric; None if one of the benchmarks lacks it."""
        return next((each for each in self.changes if each.metric.name == metric.name), None)


@dataclass(frozen=True)
class Comparison:
    """Two benchmarks.

    Attributes:
        name: name of the other one.
        cells: those that succeeded in both.
        only_here: keys of cells that the other has not, or that failed there.
        only_there: keys of cells that this has not, or that failed here.
    """

    name: str
    cells: tuple[Compared, ...]
    only_here: tuple[tuple[str, ...], ...]
    only_there: tuple[tuple[str, ...], ...]

    def count(self, verdict: Verdict, metrics: Sequence[Metric] | None = None) -> int:
        """Number of figures with a verdict; by default of all metrics that are numbers."""
        judged = numbers() if metrics is None else metrics
        return sum(
            change.verdict == verdict and change.metric in judged
            for cell in self.cells
            for change in cell.changes
        )


def compare(rows: Iterable[Row], others: Iterable[Row], name: str) -> Comparison:
    """Compares an earlier benchmark with one.

    Args:
        name: name of the other, for a person.
    """
    here = {row_key(row): row for row in rows if row.get("metrics")}
    there = {row_key(row): row for row in others if row.get("metrics")}
    return Comparison(
        name,
        tuple(_compared(key, row, there[key]) for key, row in here.items() if key in there),
        tuple(key for key in here if key not in there),
        tuple(key for key in there if key not in here),
    )


def verdict(metric: Metric, now: float, before: float) -> Verdict:
    """True if a value is better or worse than another, beyond noise."""
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
            changes.append(Change(metric, now, before, verdict(metric, now, before)))
    return Compared(key, tuple(changes), tuple(_notes(row, other)))


def _notes(row: Row, other: Row) -> Iterable[str]:
    """Differences that make the figures of two rows less comparable."""

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
