"""``PREREGISTRATION.md``: what a plan commits to, to be registered before the first operator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from smooth_operator.study.design.latin import balanced_rows
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.protocol import OUTCOMES, POOLED, Protocol
from smooth_operator.version import __version__

NAME: Final = "PREREGISTRATION.md"

_TITLES: Final = {
    "success": "success rate (share of trials that score 0.5 or 1)",
    "time": "completion time of successful trials [s]",
    "tlx": "workload (NASA-TLX, 0 to 100 points)",
}
_UNITS: Final = {
    "success": (100.0, "percentage points"),
    "time": (1.0, "s"),
    "tlx": (1.0, "points"),
}


def preregistration(plan: Plan) -> str:
    """The text, in Markdown.

    Args:
        plan: as it is before anyone has begun.

    Returns:
        Hypotheses, design, operators, tasks, outcomes, models, corrections, exclusions, stopping
        rule and versions; in square brackets what only the authors know.
    """
    return "\n".join(_lines(plan)) + "\n"


def _lines(plan: Plan) -> Iterator[str]:
    protocol = plan.protocol
    yield f"# Pre-registration: {protocol.name}"
    yield ""
    yield (
        f"Written from `study.toml` by smooth-operator {__version__}. Register it (for example at "
        "osf.io) before the first operator starts; from then on it is not written any more. "
        "Complete what stands in [brackets]."
    )
    yield from _section("Hypotheses", _hypotheses(protocol))
    yield from _section("Design", _design(plan))
    yield from _section("Operators", _operators(protocol))
    yield from _section("Tasks and scores", _tasks(protocol))
    yield from _section("Outcomes", _outcomes(protocol))
    yield from _section("Models", _models(protocol))
    yield from _section("Comparisons and corrections", _corrections(protocol))
    yield from _section("Exclusions and missing data", _exclusions(protocol))
    yield from _section(
        "Versions",
        [
            f"smooth-operator {__version__}: `smooth-operator study analyze` with its defaults. "
            "The report names the version that was used in the end."
        ],
    )


def _section(title: str, lines: Sequence[str] | Iterator[str]) -> Iterator[str]:
    yield from ("", f"## {title}", "")
    yield from lines


def _others(protocol: Protocol) -> str:
    names = [name for name in protocol.condition_names if name != protocol.baseline]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _scope(scope: str) -> str:
    return "over all tasks together" if scope == POOLED else f"in task {scope}"


def _hypotheses(protocol: Protocol) -> Iterator[str]:
    outcome, _, scope = protocol.primary.partition("/")
    if outcome:
        yield (
            f"1. **Primary.** The {_TITLES[outcome]}, {_scope(scope)}, differs between "
            f"{protocol.baseline} (baseline) and {_others(protocol)}: one two-sided comparison for "
            "each. [Expected direction and reason.]"
        )
    else:
        yield "1. No primary endpoint is named: all results are exploratory."
    if protocol.margins:
        margins = ", ".join(
            f"{outcome} {_UNITS[outcome][0] * margin:g} {_UNITS[outcome][1]}"
            for outcome, margin in protocol.margins.items()
        )
        yield (
            f"2. **Equivalence.** Two conditions are called equivalent if the 90 % interval of "
            f"their difference lies within ± the margin ({margins}; two one-sided tests, "
            "α = 0.05). [Why these margins.]"
        )


def _design(plan: Plan) -> Iterator[str]:
    protocol = plan.protocol
    rows, count = len(plan.orders), len(protocol.conditions)
    williams = rows == len(balanced_rows(count))
    square = (
        f"the {rows} rows of a Williams square, so that each condition is equally often in each "
        "place and right after each other one"
        if williams
        else f"{rows} orders"
    )
    yield (
        f"Within operators: each operator does a task with all {count} conditions, one block each. "
        f"The order of the conditions is one of {square}, assigned as operators enrol, least-used "
        f"row first (seed {protocol.seed}). "
        + (
            "The order of an operator's tasks is balanced."
            if protocol.task_order == "balanced"
            else "Tasks are done in the order in which they are listed."
        )
    )
    yield ""
    for number, order in enumerate(plan.orders, 1):
        yield f"{number}. {', '.join(order)}"
    yield ""
    yield "| condition | method | preset |"
    yield "|---|---|---|"
    for one in protocol.conditions:
        mark = " (baseline)" if one.name == protocol.baseline else ""
        yield f"| {one.name}{mark} | {one.method} | {one.preset or 'default'} |"
    yield ""
    rate = "" if protocol.rate_hz is None else f" The hand gets {protocol.rate_hz:g} commands/s."
    yield (
        f"A block begins with {protocol.familiarisation_s:g} s of free movement without the task. "
        f"The object may be put back {protocol.resets} time(s) in a trial, which then scores "
        f"{protocol.reset_cap:g} at most.{rate} Operators see random labels for the conditions. "
        "[Whether the experimenter who scores is blind, too.]"
    )


def _operators(protocol: Protocol) -> Iterator[str]:
    yield (
        f"{protocol.operators} operators. [How they are recruited, inclusion criteria, power: "
        "`smooth-operator study power`.]"
    )
    yield ""
    yield (
        f"**Stopping rule.** Data collection ends when {protocol.operators} operators have "
        "completed their blocks; one who withdraws is replaced on the same rows. Nobody looks "
        "at outcomes by condition before. [Latest date.]"
    )


def _tasks(protocol: Protocol) -> Iterator[str]:
    yield "| task | operators | trials a block | time limit | score: what must be seen |"
    yield "|---|---:|---:|---:|---|"
    for task in protocol.tasks:
        limit = "none" if task.time_limit_s is None else f"{task.time_limit_s:g} s"
        rubric = "; ".join(f"{line.score:g}: {line.text or line.name}" for line in task.rubric)
        title = f"{task.name}, {task.title}" if task.title else task.name
        cells = (title, protocol.planned(task), task.trials, limit, rubric)
        yield "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def _outcomes(protocol: Protocol) -> Iterator[str]:
    outcomes = OUTCOMES if protocol.questionnaires else OUTCOMES[:-1]
    outcome, _, scope = protocol.primary.partition("/")
    if outcome:
        yield f"- **Primary:** {_TITLES[outcome]}, {_scope(scope)}."
        yield (
            f"- **Exploratory:** all else, of {', '.join(_TITLES[one] for one in outcomes)}, "
            "over all tasks together and in each; learning over trials; correlations with "
            "simulation; the further readings of the report."
        )
    else:
        yield f"- **Exploratory:** {', '.join(_TITLES[one] for one in outcomes)}, in every scope."
    if protocol.questionnaires:
        yield (
            f"- NASA-TLX is filled in after the {', '.join(protocol.questionnaires)} trial of a "
            "block; workload is the unweighted mean of its six scales"
            + (
                " (weights from the 15 pairs are a sensitivity analysis)."
                if protocol.weights
                else "."
            )
        )


def _models(protocol: Protocol) -> Iterator[str]:
    many = len(protocol.tasks) > 1
    blocks = ", and `(1 | operator:retargeter:task)` over all tasks" if many else ""
    fixed = f"retargeter {'+ task ' if many else ''}+ t"
    yield "t is the standardised count of the operator's trials (questionnaires) in the task."
    yield ""
    yield (
        f"- Success: logistic GEE, `success ~ {fixed}`, exchangeable working correlation within "
        "operators, covariance of Mancl and DeRouen, t with operators − 1 degrees of freedom."
    )
    yield (
        f"- Time and workload: linear mixed model, `y ~ {fixed} + (1 | operator) + "
        f"(1 | operator:retargeter)`{blocks}, REML, Satterthwaite's degrees of freedom."
    )
    yield ""
    yield (
        "A retargeter that never or always succeeds is left out of the success model; it is "
        "compared by exact tests within operators and has an exact bound. Any other separation, "
        "and a fit that does not converge, is reported as refused, with the reason."
    )


def _corrections(protocol: Protocol) -> Iterator[str]:
    yield "α = 0.05, two-sided."
    yield ""
    yield (
        f"- Each condition against {protocol.baseline}: Dunnett, within one outcome and one scope. "
        "The primary hypothesis is decided by this family alone."
        if protocol.primary
        else f"- Each condition against {protocol.baseline}: Dunnett, within one outcome and one "
        "scope."
    )
    yield "- All pairs: Holm, within one outcome and one scope."
    yield (
        "- There is no correction across outcomes and scopes: whatever is not primary is "
        "exploratory, and reported as such."
    )


def _exclusions(protocol: Protocol) -> Iterator[str]:
    yield "- A trial is void, and repeated, only for a fault of the equipment or the protocol."
    yield "- An operator who withdraws is left out if they ask for it, and analysed otherwise."
    yield "- Others are excluded only for these reasons: [pilots, authors, ...]; each is reported."
    yield "- Failures have no completion time; missing answers leave out that questionnaire."
    yield "- Void, undone and corrected trials are counted for each condition in the report."
