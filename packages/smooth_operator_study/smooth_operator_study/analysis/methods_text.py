"""Paragraph on the methods of a study and its analysis, to paste into a paper."""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from typing import Final

from smooth_operator.reporting.report_page import templates
from smooth_operator.version import __version__
from smooth_operator_study.analysis.analyze import Analysis
from smooth_operator_study.analysis.operators import flow_text
from smooth_operator_study.analysis.results import MODES, OUTCOMES, ScopeResult
from smooth_operator_study.design.plan import balanced_rows


@dataclass(frozen=True)
class Citation:
    """A method of the analysis and the work to cite for it."""

    key: str
    method: str
    reference: str


CITATIONS: Final = tuple(
    Citation(*line.split(" | "))
    for line in (files(__package__) / "citations.txt").read_text("utf-8").splitlines()
)
"""Works for every method that the analysis may use."""
_CHECKS: Final = {
    "shapiro_wilk": "for normality [Shapiro1965]",
    "levene": "for equal spread across retargeters [Brown1974]",
}


def cited(text: str) -> list[Citation]:
    """Returns the works that a text cites by keys in square brackets, in the order of the list."""
    keys = {key for group in re.findall(r"\[([\w, ]+)\]", text) for key in group.split(", ")}
    return [citation for citation in CITATIONS if citation.key in keys]


def methods_paragraph(analysis: Analysis) -> str:
    """Describes how the study was done and analysed, in mode small-sample.

    Returns:
        One paragraph. A refused test is reported as refused. Facts that only the authors know are
        [square brackets], and citations are keys of ``CITATIONS``.
    """
    data, plan = analysis.data, analysis.data.plan
    done: dict[str, dict[str, ScopeResult]] = {}
    refused: dict[str, dict[str, list[str]]] = {}
    for outcome in OUTCOMES:
        done[outcome], refused[outcome] = {}, {}
        for scope, result in analysis.results[MODES[0]][outcome].items():
            if result.refused is None:
                done[outcome][scope] = result
            else:
                refused[outcome].setdefault(result.refused, []).append(scope)
    results = [result for scopes in done.values() for result in scopes.values()]
    linear = [outcome for outcome in OUTCOMES[1:] if done[outcome]]
    checked = {key for one in linear for r in done[one].values() for key in r.diagnostics}
    several = [result for result in results if len(result.dunnett) > 1]
    template = templates(__package__).get_template("methods.txt.j2")
    text = template.render(
        analysis=analysis,
        operators=len(data.flow.analysed),
        participants=flow_text(data.flow),
        williams=plan is not None and len(data.orders) == len(balanced_rows(len(plan.conditions))),
        done=done,
        refused=refused,
        degrees=sorted({result.operators - 1 for result in done["success"].values()}),
        firth=[name for name, one in done["success"].items() if one.model.get("firth")],
        plain=[name for name, one in done["success"].items() if not one.model.get("firth")],
        linear=linear,
        checks=[text for key, text in _CHECKS.items() if key in checked],
        results=results,
        several=several,
        unequal=any(len({one.df for one in r.dunnett.values()}) > 1 for r in several),
        pairs=sorted({len(result.pairs) for result in results if result.pairs}),
        correlated=any("refused" not in entry for entry in analysis.spearman.values()),
        version=__version__,
        python=platform.python_version(),
        packages={name: version(name) for name in ("numpy", "scipy", "statsmodels")},
    )
    return " ".join(text.split())
