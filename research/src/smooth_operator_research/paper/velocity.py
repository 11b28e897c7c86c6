"""Experiment ``velocity``: the same with a velocity term."""

from __future__ import annotations

from typing import Any, Final

from smooth_operator_research.paper.comparison import Comparison, compare_solvers, setup_of
from smooth_operator_research.paper.experiment import Drawing, ExperimentContext, Outcome, Table
from smooth_operator_research.paper.figures import comparison_figure
from smooth_operator_research.paper.intervals import Estimate, contrast, mean_of, pooled
from smooth_operator_research.paper.solver_grid import SAMPLING
from smooth_operator_research.paper.verdicts import Effect, Equality, Verdict, judge

VELOCITY_WEIGHT: Final = 0.05
PAPER_FACTOR: Final = 7.18
PAPER_LOSS: Final = 0.0232
"""Jitter without over with the term, and what the term adds to the loss, in the paper."""

COMPARABLE: Final = 1.25
"""Jitters within this factor of each other count as comparable."""


class VelocityTerm:
    """All solvers with and without w_v = 0.05."""

    title = "A velocity term added"
    claim = "w_v = 0.05 divides jitter by 7.18 for 0.0232 more loss; gradient solvers then compare"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        without, held = compare_solvers(context, 0.0), compare_solvers(context, VELOCITY_WEIGHT)
        paper = _of_the_paper(without)
        factor = pooled(
            [(without.samples(one, "jitter"), held.samples(one, "jitter")) for one in paper],
            "ratio",
        )
        cost = pooled(
            [(held.samples(one, "loss"), without.samples(one, "loss")) for one in paper],
            "difference",
        )
        return Outcome(
            setup_of(held, context.size),
            [_factor_verdict(factor), _loss_verdict(cost, without),
             _comparable_verdict(held)],
            [_table(without, held), held.table("Solvers with the velocity term")],
            [
                Drawing(
                    "velocity",
                    "Tracking loss, joint jitter and time a frame, without (open) and with the "
                    "velocity term (filled). Bars: 95 % intervals over independent recordings.",
                    comparison_figure([without, held]),
                )
            ],
            {"without": without.figures(), "with": held.figures(), "factor": factor, "loss": cost},
        )  # fmt: skip


def _of_the_paper(comparison: Comparison) -> list[str]:
    """The solvers that the paper's average is over: not our own, nor its sampler tuned by us."""
    return [
        SAMPLING,
        comparison.solver_grid.batched("slsqp"),
        comparison.solver_grid.batched("rmsprop"),
    ]


def _common(without: Comparison, held: Comparison) -> list[str]:
    """Solvers that are in both: a tuned one may be in one of them only."""
    return [label for label in without.runs if label in held.runs]


def _factor(without: Comparison, held: Comparison, label: str) -> Estimate:
    return contrast(without.samples(label, "jitter"), held.samples(label, "jitter"), "ratio")


def _added(without: Comparison, held: Comparison, label: str) -> Estimate:
    return contrast(held.samples(label, "loss"), without.samples(label, "loss"), "difference")


def _factor_verdict(factor: Estimate) -> Verdict:
    return Verdict(
        f"w_v = {VELOCITY_WEIGHT:g} lowers jitter for every solver",
        f"÷ {PAPER_FACTOR}",
        f"÷ {factor.shown(3)}",
        judge(Effect(1.0, PAPER_FACTOR), [factor]),
        "The geometric mean over sampling and the batched SLSQP and RMSProp.",
    )


def _loss_verdict(added: Estimate, without: Comparison) -> Verdict:
    share = added.value / mean_of(without.samples(SAMPLING, "loss")).value
    return Verdict(
        "the velocity term costs tracking loss",
        f"+ {PAPER_LOSS}",
        f"{added.value:+.3g} {added.shown(3).partition(' ')[2]}",
        judge(Effect(0.0, PAPER_LOSS), [added]),
        f"{100 * share:+.2g} % of sampling's loss without the term. Absolute losses depend on "
        "recording, hand and weights; the sign does not.",
    )


def _comparable_verdict(comparison: Comparison) -> Verdict:
    forms = comparison.solver_grid.of("slsqp")
    ratios = [
        contrast(
            comparison.samples(other, "jitter"), comparison.samples(SAMPLING, "jitter"), "ratio"
        )
        for other in forms
    ]
    return Verdict(
        "with the term, gradient solvers reach jitter comparable to sampling's",
        "comparable, no figure",
        "; ".join(f"{one} × {own.shown(3)}" for one, own in zip(forms, ratios, strict=True)),
        judge(Equality(1 / COMPARABLE, COMPARABLE), ratios),
        f"Comparable means within a factor of {COMPARABLE:g}.",
    )


def _table(without: Comparison, held: Comparison) -> Table:
    rows: list[Any] = [
        (
            label,
            without.mean(label, "jitter").shown(3, 1e3),
            held.mean(label, "jitter").shown(3, 1e3),
            _factor(without, held, label).shown(3),
            _added(without, held, label).shown(3),
        )
        for label in _common(without, held)
    ]
    return Table(
        "What the velocity term does",
        ("solver", "jitter without [mrad]", "jitter with [mrad]", "divided by", "loss added"),
        rows,
        "Jitters and factors are geometric means over independent recordings, what is added to the "
        "loss the arithmetic mean, with 95 % intervals.",
    )
