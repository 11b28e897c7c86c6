"""Rows of a measure, and their summary: each figure with its interval over independent units."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from smooth_operator.metrics import Metric
from smooth_operator.reporting.drawing import method_label
from smooth_operator_research.paper.intervals import Samples, independent, mean_of

Row: TypeAlias = dict[str, float | int | str | None]
"""Result of a case: a number for each figure (None where it can't be measured), and any other
numbers and short texts, all with a JSON form."""

_Z: Final = 1.959963984540054  # of the normal distribution, for 95 %


@dataclass(frozen=True)
class Figure(Metric):
    """A figure of a measure: a column of its rows, and how rows are summarised.

    A mean over independent units has Student's t interval. A share of trials has Wilson's interval,
    over all trials of all units.

    Attributes:
        share: True if the column has the number of successful trials, or the success of one.
        trials: name of the column with the number of trials; "" for one trial per row.
        main: True if it is shown on the terminal; the others are in the files and the report.
    """

    share: bool = False
    trials: str = ""
    main: bool = True

    @property
    def heading(self) -> str:
        """Heading of its column."""
        return self.short or self.name.replace("_", " ")


@dataclass(frozen=True)
class Summary:
    """A figure over independent units, with its 95 % interval.

    Attributes:
        value: mean, or share of successes; None if no row has the figure.
        low, high: ends of the interval; None for a mean of one unit, which has no interval.
        count: number of units, or of trials for a share.
    """

    value: float | None
    low: float | None
    high: float | None
    count: int

    def text(self, digits: int = 3) -> str:
        """The figure and its interval in brackets, for a table."""
        if self.value is None:
            return "–"
        if self.low is None or self.high is None:
            return _number(self.value, digits)
        ends = f"{_number(self.low, digits)}, {_number(self.high, digits)}"
        return f"{_number(self.value, digits)} [{ends}]"


def _number(value: float, digits: int) -> str:
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text else text.replace("-", "−")


def wilson(successes: float, trials: float) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson 1927)."""
    if not 0 <= successes <= trials or trials <= 0:
        raise ValueError(f"{successes:g} successes in {trials:g} trials have no interval")
    share, z2 = successes / trials, _Z * _Z
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = _Z * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    # At the ends rounding could leave the share outside its own interval.
    return min(max(0.0, middle - half), share), max(min(1.0, middle + half), share)


def summarise(figure: Figure, rows: Iterable[Mapping[str, Any]]) -> Summary:
    """Summarises a figure over the rows that have it; failed cases are left out."""
    measured = [row for row in rows if row.get(figure.name) is not None]
    if figure.share:
        good = sum(float(row[figure.name]) for row in measured)
        trials = sum(float(row[figure.trials]) if figure.trials else 1.0 for row in measured)
        if not trials:
            return Summary(None, None, None, 0)
        return Summary(good / trials, *wilson(good, trials), round(trials))
    if not measured:
        return Summary(None, None, None, 0)
    samples = Samples(
        [[float(row[figure.name])] for row in measured], [str(row["unit"]) for row in measured]
    )
    mean = mean_of(samples)
    return Summary(mean.value, mean.low, mean.high, mean.units)


@dataclass(frozen=True, eq=False)
class Line:
    """One line of a table: a method on a hand in a condition.

    Attributes:
        method: name of the method in tables.
        summaries: name of a figure -> its summary.
        rows: number of rows.
        failed: reasons why rows have no figures, each reason once.
    """

    method: str
    summaries: Mapping[str, Summary]
    rows: int
    failed: tuple[str, ...]


Difference: TypeAlias = dict[str, Summary]
"""Name of a figure -> difference of two methods."""


@dataclass(frozen=True, eq=False)
class MeasureResults:
    """All rows of a measure.

    Attributes:
        figures: figures of the measure.
        rows: each row begins with ``measure``, ``hand``, ``side``, ``method``, ``preset``,
            ``condition``, ``unit``, ``status`` (ok or error) and ``reason`` (of an error).
    """

    figures: Sequence[Figure]
    rows: Sequence[Row]

    @property
    def panels(self) -> list[tuple[str, str, str]]:
        """Hand, side and condition of each table."""
        keys = ((str(r["hand"]), str(r["side"]), str(r["condition"])) for r in self.rows)
        return list(dict.fromkeys(keys))

    @property
    def methods(self) -> list[str]:
        """Names of the methods, in the order of the rows."""
        return list(dict.fromkeys(row_method(row) for row in self.rows))

    def of(self, panel: tuple[str, str, str], method: str | None = None) -> list[Row]:
        """Rows of a hand, side and condition, for one method or for all."""
        own = [r for r in self.rows if (r["hand"], r["side"], r["condition"]) == panel]
        return [r for r in own if method is None or row_method(r) == method]

    def lines(self, panel: tuple[str, str, str]) -> list[Line]:
        """Lines of a table, one for each method."""
        lines = []
        for method in dict.fromkeys(row_method(row) for row in self.of(panel)):
            rows = self.of(panel, method)
            good = [row for row in rows if row["status"] == "ok"]
            summaries = {figure.name: summarise(figure, good) for figure in self.figures}
            failed = dict.fromkeys(str(row["reason"]) for row in rows if row["status"] != "ok")
            lines.append(Line(method, summaries, len(rows), tuple(failed)))
        return lines

    def differences(self, panel: tuple[str, str, str], against: str) -> dict[str, Difference]:
        """Differences of each other method's figures from those of one method, unit by unit.

        Both methods had the same units, so effects of the unit cancel. A share is computed within
        each unit.

        Args:
            panel: hand, side and condition.

        Returns:
            method -> name of a figure -> the mean difference with Student's t interval.
        """
        own = {method: self._by_unit(panel, method) for method in self.methods}
        return {
            method: {
                figure.name: _difference(values[figure.name], own[against][figure.name])
                for figure in self.figures
            }
            for method, values in own.items()
            if method != against
        }

    def _by_unit(
        self, panel: tuple[str, str, str], method: str
    ) -> dict[str, dict[str, float | None]]:
        """Name of a figure -> unit -> mean or share."""
        groups: dict[str, list[Row]] = {}
        for row in self.of(panel, method):
            if row["status"] == "ok":
                groups.setdefault(str(row["unit"]), []).append(row)
        return {
            figure.name: {unit: summarise(figure, rows).value for unit, rows in groups.items()}
            for figure in self.figures
        }


def _difference(a: Mapping[str, float | None], b: Mapping[str, float | None]) -> Summary:
    points = [x - y for unit, x in a.items() if x is not None and (y := b.get(unit)) is not None]
    if not points:
        return Summary(None, None, None, 0)
    mean = mean_of(independent(points))
    return Summary(mean.value, mean.low, mean.high, mean.units)


def best_of(lines: Sequence[Line], figure: Figure) -> str | None:
    """Best method by a figure; None if the figure has no direction or all are equal.

    If less is better, the value nearest to 0 is best, because a lag may be negative.
    """
    values = {line.method: line.summaries[figure.name].value for line in lines}
    finite = {method: value for method, value in values.items() if value is not None}
    if not figure.goal or len(set(finite.values())) < 2:
        return None
    if figure.goal == "->1":
        return min(finite, key=lambda method: abs(finite[method] - 1))
    if figure.goal == "down":
        return min(finite, key=lambda method: abs(finite[method]))
    return max(finite, key=finite.__getitem__)


def table_rows(
    lines: Sequence[Line], figures: Sequence[Figure], *, intervals: bool = True
) -> list[list[str]]:
    """Rows of text, one per method: its name and its figures, with ``*`` after the best of each."""
    best = [best_of(lines, figure) for figure in figures]
    rows = []
    for line in lines:
        texts = [line.summaries[figure.name].text() for figure in figures]
        shown = texts if intervals else [text.partition(" ")[0] for text in texts]
        marks = ["*" if line.method == one else " " for one in best]
        rows.append([line.method, *map("".join, zip(shown, marks, strict=True))])
    return rows


def row_method(row: Mapping[str, Any]) -> str:
    """Name of a row's method in tables."""
    return method_label(str(row["method"]), str(row["preset"]))
