"""``report.html``, and the figures as files."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.report_page import Html, Plots, templates, write_report_page
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.methods_text import cited, methods_paragraph
from smooth_operator.study.analysis.report import tables
from smooth_operator.study.analysis.report.figures import FIGURES
from smooth_operator.study.analysis.report.tables import NAMES, conclusion

REPORT: Final = "report.html"
FOLDER: Final = "figures"
_SECTIONS: Final = (
    ("Success", "success", "success"),
    ("Time", "time", "time"),
    ("Workload", "workload", "workload"),
    ("Learning", "learning", "learning"),
    ("Other readings", "readings", "readings"),
    ("Simulation", "simulation", "simulation"),
    ("Participants", "participants", "participants"),
    ("Checks", "checks", "checks"),
    ("Methods", "methods", "methods"),
    ("Appendix: as published", "published", "published"),
)
"""Title, anchor and macro of each section."""


def write_report(analysis: Analysis, folder: Path) -> Path:
    """Writes the page and its figures.

    Returns:
        The page. It needs no other file, and nothing from the network.

    Raises:
        OutputError: a file can't be written.
    """
    plots, colors = Plots(folder / FOLDER), colors_of(analysis.retargeters)

    def figure(stem: str, caption: str) -> Html:
        with styled():
            drawn = FIGURES[stem](analysis, colors)
        return plots.element(drawn, stem, caption)

    text = methods_paragraph(analysis)
    template = templates(__package__).get_template("sections.html.j2")
    macros = template.make_module(
        {
            "analysis": analysis,
            "colors": colors,
            "conclusion": conclusion(analysis),
            "figure": figure,
            "flow": analysis.data.flow,
            "names": NAMES,
            "operators": len({str(name) for name in analysis.data.trials.operator}),
            "tables": tables,
            "text": text,
            "works": cited(text),
        }
    )
    return write_report_page(
        folder / REPORT,
        "User study",
        Html(str(macros.header())),  # type: ignore[attr-defined]
        [
            (title, anchor, Html(str(getattr(macros, macro)())))
            for title, anchor, macro in _SECTIONS
            if anchor != "simulation" or analysis.spearman
        ],
        "Made by smooth-operator study analyze. Figures: results.json and the CSV tables; "
        "plots as files: figures/.",
    )
