"""Experiments ``solver`` and ``velocity``: solvers on DexPilot's loss, without and with a velocity
term."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.baselines.slsqp_method import DEXPILOT, SlsqpConfig
from smooth_operator.errors import counted
from smooth_operator.metrics.consistency import JOINTS_STILL
from smooth_operator.reporting.drawing import INK
from smooth_operator_research.paper.compared_solvers import Sampling, Slsqp, Solver, Starts
from smooth_operator_research.paper.experiment import (
    PUBLISHED_STARTS,
    TUNING_OPERATOR,
    Drawing,
    ExperimentContext,
    Outcome,
    Size,
    Table,
    recordings_of,
)
from smooth_operator_research.paper.figures import (
    FAMILY_COLORS,
    FAMILY_MARKERS,
    dot,
    name_rows,
    plain_log,
)
from smooth_operator_research.paper.intervals import (
    Estimate,
    Samples,
    contrast,
    mean_of,
    pooled,
    typical,
)
from smooth_operator_research.paper.runs import Problem, Run, measure_run
from smooth_operator_research.paper.solver_grid import SAMPLING, SLSQP, SolverGrid, make_solver_grid
from smooth_operator_research.paper.verdicts import Effect, Equality, Verdict, judge

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Comparison:
    """Results of the solvers on one objective.

    Attributes:
        velocity_weight: w_v of the objective.
        solver_grid: the solvers.
        problems: the recordings.
        runs: label -> recording -> seed -> run.
    """

    velocity_weight: float
    solver_grid: SolverGrid
    problems: list[Problem]
    runs: Mapping[str, list[list[Run]]]

    @property
    def units(self) -> list[str]:
        """The independent unit of each recording."""
        return [problem.unit for problem in self.problems]

    def samples(self, label: str, metric: str) -> Samples:
        """Values of one metric of a solver, by recording and seed."""
        return Samples(
            [
                [self._measured[label, r, s][metric] for s in range(len(seeds))]
                for r, seeds in enumerate(self.runs[label])
            ],
            self.units,
        )

    def mean(self, label: str, metric: str) -> Estimate:
        """Geometric mean of a metric, with an interval."""
        return typical(self.samples(label, metric))

    @cached_property
    def _measured(self) -> dict[tuple[str, int, int], dict[str, float]]:
        return {
            (label, r, s): measure_run(problem, run, self.velocity_weight)
            for label, recordings in self.runs.items()
            for r, (problem, seeds) in enumerate(zip(self.problems, recordings, strict=True))
            for s, run in enumerate(seeds)
        }

    def others(self) -> float | None:
        """Largest share of the cores that other processes used during a run."""
        shares = [run.others for own in self.runs.values() for seeds in own for run in seeds]
        finite = [share for share in shares if np.isfinite(share)]
        return max(finite) if finite else None

    def table(self, title: str) -> Table:
        """Loss, jitter and time of every solver."""
        rows = [
            (
                label,
                self.mean(label, "loss").shown(4),
                self.mean(label, "cost").shown(4),
                self.mean(label, "jitter").shown(3, 1e3),
                self.mean(label, "acceleration").shown(3),
                f"{self.mean(label, 'frame_ms').value:.3g}",
                f"{self.mean(label, 'evaluations').value:.3g}",
            )
            for label in self.runs
        ]
        return Table(
            title,
            (
                "solver",
                "tracking loss",
                "objective",
                "jitter [mrad]",
                "acceleration [rad/s²]",
                "ms a frame",
                "evaluations",
            ),
            rows,
            f"Geometric means over {len(set(self.units))} independent recordings with 95 % "
            "intervals. Tracking loss: first term of Eq. (1); objective: all terms, which the "
            "solvers minimise. Jitter: mean |q(t+1) + q(t−1) − 2 q(t)| over frames and joints. "
            "Evaluations: per start; cycles for sampling, steps for Newton. " + self._about_time(),
        )

    def _about_time(self) -> str:
        share = self.others()
        busy = (
            ""
            if share is None
            else f" Other processes took up to {100 * share:.0f} % of the cores."
        )
        return (
            "Times are medians over calls of 20 frames each (SLSQP: single frames on the host)."
            + busy
        )

    def figures(self) -> dict[str, Any]:
        """All numbers, for results.json."""
        metrics = ("loss", "cost", "jitter", "acceleration", "frame_ms", "evaluations")
        return {
            "velocity_weight": self.velocity_weight,
            "recordings": [
                {"name": p.name, "unit": p.unit, "frames": p.frames, "rate_hz": p.rate_hz}
                for p in self.problems
            ],
            "solvers": {
                label: {
                    "settings": self.solver_grid.solvers[label],
                    **{metric: self.samples(label, metric).values for metric in metrics},
                }
                for label in self.runs
            },
            "tuning": self.solver_grid.tuning,
            "others": self.others(),
        }


def compare_solvers(context: ExperimentContext, velocity_weight: float) -> Comparison:
    """Compares all solvers on DexPilot's loss; runs the missing cells."""
    solver_grid = make_solver_grid(context, velocity_weight)
    term = f", w_v {velocity_weight:g}" if velocity_weight else ""
    return _compared(context, solver_grid, context.judged, velocity_weight, f"solvers{term}")


def compare_as_printed(context: ExperimentContext) -> Comparison:
    """Compares sampling and SLSQP on DexPilot's loss with a squared norm, as printed in the
    supplement."""
    size = context.size
    sampling = Sampling(size.samples, size.cycles, most_cycles=size.cycles)
    solvers: list[Solver] = [
        sampling,
        Slsqp(),
        Slsqp(config=SlsqpConfig()),
        Slsqp(starts=Starts(size.slsqp_starts)),
    ]
    problems = context.problems(replace(DEXPILOT.objective, loss="squared"), size.frames)
    solver_grid = SolverGrid({one.label: one for one in solvers}, ())
    return _compared(context, solver_grid, problems, 0.0, "squared loss")


def _compared(
    context: ExperimentContext,
    solver_grid: SolverGrid,
    problems: list[Problem],
    velocity_weight: float,
    phase: str,
) -> Comparison:
    seeds = {
        label: range(context.size.seeds if one.random else 1)
        for label, one in solver_grid.solvers.items()
    }
    # recording by recording, so that a run which is stopped has whole comparisons
    order = [
        (label, r, seed) for r in range(len(problems)) for label in seeds for seed in seeds[label]
    ]
    jobs = [
        context.run_job(problems[r], solver_grid.solvers[label], velocity_weight, seed)
        for label, r, seed in order
    ]
    done = dict(zip(order, context.run_all(phase, jobs), strict=True))
    runs = {
        label: [[done[label, r, s] for s in seeds[label]] for r in range(len(problems))]
        for label in seeds
    }
    return Comparison(velocity_weight, solver_grid, problems, runs)


def setup_of(comparison: Comparison, size: Size) -> str:
    """Describes the setup of the experiment."""
    problems = comparison.problems
    hand = problems[0].hand
    frames = sum(len(problem) for problem in problems)
    less = (
        f" The paper has N = {PUBLISHED_STARTS:,} starts; here they are {size.rmsprop_starts:,} "
        f"for RMSProp, {size.newton_starts:,} for Newton and {size.slsqp_starts:,} for SLSQP, "
        "which runs them one after the other."
    )
    return (
        f"DexPilot's loss (its weights and latches, smooth-L1, pull to zero "
        f"angles by {problems[0].objective.config.pose_weight:g}"
        + (f", w_v {comparison.velocity_weight:g}" if comparison.velocity_weight else "")
        + f") on {hand.name}, {frames:,} frames of {recordings_of(comparison.units)}, "
        f"{counted(size.seeds, 'seed')} of each random solver. Every solver begins a recording at "
        "the same minimum, and a frame at its own last solution, within the same joint limits. "
        "Descent methods stop if an iteration gains less than 1e-6 or after 100 evaluations, "
        "“SLSQP, published limit” (SciPy's) after 20 iterations. Algorithm 1 has "
        f"N = {size.samples:,}, L = {size.cycles}. The step of RMSProp and the tuned initial "
        "deviation of sampling are those with the lowest mean objective on "
        f"{size.tuning_frames} frames of another operator (synthetic:{TUNING_OPERATOR}), which is "
        "not judged. The batched forms run N starts, scattered by 0.2 rad around the last "
        "solution, and average their outputs by softmax (temperature 0.1)." + less
    )


PAPER_REDUCTION: Final = -0.364
"""Change of jitter from SLSQP to sampling (supplement, figure of the base optimisation)."""

LOSS_MARGIN: Final = 0.05
"""Mean losses that differ by less than this fraction count as equal."""


_PANELS: Final = (
    ("loss", 1.0, "tracking loss [–]"),
    ("jitter", 1e3, "joint jitter [mrad]"),
    ("frame_ms", 1.0, "time a frame [ms]"),
)


def comparison_figure(several: Sequence[Comparison]) -> Figure:
    """Draws dots with intervals on logarithmic axes: a row for each solver, a panel for each
    figure.

    Args:
        several: one comparison, or the two without and with a velocity term.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    labels = list(dict.fromkeys(label for comparison in several for label in comparison.runs))
    height = 1.25 + 0.36 * len(labels)
    figure = Figure(figsize=(9.6, height))
    axes = figure.subplots(1, len(_PANELS), sharey=True)
    figure.subplots_adjust(
        left=0.145, right=0.985, top=1 - 0.2 / height, bottom=0.85 / height, wspace=0.09
    )
    for ax, (metric, factor, title) in zip(axes, _PANELS, strict=True):
        for k, comparison in enumerate(several):
            offset = 0.0 if len(several) == 1 else (-0.17, 0.17)[k]
            filled = k == len(several) - 1
            for row, label in enumerate(labels):
                if label in comparison.runs:
                    family = comparison.solver_grid.solvers[label].family
                    color = FAMILY_COLORS[family]
                    style = {
                        "marker": FAMILY_MARKERS[family],
                        "color": color,
                        "markersize": 6.5,
                        "markerfacecolor": color if filled else "white",
                        "markeredgewidth": 1.3,
                    }
                    mean, each = comparison.mean(label, metric), comparison.samples(label, metric)
                    bar = metric != "frame_ms"
                    dot(ax, row + offset, mean, each.means, factor, style, bar=bar)
        ax.set_xscale("log")
        plain_log(ax.xaxis)
        ax.set_xlabel(title)
        name_rows(ax, labels)
    if len(several) > 1:
        empty: dict[str, Any] = {"color": INK, "linestyle": "", "marker": "o"}
        texts = ("without velocity term", f"with w_v = {several[-1].velocity_weight:g}")
        handles = [
            Line2D([], [], markerfacecolor=face, label=text, **empty)
            for text, face in zip(texts, ("white", INK), strict=True)
        ]
        figure.legend(
            handles=handles, loc="lower left", bbox_to_anchor=(0.01, 0.0), ncols=1, fontsize=8
        )
    return figure


class SolverSwap:
    """Compares sampling, RMSProp, SLSQP and Newton on one loss."""

    title = "The solver swapped, the loss unchanged"
    claim = "at equal loss, sampling has 36.4 % less joint jitter than SLSQP"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        comparison, printed = compare_solvers(context, 0.0), compare_as_printed(context)
        return Outcome(
            setup_of(comparison, context.size),
            [
                _loss_verdict(comparison),
                _jitter_verdict(comparison, "sampling has less joint jitter than SLSQP"),
                _printed_verdict(printed),
            ],
            [
                comparison.table("Solvers on DexPilot's loss"),
                against_sampling(comparison),
                printed.table("With the squared norm that the supplement prints"),
                tuning_table(comparison),
            ],
            [
                Drawing(
                    "solvers",
                    "Tracking loss, joint jitter and time per frame of each solver on DexPilot's "
                    "loss. Bars: 95 % intervals over independent recordings; ticks: recordings.",
                    comparison_figure([comparison]),
                )
            ],
            comparison.figures() | {"as_printed": printed.figures()},
        )


def change(comparison: Comparison, label: str, other: str, metric: str) -> Estimate:
    """Relative change of a metric from another solver to this one."""
    return contrast(comparison.samples(label, metric), comparison.samples(other, metric), "change")


def changes_of(comparison: Comparison, metric: str) -> dict[str, Estimate]:
    """Relative change of a metric from every form of SLSQP to sampling."""
    return {
        other: change(comparison, SAMPLING, other, metric)
        for other in comparison.solver_grid.of("slsqp")
    }


def against(changes: dict[str, Estimate]) -> str:
    """Formats relative changes, each with its reference."""
    return "; ".join(f"{percent(one)} against {label}" for label, one in changes.items())


def percent(change: Estimate) -> str:
    """Formats a relative change."""
    return change.shown(3, 100.0, " %")


def _loss_verdict(comparison: Comparison) -> Verdict:
    changes = changes_of(comparison, "loss")
    return Verdict(
        "all solvers reach about the same tracking loss",
        "“remarkably similar”, no figure",
        f"sampling {against(changes)}",
        judge(Equality(-LOSS_MARGIN, LOSS_MARGIN), list(changes.values())),
        f"Equal means within {100 * LOSS_MARGIN:.0f} %.",
    )


def _jitter_verdict(comparison: Comparison, claim: str, note: str = "") -> Verdict:
    changes = changes_of(comparison, "jitter")
    held = judge(Effect(0.0, PAPER_REDUCTION), list(changes.values()))
    return Verdict(claim, "−36.4 %", against(changes), held, note)


def _printed_verdict(comparison: Comparison) -> Verdict:
    still, stops = (
        np.mean([[frozen(run.q) for run in seeds] for seeds in comparison.runs[label]])
        for label in (SAMPLING, SLSQP)
    )
    return _jitter_verdict(
        comparison,
        "the same, with the squared norm that the supplement prints",
        "The released code and the paper's figures use smooth-L1. Squared metres are small "
        "compared with SLSQP's tolerance of 1e-6 and the sampler's temperature of 0.1: SLSQP does "
        f"not move in {100 * stops:.0f} % of the frames, sampling in {100 * still:.0f} %.",
    )


def frozen(q: Float[np.ndarray, "T m"]) -> float:
    """Fraction of frames in which no joint moves."""
    return float((np.abs(np.diff(q, axis=0)).max(axis=1) <= JOINTS_STILL).mean())


def against_sampling(comparison: Comparison) -> Table:
    """Every solver's loss and jitter relative to sampling as published."""
    rows = [
        (
            label,
            percent(change(comparison, label, SAMPLING, "loss")),
            percent(change(comparison, label, SAMPLING, "jitter")),
        )
        for label in comparison.runs
        if label != SAMPLING
    ]
    return Table(
        "Relative to sampling as published",
        ("solver", "tracking loss", "jitter"),
        rows,
        "Paired by recording: geometric means of ratios, with 95 % intervals.",
    )


def tuning_table(comparison: Comparison) -> Table:
    """Tuned settings, their candidates and costs."""
    rows = []
    for tuned in comparison.solver_grid.tuning:
        for values, cost in tuned.tried:
            chosen = "chosen" if values == tuned.chosen else ""
            settings = ", ".join(f"{name} {value:g}" for name, value in values.items())
            rows.append((tuned.solver, settings, f"{cost:.4g}", chosen))
    return Table(
        "Tuning, on frames that are not judged", ("solver", "setting", "mean objective", ""), rows
    )


VELOCITY_WEIGHT: Final = 0.05
PAPER_FACTOR: Final = 7.18
PAPER_LOSS: Final = 0.0232
"""The paper's ratio of jitter without the term to jitter with it, and the loss that it adds."""

COMPARABLE: Final = 1.25
"""Jitters that differ by less than this factor count as comparable."""


class VelocityTerm:
    """Compares all solvers with and without w_v = 0.05."""

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
            [_factor_verdict(factor), _added_verdict(cost, without), _comparable_verdict(held)],
            [_table(without, held), held.table("Solvers with the velocity term")],
            [
                Drawing(
                    "velocity",
                    "Tracking loss, joint jitter and time per frame, without (open) and with the "
                    "velocity term (filled). Bars: 95 % intervals over independent recordings.",
                    comparison_figure([without, held]),
                )
            ],
            {"without": without.figures(), "with": held.figures(), "factor": factor, "loss": cost},
        )


def _of_the_paper(comparison: Comparison) -> list[str]:
    """Solvers in the paper's average: without our own, and without the sampler that we tuned."""
    return [
        SAMPLING,
        comparison.solver_grid.batched("slsqp"),
        comparison.solver_grid.batched("rmsprop"),
    ]


def _factor(without: Comparison, held: Comparison, label: str) -> Estimate:
    return contrast(without.samples(label, "jitter"), held.samples(label, "jitter"), "ratio")


def _factor_verdict(factor: Estimate) -> Verdict:
    return Verdict(
        f"w_v = {VELOCITY_WEIGHT:g} lowers jitter for every solver",
        f"÷ {PAPER_FACTOR}",
        f"÷ {factor.shown(3)}",
        judge(Effect(1.0, PAPER_FACTOR), [factor]),
        "The geometric mean over sampling and the batched SLSQP and RMSProp.",
    )


def _added_verdict(added: Estimate, without: Comparison) -> Verdict:
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
            contrast(
                held.samples(label, "loss"), without.samples(label, "loss"), "difference"
            ).shown(3),
        )
        for label in without.runs
        if label in held.runs  # a tuned solver may be in only one of them
    ]
    return Table(
        "Effect of the velocity term",
        ("solver", "jitter without [mrad]", "jitter with [mrad]", "divided by", "loss added"),
        rows,
        "Jitters and factors are geometric means over independent recordings, the added loss is "
        "an arithmetic mean, with 95 % intervals.",
    )
