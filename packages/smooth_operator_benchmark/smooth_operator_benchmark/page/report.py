"""Writes the report of a benchmark: ``report.html`` with tables, clips and plots, and
``summary.md``.

The sections of the page are Jinja2 templates."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write, file_name
from smooth_operator.errors import counted
from smooth_operator.hands.hand import Hand
from smooth_operator.metrics import Metric
from smooth_operator.metrics.table import GROUPS, known_metrics
from smooth_operator.reporting.drawing import colors_of, method_label, styled
from smooth_operator.reporting.report_page import (
    SORTING,
    Html,
    Plots,
    data,
    element,
    join,
    paragraph,
    templates,
    write_report_page,
)
from smooth_operator.reporting.run_plots import (
    TRAJECTORY_SECONDS,
    Panel,
    fingertip_figure,
    joint_figure,
    latency_figure,
)
from smooth_operator_benchmark import figures, ranking
from smooth_operator_benchmark.cells import Settings
from smooth_operator_benchmark.contact_sheet import (
    contact_sheet,
    panels_by_hand,
    skeleton_shape,
)
from smooth_operator_benchmark.figures import make_clip, make_panels
from smooth_operator_benchmark.hand_surface import HandShape
from smooth_operator_benchmark.quality import PER_FINGER
from smooth_operator_benchmark.ranking import (
    COLUMN_GROUPS,
    COLUMNS,
    HEADLINES,
    RANK,
    Comparison,
    Line,
    best,
    by_hand,
    columns,
    lines_of,
    numbers,
    overall,
    sample_text,
    shown_value,
)
from smooth_operator_benchmark.suite import PLOTS, REPORT, Finished, Row, row_method, row_unit

SUMMARY: Final = "summary.md"
_LEFT_OUT: Final = ("scale_ratio", "workspace_utilisation")


def write_summary(rows: Sequence[Row], settings: Settings) -> Path:
    """Writes ``summary.md``, which has the main table for each hand with its recordings, date and
    command. Raises OutputError if the file can't be written."""
    path = settings.output / SUMMARY
    with atomic_write(path) as file:
        file.write(summary_text(rows, settings).encode())
    return path


def summary_text(rows: Sequence[Row], settings: Settings) -> str:
    """Text of ``summary.md``; see ``write_summary``."""
    metrics = [metric for metric in COLUMNS if metric.name not in _LEFT_OUT]
    parts = []
    for hand, own in by_hand(rows).items():
        lines = [line for line in overall(own) if line.failed is None]
        heads = [" ".join(filter(None, (m.short, m.unit, m.sign))) for m in metrics]
        table = [["method", *heads]]
        tops = _tops(lines, metrics)
        for i, line in enumerate(lines):
            values = [_short(m, line.values.get(m.name)) for m in metrics]
            marked = [f"**{v}**" if i in top else v for v, top in zip(values, tops, strict=True)]
            name = f"`{line.method}`"
            partly = "" if line.count == line.of else f" ({line.count} of {line.of})"
            table.append([name + partly, *marked])
        day = max((str(row["date"])[:10] for row in own if row["date"]), default="")
        words = f"{hand}, n = {sample_text(own)}; mean over trackers. {day}:"
        text = [f"| {' | '.join(cells)} |" for cells in table]
        text.insert(1, f"|---|{'---:|' * len(metrics)}")
        parts.append("\n".join(text) + f"\n\n{words}")
    return "\n\n".join([*parts, f"```bash\n{command_of(settings)}\n```"]) + "\n"


def _short(metric: Metric, value: float | None) -> str:
    """Formats a value with three digits."""
    if value is None or metric.name.endswith("share"):
        return shown_value(metric, value)
    return f"{value:.3f}" if metric.goal == "->1" else f"{value:.3g}"


def command_of(settings: Settings) -> str:
    """The command that ran a benchmark; recordings are named without their folders."""
    names = [Path(text).name for text in settings.recordings]
    words = ["smooth-operator", "bench", *names, "--methods", ",".join(settings.methods)]
    words += ["--hands", ",".join(settings.hands)]
    if settings.definition != "sound":
        words += ["--definition", settings.definition]
    return shlex.join([*words, "--output", settings.output.name])


BUSY: Final = 0.25
"""Fraction of the cores used by other processes above which the report warns about latency."""

_PAPER_HAND: Final = "mimic_p050"

PAPER_TABLE: Final[dict[str, dict[str, float]]] = {
    method: dict(zip((metric.name for metric in HEADLINES), values, strict=True))
    for method, values in {
        "DexPilot": (0.9932, 0.885, 0.727, 7.71e-6, 0.261, 4.905),
        "GeoRT": (0.9799, 1.050, 0.695, 3.01e-6, 0.352, 1.410),
        "Hybrid": (0.9879, 0.891, 0.675, 6.17e-6, 0.225, 9.892),
        "SBR": (0.9969, 0.877, 0.776, 7.17e-7, 0.210, 3.664),
    }.items()
}
"""Numbers of the paper's table of simulation metrics. The paper has one latency per method, which
is shown here in the column of the median."""

PAPER_NOTE: Final = (
    "The Smooth Operator paper's numbers were measured on other data (14 operators at about 100 "
    "Hz, mimic P0.50 right, an RTX 4090) with the paper's own definitions. They are for reference "
    "and can't be compared directly."
)


def macros(**context: Any) -> Any:
    """Returns the macros of the page template, which can use ``context`` and some functions."""
    template = templates(__package__).get_template("sections.html.j2")
    shared = {
        "best": best,
        "columns": columns,
        "data": data,
        "finger_lines": _finger_lines,
        "groups": _column_groups,
        "label": method_label,
        "numbers": _numbers,
        "paper": PAPER_TABLE,
        "paper_note": PAPER_NOTE,
        "place": _place,
        "rank": RANK,
        "ranked": _ranked,
        "sentence": _sentence,
        "shown": shown_value,
        "tops": _tops,
        "words": _words,
    }
    return template.make_module({**shared, **context})


def write_report(
    finished: Sequence[Finished],
    rows: Sequence[Row],
    settings: Settings,
    comparison: Comparison | None = None,
    shape: Callable[[Hand], HandShape] = skeleton_shape,
) -> Path:
    """Writes the page, its plots and the main table in Markdown to the folder of the benchmark.

    Args:
        finished: result of ``run_suite``.
        rows: result of ``make_rows``.
        shape: returns the shape with which a robot hand is drawn.

    Returns:
        The page. It needs no other file, and nothing from the network.

    Raises:
        OutputError: a file can't be written.
    """
    plots = Plots(settings.output / PLOTS)
    write_summary(rows, settings)
    colors = colors_of(row_method(row) for row in rows)
    panels = {panel.key: panel for panel in make_panels(finished)}
    failed = [row for row in rows if row["status"] != "ok"]
    content = macros(
        colors=colors,
        hands=[_hand(hand, own, colors, plots) for hand, own in ranking.by_hand(rows).items()],
        sheets=list(_sheets(panels, shape, plots)),
        timing=_timing(finished, rows, colors, plots),
        former=comparison,
        panels=list(_recordings(rows, panels, colors, plots)),
        failed=ranking.failures(rows),
        definition=settings.definition,
        meanings=_meanings(),
        machines=_machines(rows),
        settings={
            "recordings": settings.recordings,
            "hands": settings.hands,
            "methods": settings.methods,
            "frames": settings.frames
            or "all frames, except for recordings with their own range of frames",
            "seed": settings.seed,
            "definition": settings.definition,
            "latency frames": settings.latency_frames,
        },
    )
    names = ["summary", "poses", "latency", *(["comparison"] if comparison else []), "recordings"]
    names += [*(["failures"] if failed else []), "metrics", "environment"]
    here = files(__package__)
    return write_report_page(
        settings.output / REPORT,
        "Retargeting benchmark",
        _heading(rows, len(failed)),
        [(name.capitalize(), name, Html(str(getattr(content, name)()))) for name in names],
        "Made by smooth-operator bench. The numbers are in results.json, the plots in plots/ and "
        "the commands of each row in cells/.",
        styles=(here / "player.css",),
        scripts=(here / "player.js", SORTING),
        without_scripts=".player { display: none; }",
    )


def _heading(rows: Sequence[Row], failed: int) -> Html:
    dates = sorted(str(row["date"]) for row in rows if row["date"])
    counts = (
        ("recording", len({row["recording"] for row in rows})),
        ("hand", len(ranking.by_hand(rows))),
        ("method", len({row_method(row) for row in rows})),
    )
    text = f"{', '.join(counted(n, what) for what, n in counts)}: {counted(len(rows), 'row')}"
    text += f", of which {failed} failed" if failed else ""
    text += f". Measured {dates[-1][:16].replace('T', ' ')} UTC" if dates else ""
    return join([element("h1", "Retargeting benchmark"), paragraph(text, "soft")])


def _hand(
    hand: str, rows: Sequence[Row], colors: Mapping[str, str], plots: Plots
) -> dict[str, Any]:
    """Content of the summary of a hand."""
    good = [row for row in rows if row["status"] == "ok"]
    count, several = len({row_unit(row) for row in good}), len({r["recording"] for r in good}) > 1
    lines, trackers = overall(rows), ranking.by_tracker(rows)
    mind = f" {counted(count, 'recording')}; the ranking may differ on other recordings."
    with styled():
        drawn = figures.tradeoff_figure(rows, colors)
    caption = "Accuracy against smoothness: the lower left corner is best. "
    caption += (
        "Small symbols are single recordings; large symbols are their mean. " if several else ""
    )
    caption += "Both axes are logarithmic."
    return {
        "title": f"{hand}: mean over {ranking.sample_text(rows)}" if several else hand,
        "lines": lines,
        "several": several,
        "paper": hand == _PAPER_HAND,
        "verdict": ranking.verdict(lines),
        "rules": ranking.RULES + (mind if count < ranking.FEW else ""),
        "notes": ranking.footnotes(rows),
        "trackers": [
            (f"{tracker}: mean over {ranking.sample_text(own)}", overall(own))
            for tracker, own in trackers.items()
            if len(trackers) > 1
        ],
        "plot": plots.element(drawn, f"accuracy-smoothness-{hand}", caption),
    }


def _sheets(
    panels: Mapping[Any, Panel], shape: Callable[[Hand], HandShape], plots: Plots
) -> Iterator[tuple[str, Html]]:
    """Yields a contact sheet for each hand and side; empty if no pose was found."""
    for (hand, side), own in panels_by_hand(panels.values()).items():
        name = f"{hand} {side}"
        caption = (
            f"{name}: the frames that show each pose best, seen from the palm and from the thumb's "
            "side. Every hand is drawn upright, relative to its own wrist."
        )
        yield name, plots.picture(contact_sheet(own, shape), f"sheet-{hand}-{side}", caption)


def _timing(
    finished: Sequence[Finished], rows: Sequence[Row], colors: Mapping[str, str], plots: Plots
) -> dict[str, Any] | None:
    """Content of the section on latency; None if it was not measured."""
    timed = [
        (one.latency, row)
        for one, row in zip(finished, rows, strict=True)
        if one.latency is not None
    ]
    if not timed:
        return None
    shares = [latency.others for latency, _ in timed if latency.others is not None]
    loads = [latency.load for latency, _ in timed if latency.load is not None]
    busy = bool(shares) and max(shares) > BUSY
    parts = [f"other processes used up to {100 * max(shares):.0f} % of the cores"] if shares else []
    parts += [f"load average {min(loads):.2f} to {max(loads):.2f}"] if loads else []
    warning = ": the machine was busy, so the latencies are upper bounds" if busy else ""
    drawings = []
    for hand in ranking.by_hand(rows):
        samples: dict[str, list[np.ndarray]] = {}
        for latency, row in timed:
            if row["hand"] == hand:
                samples.setdefault(row_method(row), []).append(latency.samples_ms)
        with styled():
            drawn = latency_figure(samples, colors)
        caption = (
            f"Each dot is a frame on {hand}, from all recordings. The lines are means of the "
            "recordings' percentiles, as in the table. The number is the median."
        )
        drawings.append(plots.element(drawn, f"latency-{hand}", caption))
    text = f"During the measurement: {', '.join(parts)}{warning}." if parts else ""
    return {"text": text, "busy": busy, "plots": drawings}


def _recordings(
    rows: Sequence[Row], panels: Mapping[Any, Panel], colors: Mapping[str, str], plots: Plots
) -> Iterator[dict[str, Any]]:
    """Content of each recording on a hand. Recordings on which all methods failed are listed under
    failures."""
    hands = sum(len(panel.runs) + 1 for panel in panels.values())
    for key, own in ranking.by_panel(rows).items():
        good = [row for row in own if row["status"] == "ok"]
        if not good:
            continue
        content: dict[str, Any] = {
            "title": _place(key),
            "lines": lines_of(own),
            "facts": _facts(own[0]),
            "good": good,
            "lines_good": lines_of(good),
            "statuses": list(map(_statuses, good)),
            "clip": None,
        }
        panel = panels.get(key)
        if panel is not None:
            stem = file_name("-".join(key), key)
            with styled():
                tips = fingertip_figure(panel, colors)
                joints = joint_figure(panel, colors)
            content["clip"] = make_clip(panel, colors, hands)
            content["tips"] = plots.element(
                tips,
                f"fingertips-{stem}",
                f"Fingertips in the palm frame over the {TRAJECTORY_SECONDS:g} s in which "
                "the human's fingertips travel the farthest. The human hand (grey) is aligned "
                "with the settings of the first method.",
            )
            caption = "Joint positions in the same period; dashed lines are the joint limits."
            content["joints"] = plots.element(joints, f"joints-{stem}", caption)
        yield content


def _machines(rows: Sequence[Row]) -> list[dict[str, object]]:
    """Machines and versions with which the cells were measured, without duplicates."""
    machines: dict[str, dict[str, object]] = {}
    for row in rows:
        if row["status"] == "ok":
            facts = {**(row["hardware"] or {}), **(row["versions"] or {})}
            machines.setdefault(repr(sorted(facts.items())), facts)
    return list(machines.values())


def _facts(row: Row) -> str:
    source = row["source"]
    facts = []
    if source["frames"]:
        facts.append(f"frames {source['frames'][0]} to {source['frames'][1] - 1}")
    if source["rate_hz"]:
        facts.append(f"{source['rate_hz']:.4g} Hz, {source['duration_s']:.3g} s")
    if source["side_assumed"]:
        facts.append("assumed to be a right hand, because the recording does not state a side")
    return "; ".join(facts) + "." if facts else ""


# What the macros call.


def _ranked(lines: Sequence[Line]) -> list[Line]:
    ranks = ranking.mean_ranks(lines)
    return [replace(one, values={**one.values, RANK.name: ranks.get(one.method)}) for one in lines]


def _tops(lines: Sequence[Line], metrics: Sequence[Metric]) -> list[set[int]]:
    return [best(lines, metric) for metric in metrics]


def _column_groups() -> list[tuple[str, int]]:
    """Title of each group of the main columns, with its number of columns."""
    more = len(columns()) - len(COLUMNS)
    groups = [("all", 1), *((title, len(own)) for title, own in COLUMN_GROUPS.items())]
    return [*groups, ("plugins", more)] if more else groups


def _numbers() -> dict[str, list[Metric]]:
    """All metrics that are numbers, by the title of their group."""
    groups: dict[str, list[Metric]] = {title.partition(":")[0]: [] for title in GROUPS.values()}
    for metric in numbers():
        title = GROUPS.get(metric.group, "Other").partition(":")[0]
        groups.setdefault(title, []).append(metric)
    return {title: own for title, own in groups.items() if own}


def _meanings() -> dict[str, list[Metric]]:
    """All metrics, by the question that their group answers."""
    metrics = known_metrics()
    groups = {question: [m for m in metrics if m.group == g] for g, question in GROUPS.items()}
    rest = [m for m in metrics if m.group not in GROUPS]
    rest += [m for m in PER_FINGER if m.name not in {n.name for n in metrics}]
    return {**groups, "Plugins and fingers": rest}


def _finger_lines(
    rows: Sequence[Row],
) -> Iterator[tuple[Metric, list[str], dict[str, list[tuple[float | None, bool]]]]]:
    """Rows of the table of fingers: metric, fingers and, for each method, the values of the
    fingers, with a mark for the best."""
    good = [row for row in rows if isinstance(row.get("fingers"), Mapping)]
    fingers = list(dict.fromkeys(finger for row in good for finger in row["fingers"]))
    for metric in PER_FINGER:
        values = {
            finger: [row["fingers"].get(finger, {}).get(metric.name) for row in good]
            for finger in fingers
        }
        if all(value is None for column in values.values() for value in column):
            continue
        tops = {
            finger: best([Line("", {metric.name: value}) for value in column], metric)
            for finger, column in values.items()
        }
        table = {
            row_method(row): [(values[finger][i], i in tops[finger]) for finger in fingers]
            for i, row in enumerate(good)
        }
        yield metric, fingers, table


def _statuses(row: Row) -> str:
    counts = (row.get("metrics") or {}).get("status") or {}
    return ", ".join(f"{n} {count}" for n, count in counts.items() if count) or "–"


def _place(key: Sequence[str]) -> str:
    return "{} on {} {}".format(*key[:3])


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _words(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(inner)}" for name, inner in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_words(inner) for inner in value)
    return "–" if value is None else str(value)
