"""``report.html``, and the figures as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.html import Html, details, join, paragraph, text_table
from smooth_operator.reporting.report_page import Plots, templates, write_report_page
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.citations import cited
from smooth_operator.study.analysis.methods_text import methods_paragraph
from smooth_operator.study.analysis.report import figures, sections, tables
from smooth_operator.study.analysis.report.conclusion import NAMES, conclusion
from smooth_operator.study.analysis.results import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT: Final = "report.html"
FIGURES: Final = "figures"


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


class _Page:
    def __init__(self, analysis: Analysis, plots: Plots) -> None:
        self._analysis, self._plots = analysis, plots
        self._colors = colors_of(analysis.retargeters)
        self._macros = templates(__package__ or "").get_template("sections.html.j2").module

    def write(self, path: Path) -> Path:
        analysis = self._analysis
        text = methods_paragraph(analysis)
        analysed = len({str(name) for name in analysis.data.trials.operator})
        parts = [
            ("Success", "success", self._outcome("success")),
            ("Time", "time", self._outcome("time")),
            ("Workload", "workload", self._outcome("tlx")),
            ("Learning", "learning", self._learning()),
            ("Operators", "operators", self._operators()),
            (
                "Other readings",
                "readings",
                self._made("readings", analysis, self._incidence(), sections, tables, NAMES),
            ),
        ]
        if analysis.spearman:
            parts.append(("Simulation", "simulation", self._simulation()))
        flow = analysis.data.flow
        parts += [
            (
                "Participants",
                "participants",
                self._made("participants", analysis, flow, analysed, text_table),
            ),
            ("Checks", "checks", self._checks()),
            ("Methods", "methods", self._made("methods", text, cited(text))),
            (
                "Appendix: as published",
                "published",
                self._made("published", analysis, self._colors, tables, NAMES),
            ),
        ]
        return write_report_page(
            path,
            "User study",
            self._made("header", analysis, analysed, conclusion(analysis)),
            parts,
            "Made by smooth-operator study analyze. Figures: results.json and the CSV tables; "
            "plots as files: figures/.",
        )

    def _made(self, macro: str, *values: object) -> Html:
        """HTML of a macro of the template."""
        return Html(str(getattr(self._macros, macro)(*values)))

    def _outcome(self, outcome: Outcome) -> Html:
        drawn = self._figure_of(outcome)
        return self._made("outcome_section", outcome, drawn, self._analysis, self._colors, tables)

    def _incidence(self) -> Html:
        return self._drawn(
            figures.incidence_figure, "time-to-success",
            "Share of all trials that have succeeded by a time.",
        )  # fmt: skip

    def _figure_of(self, outcome: Outcome) -> Html:
        if outcome == "success":
            return self._drawn(
                figures.success_figure, "success",
                "Estimated success rates (score of at least 0.5) with 95 % intervals. Thin lines: "
                "observed rates, one line an operator. Hollow: observed, the model was refused.",
            )  # fmt: skip
        if outcome == "time":
            return self._drawn(
                figures.time_figure, "time",
                "Completion times of successful trials: median, quartiles, and every trial.",
            )  # fmt: skip
        kind = "unweighted" if self._analysis.workload == "raw" else "weighted"
        dots = self._drawn(
            figures.item_figure, "tlx-items",
            "The six scales of the NASA-TLX with 95 % intervals. Workload, below, is their "
            f"{kind} mean.",
        )  # fmt: skip
        radar = self._drawn(
            figures.radar_figure, "tlx-radar",
            "The same as radars, as papers show them. Read differences above: an area grows with "
            "the square of the answers and depends on the order of the scales.",
        )  # fmt: skip
        return join([dots, details("As radars", radar)]) if dots else dots

    def _checks(self) -> Html:
        drawn = self._drawn(
            figures.residual_figure, "residuals",
            "Residuals of the models of all tasks (random effects taken out): over the fitted "
            "value, where they should spread alike, and by quantiles, where they should follow "
            "the line.",
        )  # fmt: skip
        return drawn or paragraph("The models are refused: there are no residuals.")

    def _learning(self) -> Html:
        drawn = self._drawn(
            figures.learning_figure, "learning",
            "Means over trials by retargeter; dashed: the slope for all of them, adjusted for "
            "retargeter and task, with its uncorrected p-value.",
        )  # fmt: skip
        return join([drawn, tables.learning_table(self._analysis.learning)])

    def _operators(self) -> Html:
        parts = [paragraph("Each dot is an operator's mean; the bar is the median of operators.")]
        for outcome, title in NAMES.items():
            parts.append(self._drawn(
                lambda analysis, colors, o=outcome: figures.violin_figure(analysis, colors, o),
                f"operators-{outcome}",
                f"{title} by operator.",
            ))  # fmt: skip
        return join(parts)

    def _simulation(self) -> Html:
        drawn = self._drawn(
            lambda analysis, colors: figures.correlation_figure(analysis), "correlations",
            "Spearman's ρ of simulation metrics with outcomes, over operators and retargeters, "
            "with 95 % intervals of a bootstrap over operators. For these retargeters.",
        )  # fmt: skip
        refused = [
            paragraph(f"{pair}: {entry['refused']}", "warning")
            for pair, entry in self._analysis.spearman.items()
            if "refused" in entry
        ]
        return join([drawn, tables.correlation_table(self._analysis.spearman), *refused])

    def _drawn(self, draw: object, stem: str, caption: str) -> Html:
        with styled():
            drawn: Figure | None = draw(self._analysis, self._colors)  # type: ignore[operator]
        return self._plots.element(drawn, stem, caption)
