"""``report.html``: tables, the player of clips, and plots."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import file_name
from smooth_operator.hands.hand import Hand
from smooth_operator.lab.benchmark import figures, ranking
from smooth_operator.lab.benchmark.benchmark_folder import PLOTS, REPORT
from smooth_operator.lab.benchmark.comparison import Comparison
from smooth_operator.lab.benchmark.contact_sheet import (
    contact_sheet,
    panels_by_hand,
    skeleton_shape,
)
from smooth_operator.lab.benchmark.page import tables
from smooth_operator.lab.benchmark.page.summary import write_summary
from smooth_operator.lab.benchmark.panels import Panel, make_clip, make_panels
from smooth_operator.lab.benchmark.ranking import (
    Line,
    by_hand,
    by_panel,
    by_tracker,
    collision_footnotes,
    lines_of,
    overall,
    sample_text,
)
from smooth_operator.lab.benchmark.results import Row, row_method, row_unit
from smooth_operator.lab.benchmark.settings import Settings
from smooth_operator.lab.benchmark.suite import Finished
from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.hand_surface import HandShape
from smooth_operator.reporting.html import (
    Html,
    data,
    details,
    dot,
    element,
    escape,
    join,
    paragraph,
)
from smooth_operator.reporting.report_page import SORTING, Plots, write_report_page

BUSY = 0.25
"""Share of the cores in others' hands from which a latency is warned of."""

_PAPER_HAND = "mimic_p050"


def write_report(
    finished: Sequence[Finished],
    rows: Sequence[Row],
    settings: Settings,
    comparison: Comparison | None = None,
    shape: Callable[[Hand], HandShape] = skeleton_shape,
) -> Path:
    """Writes the page, its plots and the main table in Markdown into the folder of the benchmark.

    Args:
        finished: result of ``run_suite``.
        rows: result of ``make_rows``.
        settings: settings of the benchmark.
        comparison: with another benchmark.
        shape: gives the shape that a robot hand is drawn with.

    Returns:
        The page. It needs no other file, and nothing from the network.

    Raises:
        OutputError: a file can't be written.
    """
    plots = Plots(settings.output / PLOTS)
    write_summary(rows, settings)
    page = _Page(finished, rows, plots, shape)
    return page.write(settings.output / REPORT, settings, comparison)


class _Page:
    def __init__(
        self,
        finished: Sequence[Finished],
        rows: Sequence[Row],
        plots: Plots,
        shape: Callable[[Hand], HandShape],
    ) -> None:
        self._finished, self._rows, self._plots = finished, rows, plots
        self._shape = shape
        self._colors = colors_of(row_method(row) for row in rows)
        self._hands = by_hand(rows)
        self._panels = {panel.key: panel for panel in make_panels(finished)}

    def write(self, path: Path, settings: Settings, comparison: Comparison | None) -> Path:
        failed = [row for row in self._rows if row["status"] != "ok"]
        sections = [
            ("Summary", "summary", self._summary()),
            ("Poses", "poses", self._poses()),
            ("Latency", "latency", self._latency()),
        ]
        if comparison is not None:
            sections.append(("Comparison", "comparison", tables.comparison_tables(comparison)))
        sections.append(("Recordings", "recordings", self._recordings()))
        if failed:
            sections.append(("Failures", "failures", self._failures()))
        sections += [
            ("Metrics", "metrics", self._metrics(settings)),
            ("Environment", "environment", self._environment(settings)),
        ]
        here = files("smooth_operator.lab.benchmark.page")
        return write_report_page(
            path,
            "Retargeting benchmark",
            self._header(settings, len(failed)),
            sections,
            "Made by smooth-operator bench. Figures: results.json; plots as files: plots/; "
            "commands of each cell: cells/.",
            styles=(here / "player.css",),
            scripts=(here / "player.js", SORTING),
            without_scripts=".player { display: none; }",
        )

    def _header(self, settings: Settings, failed: int) -> Html:
        recordings = len({row["recording"] for row in self._rows})
        hands = len(self._hands)
        methods = len(self._colors)
        dates = sorted(str(row["date"]) for row in self._rows if row["date"])
        text = (
            f"{_count(recordings, 'recording')}, {_count(hands, 'hand')}, "
            f"{_count(methods, 'method')}: {_count(len(self._rows), 'cell')}"
            + (f", {failed} of them failed" if failed else "")
            + (f". Measured {dates[-1][:16].replace('T', ' ')} UTC" if dates else "")
        )
        return join([element("h1", "Retargeting benchmark"), paragraph(text, "soft")])

    def _summary(self) -> Html:
        parts: list[Html] = []
        for hand, rows in self._hands.items():
            count = len({row_unit(row) for row in rows if row["status"] == "ok"})
            trackers = by_tracker(rows)
            lines = overall(rows)
            several = len({row["recording"] for row in rows if row["status"] == "ok"}) > 1
            title = f"{hand}: mean over {sample_text(rows)}" if several else hand
            parts.append(element("h3", escape(title)))
            parts.append(self._verdict(lines, count))
            parts.append(tables.headline_table(lines, self._colors, paper=hand == _PAPER_HAND))
            parts += [paragraph(note, "soft") for note in collision_footnotes(rows)]
            if len(trackers) > 1:
                parts += [
                    details(
                        f"{tracker}: mean over {sample_text(own)}",
                        tables.headline_table(overall(own), self._colors),
                    )
                    for tracker, own in trackers.items()
                ]
            if several:
                parts.append(
                    paragraph(
                        "Parts of one file are one recording. A figure is the mean over the "
                        "recordings of each tracker, then over the trackers. Flatness and "
                        "workspace utilisation depend on a recording's rate and length. Methods "
                        "that failed on a recording do not compete here.",
                        "soft",
                    )
                )
            with styled():
                drawn = figures.tradeoff_figure(rows, self._colors)
            if drawn is not None:
                parts.append(
                    self._plots.element(
                        drawn,
                        f"accuracy-smoothness-{hand}",
                        "Accuracy against smoothness: the lower left corner is best. "
                        + ("Small: a recording each; large: their mean. " if several else "")
                        + "Both axes are logarithmic.",
                    )
                )
        return join(parts)

    def _poses(self) -> Html:
        """A contact sheet for each hand and side."""
        parts = []
        for (hand, side), panels in panels_by_hand(self._panels.values()).items():
            name = f"{hand} {side}"
            drawn = self._plots.picture(
                contact_sheet(panels, self._shape),
                f"sheet-{hand}-{side}",
                f"{name}: the frames that show each pose best, from the palm and from the thumb's "
                "side. Every hand stands upright on its own wrist.",
            )
            none = paragraph(f"{name}: no recording shows a pose, such as a flat hand or a fist.")
            parts.append(drawn or none)
        return join(parts)

    def _verdict(self, lines: Sequence[Line], count: int) -> Html:
        """Verdict in one sentence, with a folded explanation."""
        verdict = ranking.verdict(lines)
        if not verdict:
            return Html("")
        mind = (
            f" {_count(count, 'recording')}: on others the order may be another."
            if count < ranking.FEW
            else ""
        )
        inside = [
            paragraph(verdict),
            details("How this is decided", paragraph(ranking.RULES + mind)),
        ]
        return element("div", join(inside), class_="verdict")

    def _latency(self) -> Html:
        timed = [one for one in self._finished if one.latency is not None]
        if not timed:
            return paragraph("Latency was not measured.")
        parts = [
            paragraph(
                "Measured alone: one process, no other worker, the methods taking turns in short "
                "blocks, each in its own state, after a warm-up. Landmarks to command, without "
                "tracker, robot or network."
            )
        ]
        latencies = [one.latency for one in timed if one.latency]
        shares = [latency.others for latency in latencies if latency.others is not None]
        loads = [latency.load for latency in latencies if latency.load is not None]
        if shares or loads:
            text = (
                [f"other processes took up to {100 * max(shares):.0f} % of the cores"]
                if shares
                else []
            )
            text += [f"load average {min(loads):.2f} to {max(loads):.2f}"] if loads else []
            busy = bool(shares) and max(shares) > BUSY
            warned = ": the machine was busy, so take these for upper bounds" if busy else ""
            parts.append(
                paragraph(f"Meanwhile {', '.join(text)}{warned}.", "warning" if busy else "soft")
            )
        for hand in self._hands:
            samples: dict[str, list[Float[np.ndarray, " N"]]] = {}
            for one, row in zip(self._finished, self._rows, strict=True):
                if one.latency is not None and row["hand"] == hand:
                    samples.setdefault(row_method(row), []).append(one.latency.samples_ms)
            with styled():
                drawn = figures.latency_figure(samples, self._colors)
            if drawn is not None:
                parts.append(
                    self._plots.element(
                        drawn,
                        f"latency-{hand}",
                        f"Each dot is a frame on {hand}, all recordings together; the lines are "
                        "means of the recordings' percentiles, as in the table; the number is the "
                        "median.",
                    )
                )
        return join(parts)

    def _recordings(self) -> Html:
        groups = {
            key: rows
            for key, rows in by_panel(self._rows).items()
            if any(row["status"] == "ok" for row in rows)  # the others stand under failures
        }
        parts = []
        for i, (key, rows) in enumerate(groups.items()):
            recording, hand, side = key
            inside = [tables.headline_table(lines_of(rows), self._colors), _facts(rows[0])]
            panel = self._panels.get(key)
            if panel is not None:
                inside += self._panel(panel, rows)
            title = f"{recording} on {hand} {side}"
            content = join(inside)
            if len(groups) == 1:
                parts.append(Html(f"<h3>{escape(title)}</h3>{content}"))
            else:
                parts.append(details(title, content, opened=i == 0, class_="recording"))
        return join(parts)

    def _panel(self, panel: Panel, rows: Sequence[Row]) -> list[Html]:
        name = file_name("-".join(panel.key), panel.key)
        hands = sum(len(p.runs) + 1 for p in self._panels.values())
        parts = [player(make_clip(panel, self._colors, hands))]
        with styled():
            tips = figures.fingertip_figure(panel, self._colors)
            joints = figures.joint_figure(panel, self._colors)
        parts.append(
            self._plots.element(
                tips,
                f"fingertips-{name}",
                f"Fingertips in the palm frame over the {figures.TRAJECTORY_SECONDS:g} s in which "
                "the human's travel furthest; the human (grey) as the first method saw it.",
            )
        )
        drawn = self._plots.element(
            joints, f"joints-{name}", "Joint positions in the same stretch; dashed: their limits."
        )
        good = [row for row in rows if row["status"] == "ok"]
        parts.append(details("Joint trajectories", drawn))
        parts.append(details("Finger by finger", tables.finger_tables(good, self._colors)))
        parts.append(details("All metrics", tables.full_table(good, self._colors)))
        return parts

    def _failures(self) -> Html:
        words = "These have no figures; everything else went on without them. They are tried again "
        words += "when the same command is run again."
        return join([paragraph(words), tables.failure_table(self._rows)])

    def _metrics(self, settings: Settings) -> Html:
        words = {
            "sound": "The human is aligned as the method saw it, figures are means over frames, "
            "and motion is compared where both hands move.",
            "paper": "As published: the human is fitted to the robot's own pose in every frame, "
            "cosine similarity and scale ratio are medians, and still frames count in motion "
            "preservation.",
        }
        text = f"Definition “{settings.definition}”. {words[settings.definition]}"
        return join([paragraph(text), tables.metric_table()])

    def _environment(self, settings: Settings) -> Html:
        machines: dict[str, dict[str, object]] = {}
        for row in self._rows:
            if row["status"] == "ok":
                facts = {**(row["hardware"] or {}), **(row["versions"] or {})}
                machines.setdefault(repr(sorted(facts.items())), facts)
        parts = []
        if len(machines) > 1:
            parts.append(
                paragraph(
                    "The cells were not all made on the same machine with the same versions.",
                    "warning",
                )
            )
        parts += [tables.facts_table(facts) for facts in machines.values()]
        settings_table = {
            "recordings": settings.recordings,
            "hands": settings.hands,
            "methods": settings.methods,
            "frames": settings.frames or "all, but where a recording says otherwise",
            "seed": settings.seed,
            "definition": settings.definition,
            "latency frames": settings.latency_frames,
        }
        parts += [element("h3", "Asked for"), tables.facts_table(settings_table)]
        return join(parts)


def _facts(row: Row) -> Html:
    source = row["source"]
    facts = []
    if source["frames"]:
        facts.append(f"frames {source['frames'][0]} to {source['frames'][1] - 1}")
    if source["rate_hz"]:
        facts.append(f"{source['rate_hz']:.4g} Hz, {source['duration_s']:.3g} s")
    if source["side_assumed"]:
        facts.append("taken for a right hand, since it does not say")
    return paragraph("; ".join(facts) + "." if facts else "", "soft")


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def player(clip: Mapping[str, object]) -> Html:
    """One pane a method, with play, pause, a slider and a speed.

    Args:
        clip: result of ``make_clip``.
    """
    panes = clip["panes"]
    assert isinstance(panes, list)
    shown = join(
        element(
            "div",
            Html(
                f'<canvas role="img" aria-label="{escape(pane["method"])}: human and robot hand">'
                f"</canvas><span>{dot(pane['color'])}"
                f"{escape(pane['method'])}</span>"
            ),
            class_="pane",
        )
        for pane in panes
    )
    controls = Html(
        '<button type="button">Play</button>'
        '<input type="range" min="0" value="0" aria-label="frame">'
        "<output></output>"
        '<select aria-label="speed"><option value="1">1 ×</option>'
        '<option value="0.5">½ ×</option><option value="0.25">¼ ×</option></select>'
    )
    hint = paragraph(
        "Grey: the human as the method saw it; coloured: the robot. Drag to turn, double-click to "
        "turn back.",
        "soft",
    )
    inside = join(
        [
            data(clip),
            element("div", shown, class_="panes"),
            element("div", controls, class_="controls"),
            hint,
        ]
    )
    return element("div", inside, class_="player")
