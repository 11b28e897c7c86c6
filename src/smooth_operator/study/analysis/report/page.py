"""``report.html``, and the figures as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.html import Html, details, element, escape, join, paragraph
from smooth_operator.reporting.report_page import Plots, write_report_page
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.citations import cited
from smooth_operator.study.analysis.methods_text import methods_paragraph
from smooth_operator.study.analysis.report import figures, tables
from smooth_operator.study.analysis.report.conclusion import NAMES, conclusion
from smooth_operator.study.analysis.report.sections import participant_section, reading_section
from smooth_operator.study.analysis.report.tables import scope_name
from smooth_operator.study.analysis.results import MODES, OUTCOMES, Outcome, ScopeResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT: Final = "report.html"
FIGURES: Final = "figures"

_PUBLISHED: Final = (
    "Analysed as the paper was: the operator as the only random effect, sandwich errors for "
    "success, normal statistics. In 1,000 simulated null studies of the paper's design it errs: it "
    "finds a difference in 10 % (success), and where operators prefer some retargeters in 11 % "
    "(success), 19 % (time) and 32 % (workload), instead of 5 %. Do not report it."
)
"""Shares: see the table of family-wise errors in the reference."""


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
            ("Other readings", "readings", self._readings()),
        ]
        if self._analysis.spearman:
            sections.append(("Simulation", "simulation", self._simulation()))
        sections += [
            ("Participants", "participants", participant_section(self._analysis)),
            ("Checks", "checks", self._checks()),
            ("Methods", "methods", self._methods()),
            ("Appendix: as published", "published", self._published()),
        ]
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
            f"{operators} operators, {len(data.trials):,} trials, "
            f"{len(data.questionnaires or ()):,} questionnaires; "
            f"{', '.join(analysis.retargeters)}; baseline {analysis.baseline}"
        )
        notes = [paragraph(note, "warning") for note in data.notes]
        found = join(paragraph(line) for line in conclusion(analysis))
        top = [element("h1", "User study"), paragraph(said, "soft")]
        return join([*top, element("div", found, class_="verdict"), *notes])

    def _outcome(self, outcome: Outcome) -> Html:
        analysis = self._analysis
        parts = [self._figure_of(outcome)]
        for i, scope in enumerate(analysis.scopes):
            content = self._scope(outcome, analysis.results[MODES[0]][outcome][scope])
            title = _upper(scope_name(scope))
            role = analysis.role(outcome, scope)
            title += f": {role}" if role else ""
            parts.append(details(title, content, opened=i == 0, class_="recording"))
        return join(parts)

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

    def _scope(self, outcome: Outcome, result: ScopeResult) -> Html:
        warnings = tables.warning_list(result)
        if result.refused is not None:
            return join([warnings, tables.observed_table(outcome, result, self._colors)])
        return join([
            warnings,
            tables.means_table(outcome, result, self._colors, self._analysis.baseline),
            details("All pairs", tables.pairs_table(outcome, result)),
            details("Coefficients", tables.coefficients_table(result)),
            tables.model_facts(result),
        ])  # fmt: skip

    def _published(self) -> Html:
        """Mode paper, folded."""
        analysis = self._analysis
        parts = [paragraph(_PUBLISHED, "warning")]
        for outcome in OUTCOMES:
            for scope in analysis.scopes:
                result = analysis.results[MODES[1]][outcome][scope]
                title = f"{NAMES[outcome]}, {scope_name(scope)}: as published"
                parts.append(details(title, self._scope(outcome, result)))
        return join(parts)

    def _readings(self) -> Html:
        drawn = self._drawn(
            figures.incidence_figure, "time-to-success",
            "Share of all trials that have succeeded by a time.",
        )  # fmt: skip
        return reading_section(self._analysis, drawn)

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

    def _methods(self) -> Html:
        text = methods_paragraph(self._analysis)
        entries = [
            element(
                "li", Html(f"<b>{escape(c.method)}</b> [{escape(c.key)}]. {escape(c.reference)}")
            )
            for c in cited(text)
        ]
        return join(
            [
                paragraph("To paste into a manuscript:"),
                element("blockquote", paragraph(text), id="paragraph"),
                element("h3", "What was used, and whom to cite"),
                element("ul", join(entries)),
            ]
        )

    def _drawn(self, draw: object, stem: str, caption: str) -> Html:
        with styled():
            drawn: Figure | None = draw(self._analysis, self._colors)  # type: ignore[operator]
        return self._plots.element(drawn, stem, caption)
