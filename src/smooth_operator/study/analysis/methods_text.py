"""The text on methods, ready to paste: what this study planned and what was done with its data."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Final

from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.operators import flow_text
from smooth_operator.study.analysis.results import MODES, OUTCOMES, POOLED, Outcome, ScopeResult
from smooth_operator.study.data.rows import Flow
from smooth_operator.study.design.latin import balanced_rows
from smooth_operator.study.design.protocol import Protocol
from smooth_operator.version import __version__

_NAMES: Final[dict[Outcome, str]] = {
    "success": "success",
    "time": "completion time",
    "tlx": "workload",
}
_PACKAGES: Final = ("numpy", "scipy", "statsmodels")


def methods_paragraph(analysis: Analysis) -> str:
    """How the study was done and analysed, in the mode small-sample, in plain prose.

    Args:
        analysis: of the study.

    Returns:
        One paragraph. It says nothing of a test that was refused but its refusal, and has in
        [square brackets] what only the authors know. Citations are keys of ``CITATIONS``.
    """
    return " ".join(
        [
            *_participants(analysis),
            *_design(analysis),
            *_success(analysis),
            *_linear(analysis),
            *_comparisons(analysis),
            *_further(analysis),
            _software(),
        ]
    )


def _participants(analysis: Analysis) -> Iterator[str]:
    data = analysis.data
    tasks = analysis.scopes[1:]
    operators = len({str(name) for name in data.trials.operator})
    questionnaires = len(data.questionnaires or ())
    yield (
        f"{operators} operators took part in {len(data.trials)} trials of {_count(tasks, 'task')} "
        f"with {len(analysis.retargeters)} retargeters ({', '.join(analysis.retargeters)}), "
        f"{int(data.trials.success.sum())} of them successful (score of at least 0.5)"
        + (f", with questionnaires filled in {questionnaires} times" if questionnaires else "")
        + "."
    )
    if sentence := flow_text(data.flow):
        cite = " [Schulz2010]" if data.flow.logged else ""
        yield f"{sentence[0].upper()}{sentence[1:-1]}{cite}."
    yield from _irregular(data.flow)


def _irregular(flow: Flow) -> Iterator[str]:
    for what, counts in (
        ("trials were void and repeated", flow.voids),
        ("trials were corrected afterwards, with a reason", flow.amended),
    ):
        if total := sum(counts.values()):
            shown = ", ".join(f"{name} {count}" for name, count in counts.items())
            yield f"{total} {what} ({shown})."
    if flow.ended_early:
        yield f"{flow.ended_early} blocks ended before their last trial."


def _design(analysis: Analysis) -> Iterator[str]:
    plan = analysis.data.plan
    if plan is None:
        return
    yield _orders(plan, analysis.data.orders)
    trials = ", ".join(f"{task.name} {task.trials}" for task in plan.tasks)
    rate = "" if plan.rate_hz is None else f"; the hand got {plan.rate_hz:g} commands a second"
    yield (
        f"A block was {plan.familiarisation_s:g} s of free movement and then trials ({trials}); "
        f"in a trial the object could be put back {plan.resets} time(s), for a score of "
        f"{plan.reset_cap:g} at most{rate}."
    )
    limits = [f"{t.name} {t.time_limit_s:g} s" for t in plan.tasks if t.time_limit_s is not None]
    if limits:
        yield f"Trials had a time limit ({', '.join(limits)})."
    yield (
        "Operators saw neutral labels of the retargeters. [State whether the experimenter who "
        "scored was blind.]"
    )


def _orders(plan: Protocol, orders: Sequence[Sequence[str]]) -> str:
    count = len(plan.conditions)
    square = (
        f"one of the {len(orders)} rows of a Williams square [Williams1949]"
        if len(orders) == len(balanced_rows(count))
        else f"one of {len(orders)} planned orders"
    )
    return (
        f"Each operator was to do a task with every retargeter, one block each, in an order that "
        f"was {square}."
    )


def _success(analysis: Analysis) -> Iterator[str]:
    done, refused = _parts(analysis, "success")
    if done:
        degrees = sorted({result.operators - 1 for result in done.values()})
        yield (
            f"Success was analysed ({_scopes(done)}) by population-averaged logistic regression on "
            f"{_terms(analysis)}: generalised estimating equations with an exchangeable working "
            "correlation within operators [Liang1986], the covariance of Mancl and DeRouen "
            f"[Mancl2001] and t tests with operators - 1 degrees of freedom ({_range(degrees)}). "
            "Data were checked for separation beforehand [Konis2007]."
        )
    for scope, result in done.items():
        for name, alone in result.separated.items():
            never = "never" if alone.rate == 0 else "always"
            yield (
                f"{name} {never} succeeded ({scope}): it is in no model, but has an exact bound "
                "with operators as units and was compared by exact sign tests within operators."
            )
    yield from _refusals("success", refused)


def _linear(analysis: Analysis) -> Iterator[str]:
    outcomes: list[Outcome] = []
    refusals: list[str] = []
    for outcome in OUTCOMES[1:]:
        done, refused = _parts(analysis, outcome)
        if done:
            outcomes.append(outcome)
        if outcome != "tlx" or analysis.data.questionnaires is not None:
            refusals += _refusals(_NAMES[outcome], refused)
    if outcomes:
        named = {
            "time": "Completion time of successful trials",
            "tlx": "unweighted mean of the six NASA-TLX scales [Hart1988, Hart2006]"
            if analysis.workload == "raw"
            else "mean of the six NASA-TLX scales, weighted by each operator's choices between "
            "pairs of them [Hart1988]",
        }
        what = named["time"] if "time" in outcomes else ""
        if "tlx" in outcomes:
            what = f"{what} and workload" if what else "Workload"
            what += f" ({named['tlx']})"
        pooled = len(analysis.scopes) > 2
        verb = "were" if len(outcomes) > 1 else "was"
        blocks = " and, where tasks are pooled, for each block" if pooled else ""
        yield (
            f"{what} {verb} analysed by linear mixed models on {_terms(analysis)}, with random "
            f"intercepts for operators, for each operator with each retargeter{blocks}, fitted by "
            "restricted maximum likelihood [Bates2015]; tests and intervals use Satterthwaite's "
            "degrees of freedom [Kuznetsova2017]. "
            + _checked([_parts(analysis, outcome)[0] for outcome in outcomes])
        )
    yield from refusals


def _checked(results: Sequence[dict[str, ScopeResult]]) -> str:
    keys = {key for scopes in results for one in scopes.values() for key in one.diagnostics}
    tests = [
        text
        for key, text in (
            ("shapiro_wilk", "for normality [Shapiro1965]"),
            ("levene", "for equal spread across retargeters [Brown1974]"),
        )
        if key in keys
    ]
    return f"Residuals were tested {' and '.join(tests)}." if tests else ""


def _comparisons(analysis: Analysis) -> Iterator[str]:
    results = [
        (outcome, result)
        for outcome in OUTCOMES
        for result in _parts(analysis, outcome)[0].values()
    ]
    if not results:
        return
    done = {outcome for outcome, _ in results}
    probability = ", for success as means of probabilities with standard errors by the delta method"
    yield (
        "We report estimated marginal means [Searle1980] at the mean trial index"
        + (", tasks weighing equally" if len(analysis.scopes) > 2 else "")
        + (probability if "success" in done else "")
        + "."
    )
    several = [result for _, result in results if len(result.dunnett) > 1]
    against = any(result.dunnett for _, result in results)
    if several:
        unequal = any(len({one.df for one in r.dunnett.values()}) > 1 for r in several)
        yield (
            f"Each retargeter was compared with {analysis.baseline} by Dunnett's single-step "
            "procedure [Dunnett1955, Hothorn2008], with p-values and simultaneous 95 % intervals "
            "from the multivariate t distribution of the model's contrasts [Genz2009]"
            + (", at each contrast's own degrees of freedom" if unequal else "")
            + "."
        )
    elif against:
        yield f"The other retargeter was compared with {analysis.baseline} by a t test."
    pairs = max(len(result.pairs) for _, result in results)
    if pairs > 1:
        yield f"All {pairs} pairs were compared with Holm's correction [Holm1979]."
    yield "All tests are two-sided at α = 0.05."
    if several:
        yield (
            "Corrections hold within one outcome and one scope (all tasks together, or a task), "
            "not across them."
        )
    yield from _primary(analysis)
    sizes = ["for success Cohen's h"] if "success" in done else []
    if done - {"success"}:
        sizes.append(
            "for means d, the difference divided by the square root of the sum of all variances of "
            "the model (operators, operators with retargeters, blocks, residual)"
        )
    yield f"Effect sizes are, {' and '.join(sizes)} [Cohen1988]."


def _primary(analysis: Analysis) -> Iterator[str]:
    plan = analysis.data.plan
    if plan is None:
        return
    if analysis.baseline != plan.baseline:
        yield f"The planned baseline was {plan.baseline}; this analysis departs from the plan."
    if analysis.primary is None:
        yield "The plan named no primary endpoint; all results are exploratory."
        return
    outcome, scope = analysis.primary
    where = "all tasks together" if scope == POOLED else f"task {scope}"
    yield (
        f"The primary endpoint, named in the plan, was {_NAMES[outcome]} ({where}); all else is "  # type: ignore[index]
        "exploratory."
    )


def _further(analysis: Analysis) -> Iterator[str]:
    if any("refused" not in entry for entry in analysis.spearman.values()):
        yield (
            "Metrics of the simulation were correlated with each operator's mean outcomes by "
            "Spearman's rank correlation [Spearman1904], with 95 % percentile intervals from a "
            "bootstrap over operators [Field2007]."
        )


def _software() -> str:
    versions = []
    for name in _PACKAGES:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return (
        f"The analysis was done with smooth-operator {__version__} (Python "
        f"{platform.python_version()}, {', '.join(versions)})."
    )


def _parts(
    analysis: Analysis, outcome: Outcome
) -> tuple[dict[str, ScopeResult], dict[str, ScopeResult]]:
    """Scopes with figures, and refused ones."""
    results = analysis.results[MODES[0]][outcome]
    done = {scope: result for scope, result in results.items() if result.refused is None}
    return done, {scope: result for scope, result in results.items() if scope not in done}


def _refusals(name: str, refused: dict[str, ScopeResult]) -> Iterator[str]:
    by_reason: dict[str, list[str]] = {}
    for scope, result in refused.items():
        by_reason.setdefault(str(result.refused), []).append(scope)
    for reason, scopes in by_reason.items():
        where = ", ".join("all tasks" if scope == POOLED else f"task {scope}" for scope in scopes)
        yield f"{name[0].upper()}{name[1:]} could not be analysed ({where}): {reason}."


def _scopes(done: dict[str, ScopeResult]) -> str:
    tasks = [scope for scope in done if scope != POOLED]
    parts = ["all tasks together"] if POOLED in done else []
    if tasks:
        parts.append(f"task{'s' if len(tasks) > 1 else ''} {', '.join(tasks)}")
    return " and ".join(parts)


def _terms(analysis: Analysis) -> str:
    task = ", task (where pooled)" if len(analysis.scopes) > 2 else ""
    return f"retargeter{task} and standardised trial index"


def _count(names: Sequence[str], what: str) -> str:
    return f"{len(names)} {what}{'s' if len(names) != 1 else ''}"


def _range(numbers: Sequence[int]) -> str:
    if len(numbers) == 1:
        return str(numbers[0])
    return f"{numbers[0]} to {numbers[-1]}"
