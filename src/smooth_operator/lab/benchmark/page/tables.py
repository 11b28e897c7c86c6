"""Tables of the report: headlines, all metrics, fingers, comparison, failures, environment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from smooth_operator.lab.benchmark.comparison import Change, Compared, Comparison
from smooth_operator.lab.benchmark.quality import PER_FINGER
from smooth_operator.lab.benchmark.ranking import (
    COLUMN_GROUPS,
    COLUMNS,
    RANK,
    Line,
    best,
    columns,
    failures,
    lines_of,
    mean_ranks,
    numbers,
    shown_value,
)
from smooth_operator.lab.benchmark.results import Row, row_method
from smooth_operator.lab.benchmark.settings import method_label
from smooth_operator.metrics import Metric
from smooth_operator.metrics.metric import GROUPS
from smooth_operator.metrics.registry import known_metrics
from smooth_operator.reporting.html import (
    Html,
    details,
    dot,
    element,
    escape,
    failed_cell,
    join,
    name_cell,
    paragraph,
    table,
    text_table,
)


def header(metric: Metric) -> Html:
    """The heading of a column: name, unit and direction of a metric; it sorts the table."""
    name = metric.short or metric.name.replace("_", " ")
    below = " ".join(filter(None, (metric.unit, metric.sign)))
    title = element("span", escape(name), title=metric.meaning)
    inside = Html(f"{title} <small>{escape(below)}</small>")
    return element("th", inside, scope="col", data_goal=metric.goal or "up")


def headline_table(
    lines: Sequence[Line], colors: Mapping[str, str], *, paper: bool = False
) -> Html:
    """The main columns, group by group, and the mean rank over them; the best marked.

    Args:
        lines: one a method.
        colors: method -> colour.
        paper: put the paper's own figures below.
    """
    foot = Html("")
    if paper:
        foot = join(
            element(
                "tr",
                join(
                    [
                        name_cell(f"{name}, paper"),
                        element("td", "–"),  # no rank
                        *(
                            element("td", escape(shown_value(metric, values.get(metric.name))))
                            for metric in columns()
                        ),
                    ]
                ),
            )
            for name, values in PAPER_TABLE.items()
        )
    body = _table(lines, colors, foot)
    return join([body, paragraph(PAPER_NOTE, "soft")]) if paper else body


def full_table(rows: Sequence[Row], colors: Mapping[str, str]) -> Html:
    """Every metric in a row, every method in a column."""
    lines = lines_of(rows)
    headers = [
        escape("metric"),
        *(
            element(
                "th",
                Html(f"{dot(colors[line.method])}{escape(line.method)}"),
                scope="col",
                data_series=line.method,
            )
            for line in lines
        ),
    ]
    body = []
    order = [*GROUPS, ""]
    group = None
    for metric in sorted(
        numbers(), key=lambda m: order.index(m.group if m.group in GROUPS else "")
    ):
        if metric.group != group:
            group = metric.group
            title = escape(GROUPS.get(group, "Other").partition(":")[0])
            span = str(len(lines) + 1)
            body.append([element("th", title, scope="rowgroup", colspan=span, class_="group")])
        top = best(lines, metric)
        title = element("span", escape(metric.name), title=metric.meaning)
        unit = element("small", escape(" ".join(filter(None, (metric.unit, metric.sign)))))
        named = element("th", Html(f"{title} {unit}"), scope="row")
        body.append(
            [
                named,
                *(
                    _value(metric, line.values[metric.name], i in top)
                    for i, line in enumerate(lines)
                ),
            ]
        )
    body.append([name_cell("status", note="frames"), *(_statuses(row) for row in rows)])
    return table(headers, body)


def finger_tables(rows: Sequence[Row], colors: Mapping[str, str]) -> Html:
    """One table for each metric of fingers, methods down, fingers across."""
    good = [row for row in rows if isinstance(row.get("fingers"), Mapping)]
    parts = []
    for metric in PER_FINGER:
        fingers = list(dict.fromkeys(f for row in good for f in row["fingers"]))
        lines = [
            Line(row_method(row), {f: row["fingers"].get(f, {}).get(metric.name) for f in fingers})
            for row in good
        ]
        if all(value is None for line in lines for value in line.values.values()):
            continue
        columns = [Metric(finger, metric.unit, metric.goal, metric.meaning) for finger in fingers]
        tops = [best(_renamed(lines, column, metric), metric) for column in columns]
        body = [
            [
                name_cell(line.method, colors[line.method]),
                *(
                    _value(metric, line.values[finger], i in top)
                    for finger, top in zip(fingers, tops, strict=True)
                ),
            ]
            for i, line in enumerate(lines)
        ]
        unit = " ".join(filter(None, (metric.unit, metric.sign)))
        title = escape(f"{metric.name.removesuffix('_mm').replace('_', ' ')} {unit}")
        parts.append(table([title, *(escape(f) for f in fingers)], body))
        parts.append(paragraph(_sentence(metric.meaning), "soft"))
    return join(parts)


def failure_table(rows: Iterable[Row]) -> Html:
    """Cells that failed, with the reason."""
    body = [
        [
            name_cell(where),
            Html(escape(methods)),
            failed_cell(reason),
        ]
        for where, methods, reason in failures(rows)
    ]
    return table([escape(h) for h in ("recording and hand", "methods", "reason")], body, "words")


def comparison_tables(comparison: Comparison) -> Html:
    """Cell by cell: headlines in sight, the rest folded away."""
    parts = [
        paragraph(
            f"Against {comparison.name}: {comparison.count('better')} figures better, "
            f"{comparison.count('worse')} worse, {comparison.count('same')} the same (within "
            "0.5 % of the value, or of its distance from 1 where that is best; latencies within "
            "10 %). Differences are this benchmark minus the other."
        )
    ]
    body = [
        [
            _cell_name(cell),
            *(_change(_find(cell, metric)) for metric in columns()),
        ]
        for cell in comparison.cells
    ]
    if body:
        parts.append(table([escape("cell"), *(header(m) for m in columns())], body))
    for cell in comparison.cells:
        changed = [change for change in cell.changes if change.now != change.before]
        if changed:
            rows = [
                [
                    name_cell(change.metric.name, note=change.metric.unit),
                    Html(escape(shown_value(change.metric, change.before))),
                    Html(escape(shown_value(change.metric, change.now))),
                    _change(change),
                ]
                for change in changed
            ]
            inside = table([escape(h) for h in ("metric", "before", "now", "difference")], rows)
            parts.append(details(f"All differences: {_key_text(cell.key)}", inside))
    for title, keys in (
        ("Only in this benchmark", comparison.only_here),
        ("Only in the other", comparison.only_there),
    ):
        if keys:
            listed = join(element("li", escape(_key_text(key))) for key in keys)
            many = f"{title}: {len(keys)} cell{'s' if len(keys) > 1 else ''}"
            parts.append(details(many, element("ul", listed)))
    return join(parts)


def metric_table() -> Html:
    """Table of the metrics' meanings."""
    metrics = known_metrics()
    rest = [m for m in metrics if m.group not in GROUPS]
    rest += [m for m in PER_FINGER if m.name not in {n.name for n in metrics}]
    groups = {question: [m for m in metrics if m.group == g] for g, question in GROUPS.items()}
    body = []
    for question, own in {**groups, "Plugins and fingers": rest}.items():
        body.append(
            [element("th", escape(question), scope="rowgroup", colspan="4", class_="group")]
        )
        body += [
            [
                Html(f'<th scope="row"><code>{escape(m.name)}</code></th>'),
                escape(m.unit or "–"),
                escape(m.better or "a fact"),
                escape(_sentence(m.meaning)),
            ]
            for m in own
        ]
    return table([escape(h) for h in ("metric", "unit", "best", "what it is")], body, "words")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def facts_table(facts: Mapping[str, Any]) -> Html:
    """Names and values."""
    body = [(name, _words(value)) for name, value in facts.items()]
    return text_table(("what", "value"), body, "words")


def _table(lines: Sequence[Line], colors: Mapping[str, str], foot: Html) -> Html:
    ranks = mean_ranks(lines)
    metrics = (RANK, *columns())
    lines = [
        replace(line, values={**line.values, RANK.name: ranks.get(line.method)}) for line in lines
    ]
    tops = [best(lines, metric) for metric in metrics]
    body: list[list[Html]] = []
    for i, line in enumerate(lines):
        part = "" if line.count == line.of else f"{line.count} of {line.of} recordings"
        cells = [name_cell(line.method, colors[line.method], part if line.count else "")]
        if line.failed is not None:
            cells.append(failed_cell(line.failed, len(metrics)))
        else:
            cells += [
                _value(metric, line.values[metric.name], i in top)
                for metric, top in zip(metrics, tops, strict=True)
            ]
        body.append(cells)
    headers = [escape("method"), *(header(m) for m in metrics)]
    groups = [(title, len(own)) for title, own in COLUMN_GROUPS.items()]
    more = len(metrics) - 1 - len(COLUMNS)  # of plugins
    groups += [("plugins", more)] if more else []
    return table(headers, body, "sortable", foot, [("all", 1), *groups])


def _value(metric: Metric, value: float | None, top: bool) -> Html:
    text = escape(shown_value(metric, value))
    exact = {} if value is None else {"data_value": repr(value)}
    return element("td", text, **({"class_": "best"} if top else {}), **exact)


def _change(change: Change | None) -> Html:
    if change is None:
        return element("td", "–")
    if change.difference == 0:
        return element("td", "=")
    sign = "+" if change.difference > 0 else "−"
    text = escape(f"{sign}{abs(change.difference):.3g}")
    css = {"better": "best", "worse": "worse", "same": ""}[change.verdict]
    mark = {"better": " ▲", "worse": " ▼", "same": ""}[change.verdict]  # not by colour alone
    return element("td", Html(f"{text}{mark}"), **({"class_": css} if css else {}))


def _key_text(key: Sequence[str]) -> str:
    recording, hand, side, method, preset = key
    return f"{recording} on {hand} {side}, {method_label(method, preset)}"


def _cell_name(cell: Compared) -> Html:
    recording, hand, side, method, preset = cell.key
    below = "; ".join((f"{recording} on {hand} {side}", *cell.notes))
    inside = f"{escape(method_label(method, preset))}<br><small>{escape(below)}</small>"
    return element("th", Html(inside), scope="row", class_="wide")


def _find(cell: Compared, metric: Metric) -> Change | None:
    return next((c for c in cell.changes if c.metric.name == metric.name), None)


def _renamed(lines: Sequence[Line], column: Metric, metric: Metric) -> list[Line]:
    """Lines whose one value stands under the metric's own name, for the judge of the best."""
    return [Line(line.method, {metric.name: line.values[column.name]}) for line in lines]


def _statuses(row: Row) -> Html:
    counts = (row.get("metrics") or {}).get("status") or {}
    return escape(", ".join(f"{n} {count}" for n, count in counts.items() if count) or "–")


def _words(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(inner)}" for name, inner in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_words(inner) for inner in value)
    return "–" if value is None else str(value)


PAPER_TABLE: Final[dict[str, dict[str, float]]] = {
    "DexPilot": {
        "cosine_similarity": 0.9932, "scale_ratio": 0.885, "motion_preservation": 0.727,
        "flatness": 7.71e-6, "workspace_utilisation": 0.261, "latency_ms.p50": 4.905,
    },
    "GeoRT": {
        "cosine_similarity": 0.9799, "scale_ratio": 1.050, "motion_preservation": 0.695,
        "flatness": 3.01e-6, "workspace_utilisation": 0.352, "latency_ms.p50": 1.410,
    },
    "Hybrid": {
        "cosine_similarity": 0.9879, "scale_ratio": 0.891, "motion_preservation": 0.675,
        "flatness": 6.17e-6, "workspace_utilisation": 0.225, "latency_ms.p50": 9.892,
    },
    "SBR": {
        "cosine_similarity": 0.9969, "scale_ratio": 0.877, "motion_preservation": 0.776,
        "flatness": 7.17e-7, "workspace_utilisation": 0.210, "latency_ms.p50": 3.664,
    },
}  # fmt: skip
"""Source: the paper's table of simulation metrics. Its latency is one number a method; it stands
here under the median."""

PAPER_NOTE: Final = (
    "The paper's figures are from other data (14 operators at about 100 Hz, mimic P0.50 right, an "
    "RTX 4090) and follow its own definitions: read them as a reference, not as a row to beat."
)
