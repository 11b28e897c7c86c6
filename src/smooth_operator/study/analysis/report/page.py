"""``report.html``, and the figures as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.html import Html, details, element, escape, join, paragraph
from smooth_operator.reporting.report_page import Plots, write_report_page
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.citations import CITATIONS
from smooth_operator.study.analysis.methods_text import methods_paragraph
from smooth_operator.study.analysis.report import curves, figures, report_tables
from smooth_operator.study.analysis.report.conclusion import conclusion
from smooth_operator.study.analysis.results import MODES, Mode, Outcome, ScopeResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT: Final = "report.html"
FIGURES: Final = "figures"

_TITLES: Final[dict[Outcome, str]] = {
    "success": "Success",
    "time": "Completion time",
    "tlx": "Workload",
}
_MODES: Final[dict[Mode, str]] = {
    "small-sample": "mode small-sample: what to report",
    "paper": "mode paper: as published, for many operators",
}


def write_report(analysis: Analysis, folder: Path) -> Path:
    """Writes the page and its figures.

    Args:
        analysis: of the study.
        folder: exists.

    Returns:
        The page. It needs no other file, and nothing from the network.

    Raises:
        OutputError: a file can't be written.
    """
    return _Page(analysis, Plots(folder / FIGURES)).write(folder / REPORT)


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]  # capitalize() would lower the name of the task


class _Page:
    def __init__(self, analysis: Analysis, plots: Plots) -> None:
        self._analysis, self._plots = analysis, plots
        self._colors = colors_of(analysis.retargeters)

    def write(self, path: Path) -> Path:
        sections = [
            ("Success", "success", self._outcome("success")),
            ("Time", "time", self._outcome("time")),
            ("Workload", "workload", self._outcome("tlx")),
            ("Learning", "learning", self._learning()),
            ("Operators", "operators", self._operators()),
        ]
        if self._analysis.spearman:
            sections.append(("Simulation", "simulation", self._simulation()))
        sections.append(("Methods", "methods", self._methods()))
        return write_report_page(
            path,
            "User study",
            self._header(),
            sections,
            "Made by smooth-operator study analyze. Figures: results.json and the CSV tables; "
            "plots as files: figures/.",
        )

    def _header(self) -> Html:
        analysis = self._analysis
        data = analysis.data
        operators = len({str(name) for name in data.trials.operator})
        said = (
            f"{operators} operators, {len(data.trials)} trials, "
            f"{len(data.questionnaires or ())} questionnaires; "
            f"{', '.join(analysis.retargeters)}; baseline {analysis.baseline}"
        )
        notes = [paragraph(note, "warning") for note in data.notes]
        found = join(paragraph(line) for line in conclusion(analysis))
        top = [element("h1", "User study"), paragraph(said, "soft")]
        top += [element("div", found, class_="verdict")] if found else []
        top += notes
        return join(top)

    def _outcome(self, outcome: Outcome) -> Html:
        analysis = self._analysis
        parts = []
        if outcome == "success":
            parts.append(self._drawn(
                figures.success_figure, "success",
                "Estimated success rates (score of at least 0.5) with 95 % intervals, mode "
                "small-sample. Hatched: observed rates, where the model was refused.",
            ))  # fmt: skip
        elif outcome == "time":
            parts.append(self._drawn(
                figures.time_figure, "time",
                "Completion times of successful trials: median, quartiles, and every trial.",
            ))  # fmt: skip
        else:
            parts.append(self._drawn(
                figures.radar_figure, "tlx-radar",
                "The six scales of the NASA-TLX; a smaller area is less workload. Below, workload "
                f"is their {'unweighted' if analysis.workload == 'raw' else 'weighted'} mean.",
            ))  # fmt: skip
        for i, scope in enumerate(analysis.scopes):
            by_mode = {mode: analysis.results[mode][outcome][scope] for mode in MODES}
            content = self._scope(outcome, by_mode)
            parts.append(details(
                _upper(figures.scope_name(scope)), content, opened=i == 0, class_="recording"
            ))  # fmt: skip
        return join(parts)

    def _scope(self, outcome: Outcome, by_mode: dict[Mode, ScopeResult]) -> Html:
        parts = []
        for mode, result in by_mode.items():
            if result.refused is None:
                inside = [
                    report_tables.means_table(
                        outcome, result, self._colors, self._analysis.baseline
                    )
                ]
                inside.append(details("All pairs", report_tables.pairs_table(outcome, result)))
                inside.append(details("Coefficients", report_tables.coefficients_table(result)))
            else:
                inside = [report_tables.observed_table(outcome, result, self._colors)]
            if mode == MODES[0] or result.warnings != by_mode[MODES[0]].warnings:
                inside.insert(0, report_tables.warning_list(result))
            parts.append(element("h3", escape(_MODES[mode])))
            parts += inside
        result = by_mode[MODES[0]]
        if result.refused is None:
            parts.append(report_tables.model_facts(result))
        return join(parts)

    def _learning(self) -> Html:
        drawn = self._drawn(
            curves.learning_figure, "learning",
            "Means over trials by retargeter; dashed: the slope for all of them, adjusted for "
            "retargeter and task, with its p-value in mode small-sample.",
        )  # fmt: skip
        return join([drawn, report_tables.learning_table(self._analysis.learning)])

    def _operators(self) -> Html:
        parts = [paragraph("Each dot is an operator's mean; the bar is the median of operators.")]
        for outcome, title in _TITLES.items():
            parts.append(self._drawn(
                lambda analysis, colors, o=outcome: curves.violin_figure(analysis, colors, o),
                f"operators-{outcome}",
                f"{title} by operator.",
            ))  # fmt: skip
        return join(parts)

    def _simulation(self) -> Html:
        drawn = self._drawn(
            lambda analysis, colors: figures.correlation_figure(analysis), "correlations",
            "Spearman's ρ of simulation metrics with outcomes, over operators and retargeters, "
            "with 95 % intervals of a bootstrap over operators.",
        )  # fmt: skip
        refused = [
            paragraph(f"{pair}: {entry['refused']}", "warning")
            for pair, entry in self._analysis.spearman.items()
            if "refused" in entry
        ]
        return join([drawn, *refused])

    def _methods(self) -> Html:
        entries = [
            element(
                "li", Html(f"<b>{escape(c.method)}</b> [{escape(c.key)}]. {escape(c.reference)}")
            )
            for c in CITATIONS
        ]
        return join(
            [
                paragraph("To paste into a manuscript:"),
                element("blockquote", paragraph(methods_paragraph(self._analysis)), id="paragraph"),
                element("h3", "What was used, and whom to cite"),
                element("ul", join(entries)),
            ]
        )

    def _drawn(self, draw: object, stem: str, caption: str) -> Html:
        with styled():
            drawn: Figure | None = draw(self._analysis, self._colors)  # type: ignore[operator]
        return self._plots.element(drawn, stem, caption)
