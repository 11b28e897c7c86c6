"""Experiment ``table``: the paper's benchmark of methods, with its six metrics and its layout."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.execution import Outcome as Execution
from smooth_operator.execution import built_for, execute, measure
from smooth_operator.hands.registry import load_hand
from smooth_operator.io.jsonable import to_json
from smooth_operator.metrics import Metric, evaluate
from smooth_operator.planning import Plan
from smooth_operator_benchmark.cells import Cell, Settings, benchmark_code, fingerprint
from smooth_operator_benchmark.page.report import PAPER_NOTE, PAPER_TABLE
from smooth_operator_benchmark.quality import measure_latency
from smooth_operator_benchmark.ranking import HEADLINES, Line, best, merit, shown_value
from smooth_operator_benchmark.recordings import Source
from smooth_operator_research.paper.experiment import (
    Drawing,
    ExperimentContext,
    Outcome,
    Table,
    cell_job,
)
from smooth_operator_research.paper.figures import Panel, table_figure
from smooth_operator_research.paper.follow import (
    LEAD,
    Field,
    effort_ms,
    field_of,
    led,
    middle,
    recording_of,
)
from smooth_operator_research.paper.intervals import Estimate, Samples, contrast, mean_of, typical
from smooth_operator_research.paper.verdicts import Direction, Verdict, judge


def table_quality(cell: Cell, advance: object) -> dict[str, np.ndarray]:
    """Metrics of a cell by the definitions ``sound`` and ``paper``, each as JSON."""
    todo = _plan(cell)
    outcome = execute(replace(todo, recording=led(todo.recording)), built_for(todo))
    trace, metrics = measure(todo, settled(outcome))
    return {
        "sound": np.array(to_json(metrics)),
        "paper": np.array(to_json(evaluate(trace, "paper"))),
    }


def settled(outcome: Execution) -> Execution:
    """Removes the frames of the lead."""
    commands, loss = outcome.commands[LEAD:], outcome.tracking_loss[LEAD:]
    return replace(outcome, commands=commands, tracking_loss=loss)


def table_latency(
    cells: Sequence[Cell], frames: int, advance: Callable[[float], None]
) -> dict[str, np.ndarray]:
    """Median latency of each cell [ms], and the fraction of cores that other processes used."""
    for cell in cells:  # compiled before the machine is watched
        built_for(_plan(cell))
    latencies = measure_latency(cells, frames, 0, lambda cell: advance(1 / len(cells)))
    p50 = [one.summary["p50"] for one in latencies]
    others = latencies[0].others
    return {
        "p50": np.array([np.nan if value is None else value for value in p50]),
        "others": np.array(np.nan if others is None else others),
    }


def _plan(cell: Cell) -> Plan:
    recording = recording_of(cell.source)
    hand = load_hand(cell.hand, recording.side)
    return Plan(
        recording=recording, hand=hand, method=cell.method, preset=cell.preset, config=cell.config
    )


PAPERS: Final = {
    "dexpilot": "DexPilot",
    "geort": "GeoRT",
    "hybrid": "Hybrid",
    "sbr:paper": "SBR",
}
"""Maps our labels to the paper's, in the order of its columns; all except GeoRT as published."""

METHODS: Final = (*PAPERS, "sbr", "keyvector", "ako", "joint_angle")
LATENCY: Final = "latency_ms.p50"

_TITLES: Final = {
    "cosine_similarity": "cosine similarity (→ 1)",
    "scale_ratio": "scale ratio (→ 1)",
    "motion_preservation": "motion preservation (→ 1)",
    "flatness": "flatness [m²] (↓)",
    "workspace_utilisation": "workspace utilisation (↑)",
    LATENCY: "latency [ms] (↓)",
}
_BOUNDS: Final = {
    "cosine_similarity": (-1, 1),
    "motion_preservation": (-1, 1),
    "workspace_utilisation": (0, 1),
}

Definition = str
"""Definition of the metrics, ``paper`` or ``sound``."""


@dataclass(frozen=True, eq=False)
class Benchmark:
    """Metrics of all methods.

    Attributes:
        labels: names of the methods.
        values: (definition, label, metric) -> recording -> value.
        units: name of a recording -> the independent unit that it belongs to.
        others: largest fraction of the cores that other processes used during latency runs.
    """

    labels: Sequence[str]
    values: Mapping[tuple[Definition, str, str], Mapping[str, float]]
    units: Mapping[str, str]
    others: float | None

    def each(self, definition: Definition, label: str, metric: Metric) -> dict[str, float]:
        """Values of a metric by recording, without recordings that lack it."""
        own = self.values.get((definition, label, metric.name), {})
        return {name: own[name] for name in self.units if name in own}

    def _samples(self, own: Mapping[str, float]) -> Samples:
        return Samples([[value] for value in own.values()], [self.units[name] for name in own])

    def mean(self, definition: Definition, label: str, metric: Metric) -> Estimate | None:
        """Mean with an interval over independent recordings, geometric if smaller is better; None
        without values."""
        own = self.each(definition, label, metric)
        over = typical if metric.goal == "down" else mean_of
        return over(self._samples(own)) if own else None

    def better(self, definition: Definition, a: str, b: str, metric: Metric) -> Estimate | None:
        """Advantage of a method over another by recording; positive is better.

        If smaller is better, it is the fraction by which the other's value is larger; otherwise a
        difference in the metric's unit, of the distances from 1 if the goal is 1.
        """
        down = metric.goal == "down"
        x, y = (self.each(definition, label, metric) for label in (a, b))
        both = [name for name in x if name in y]
        if not both:
            return None
        mine, others = (
            self._samples({name: own[name] if down else merit(metric, own[name]) for name in both})
            for own in (x, y)
        )
        return contrast(others, mine, "change") if down else contrast(mine, others, "difference")

    def winners(self, definition: Definition, metric: Metric, labels: Sequence[str]) -> set[str]:
        """Best of some methods, by the printed values."""
        means = [self.mean(definition, label, metric) for label in labels]
        lines = [
            Line(label, {metric.name: None if mean is None else mean.value})
            for label, mean in zip(labels, means, strict=True)
        ]
        return {labels[i] for i in best(lines, metric)}


class BenchmarkTable:
    """Compares the methods of the paper as published, and ours, by the paper's definitions and by
    ours."""

    title = "The six metrics"
    claim = "SBR is best in cosine similarity, motion preservation and flatness"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        size, field = context.size, field_of(context, METHODS)
        benchmark = measure_benchmark(context, field)
        frames = sum(min(len(recording_of(s)), size.table_frames) for s in context.sources)
        papers = [label for label in PAPERS if label in benchmark.labels]
        environment = context.store.environment
        return Outcome(
            f"{len(field.choices)} methods on {context.hand}, {frames:,} frames of "
            f"{context.recordings}. DexPilot, Hybrid and SBR have their authors' settings "
            "(dexpilot:published, hybrid:published, sbr:paper); GeoRT is ours, with the hand's "
            "built-in model; the others have our default presets. The first frame is shown "
            f"{LEAD} times before measuring starts, so that no method is measured on its way from "
            "the neutral pose. Claims are judged by the paper's definitions of the metrics; one "
            "table of all methods uses our (sound) ones (means, the human aligned as the method "
            f"saw it, still frames masked). Latency is p50 over {size.latency_frames} frames of "
            f"each recording, with methods taking turns and nothing else, on {environment['cpu']}, "
            f"{environment['cpu_cores']} cores, {environment['device']}. "
            f"{PAPER_NOTE}{field.note()}",
            [_verdict(benchmark, metric, papers) for metric in HEADLINES],
            [
                _paper_table(benchmark, papers),
                _table(benchmark, "sound"),
                _table(benchmark, "paper"),
            ],
            [
                Drawing(
                    "table",
                    "The six metrics of all methods by the paper's definitions. Bars: 95 % "
                    "intervals over recordings. Diamonds: the paper's values for its four.",
                    table_figure(_panels(benchmark), benchmark.labels),
                )
            ],
            {
                "values": [
                    {"definition": d, "method": label, "metric": metric, "recordings": own}
                    for (d, label, metric), own in benchmark.values.items()
                ],
                "paper": PAPER_TABLE,
                "gaps": field.gaps,
                "others": benchmark.others,
            },
        )


def measure_benchmark(context: ExperimentContext, field: Field) -> Benchmark:
    """Measures the missing cells: quality of all methods on all recordings, then their latency."""
    size = context.size
    cells = {
        (source.name, label): Cell(
            _cut(source, size.table_frames),
            context.hand,
            choice.method,
            choice.preset,
            choice.config,
        )
        for source in context.sources
        for label, choice in field.choices.items()
    }
    settings = Settings(output=Path())
    jobs = [
        cell_job(
            f"{label} on {name}",
            {"kind": f"table-{cell.method}", "lead": LEAD, "cell": fingerprint(cell, settings)},
            1500.0 + effort_ms(label) * len(recording_of(cell.source)),
            partial(table_quality, cell),
            benchmark_code(),
        )
        for (name, label), cell in cells.items()
    ]
    values: dict[tuple[Definition, str, str], dict[str, float]] = {}
    for (name, label), measured in zip(cells, context.finish("the six metrics", jobs), strict=True):
        for definition in ("paper", "sound"):
            metrics = json.loads(str(measured[definition]))
            for metric in HEADLINES:
                value = None if metric.name == LATENCY else metric.of(metrics)
                if isinstance(value, (int, float)):
                    values.setdefault((definition, label, metric.name), {})[name] = float(value)

    groups = {
        source.name: [cells[source.name, label] for label in field.choices]
        for source in context.sources
    }
    jobs = [
        cell_job(
            f"latency on {name}",
            {
                "kind": "table-latency",
                "cells": [fingerprint(cell, settings) for cell in group],
                "machine": context.store.machine,
                "frames": size.latency_frames,
            },
            sum(effort_ms(label) for label in field.choices) * (size.latency_frames + 50.0),
            partial(table_latency, group, size.latency_frames),
            benchmark_code(),
        )
        for name, group in groups.items()
    ]
    shares = []
    for name, measured in zip(groups, context.finish("latency, alone", jobs), strict=True):
        shares.append(float(measured["others"]))
        for label, p50 in zip(field.choices, measured["p50"], strict=True):
            for definition in ("paper", "sound"):
                if np.isfinite(p50):
                    values.setdefault((definition, label, LATENCY), {})[name] = float(p50)
    largest = max((share for share in shares if np.isfinite(share)), default=None)
    return Benchmark(list(field.choices), values, context.unit_of, largest)


def _cut(source: Source, frames: int) -> Source:
    recording = recording_of(source)
    if len(recording) <= frames:
        return source
    return replace(
        source, recording=middle(recording, frames), digest=f"{source.digest}, middle {frames}"
    )


def _verdict(benchmark: Benchmark, metric: Metric, papers: Sequence[str]) -> Verdict:
    """Verdict on the paper's order of its four methods."""
    paper = {label: PAPER_TABLE[PAPERS[label]][metric.name] for label in papers}
    order = sorted(papers, key=lambda label: -merit(metric, paper[label]))
    pairs = {
        (a, b): estimate
        for i, a in enumerate(order)
        for b in order[i + 1 :]
        if (estimate := benchmark.better("paper", a, b, metric)) is not None
    }
    better = Direction(0.0, upwards=True)
    judged = [better(one, among=len(pairs)) for one in pairs.values()]
    means = {label: benchmark.mean("paper", label, metric) for label in papers}
    values = {label: mean.value for label, mean in means.items() if mean is not None}
    ours = sorted(values, key=lambda label: -merit(metric, values[label]))
    first = order[0] if order else ""
    wins = judge(better, [estimate for pair, estimate in pairs.items() if first in pair])
    machine = (
        " The paper's SBR ran on an RTX 4090; the order of methods on a CPU and methods on an "
        "accelerator depends on the machine."
        if metric.name == LATENCY
        else ""
    )
    return Verdict(
        f"{_TITLES[metric.name]}: {' > '.join(PAPERS[label] for label in order)}",
        ", ".join(f"{PAPERS[one]} {shown_value(metric, paper[one])}" for one in order),
        " > ".join(f"{PAPERS[one]} {shown_value(metric, values[one])}" for one in ours),
        judge(better, list(pairs.values())),
        f"Of {len(judged)} pairs, with intervals widened for their number, {judged.count('held')} "
        f"are significantly in the paper's order and {judged.count('did not hold')} in the "
        f"opposite order. That {PAPERS.get(first, 'none')} is the best: {wins}.{machine}",
    )


def _paper_table(benchmark: Benchmark, papers: Sequence[str]) -> Table:
    rows = []
    for metric in HEADLINES:
        winners = benchmark.winners("paper", metric, papers)
        theirs = {label: PAPER_TABLE[PAPERS[label]][metric.name] for label in papers}
        lead = max(theirs.values(), key=lambda value: merit(metric, value), default=None)
        rows += [
            [
                _TITLES[metric.name],
                *(
                    _shown(benchmark.mean("paper", one, metric), metric, one in winners)
                    for one in papers
                ),
            ],
            [
                "    in the paper",
                *(f"{shown_value(metric, v)}{' ★' if v == lead else ''}" for v in theirs.values()),
            ],
        ]
    return Table(
        "The paper's table",
        ["metric", *(PAPERS[label] for label in papers)],
        rows,
        "★: the best of a row. Means over independent recordings (flatness and latency: geometric "
        f"ones) with 95 % intervals; by the paper's definitions. {PAPER_NOTE}{_busy(benchmark)}",
    )


def _table(benchmark: Benchmark, definition: Definition) -> Table:
    winners = {m.name: benchmark.winners(definition, m, list(benchmark.labels)) for m in HEADLINES}
    rows = [
        [
            label,
            *(
                _shown(benchmark.mean(definition, label, m), m, label in winners[m.name])
                for m in HEADLINES
            ),
        ]
        for label in benchmark.labels
    ]
    return Table(
        f"All methods, by the {'paper’s' if definition == 'paper' else 'sound'} definitions",
        ["method", *(_TITLES[metric.name] for metric in HEADLINES)],
        rows,
        "★: the best of a column. Means over independent recordings (flatness and latency: "
        f"geometric ones), 95 % intervals.{_busy(benchmark)}",
    )


def _busy(benchmark: Benchmark) -> str:
    if benchmark.others is None:
        return ""
    share = f"{100 * benchmark.others:.0f} %"
    return f" While latency was measured, other processes took up to {share} of the cores."


def _shown(mean: Estimate | None, metric: Metric, winner: bool) -> str:
    if mean is None:
        return "–"
    text = shown_value(metric, mean.value)
    if mean.low is not None and mean.high is not None:
        ends = np.clip((mean.low, mean.high), *_BOUNDS.get(metric.name, (-np.inf, np.inf)))
        low, high = (shown_value(metric, float(end)) for end in ends)
        text += f" [{low}, {high}]"
    return f"{text} ★" if winner else text


def _panels(benchmark: Benchmark) -> list[Panel]:
    panels = []
    for metric in HEADLINES:
        percent = metric.name == "workspace_utilisation"
        panels.append(
            Panel(
                "workspace utilisation [%] (↑)" if percent else _TITLES[metric.name],
                metric.name in ("flatness", LATENCY),
                100.0 if percent else 1.0,
                {one: benchmark.mean("paper", one, metric) for one in benchmark.labels},
                {one: [*benchmark.each("paper", one, metric).values()] for one in benchmark.labels},
                {
                    label: PAPER_TABLE[name][metric.name]
                    for label, name in PAPERS.items()
                    if label in benchmark.labels
                },
                1.0 if metric.goal == "->1" else None,
            )
        )
    return panels
