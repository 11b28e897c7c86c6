"""All solvers on all recordings and seeds, with and without a velocity term: what three of the
experiments look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from smooth_operator.baselines.slsqp import ScipySlsqpConfig
from smooth_operator.baselines.slsqp_method import DEXPILOT_PUBLISHED
from smooth_operator_research.paper.compared_solvers import Sampling, Slsqp, Solver, Starts
from smooth_operator_research.paper.experiment import (
    PUBLISHED_STARTS,
    TUNING_OPERATOR,
    ExperimentContext,
    Size,
    Table,
    counted,
    recordings_of,
)
from smooth_operator_research.paper.intervals import Estimate, Samples, typical
from smooth_operator_research.paper.problems import Problem
from smooth_operator_research.paper.runs import Run, measure_run
from smooth_operator_research.paper.solver_grid import SolverGrid, make_solver_grid


@dataclass(frozen=True, eq=False)
class Comparison:
    """The solvers on one objective.

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
        """A figure of a solver, by recording and seed."""
        return Samples(
            [
                [self._measured[label, r, s][metric] for s in range(len(seeds))]
                for r, seeds in enumerate(self.runs[label])
            ],
            self.units,
        )

    def mean(self, label: str, metric: str) -> Estimate:
        """Its geometric mean with an interval."""
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
        """The largest share of the cores that other processes took during a run."""
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
                "solver", "tracking loss", "objective", "jitter [mrad]", "acceleration [rad/s²]",
                "ms a frame", "evaluations",
            ),
            rows,
            f"Geometric means over {len(set(self.units))} independent recordings with 95 % "
            "intervals. Tracking loss: first term of Eq. (1); objective: all of it, which is what "
            "is minimised. Jitter: mean |q(t+1) + q(t−1) − 2 q(t)| over frames and joints. "
            "Evaluations: of a start, cycles for sampling, steps for Newton. " + self._about_time(),
        )  # fmt: skip

    def _about_time(self) -> str:
        share = self.others()
        busy = (
            ""
            if share is None
            else f" Other processes took up to {100 * share:.0f} % of the cores."
        )
        return (
            "Times are medians of calls for 20 frames each (SLSQP: single frames on the host)."
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
    """All solvers on DexPilot's loss; runs what is missing."""
    solver_grid = make_solver_grid(context, velocity_weight)
    term = f", w_v {velocity_weight:g}" if velocity_weight else ""
    return _compared(context, solver_grid, context.judged, velocity_weight, f"solvers{term}")


def compare_as_printed(context: ExperimentContext) -> Comparison:
    """Sampling and SLSQP on DexPilot's loss with a squared norm, as the supplement prints it."""
    size = context.size
    sampling = Sampling(size.samples, size.cycles, most_cycles=size.cycles)
    solvers: list[Solver] = [
        sampling, Slsqp(), Slsqp(config=ScipySlsqpConfig()),
        Slsqp(starts=Starts(size.slsqp_starts)),
    ]  # fmt: skip
    problems = context.problems(replace(DEXPILOT_PUBLISHED.objective, loss="squared"), size.frames)
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
    """What was done, in words."""
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
        "the same "
        "minimum and a frame at its own last answer, within the same joint limits; descending ones "
        "stop where an iteration gains less than 1e-6 or after 100 evaluations, “SLSQP, published "
        "limit” (SciPy's) after 20 iterations. Algorithm 1 has "
        f"N = {size.samples:,}, L = {size.cycles}. The step of RMSProp and the tuned initial "
        "deviation of sampling are those with the lowest mean objective on "
        f"{size.tuning_frames} frames of another operator (synthetic:{TUNING_OPERATOR}), which is "
        "not judged. The batched forms run N starts, scattered by 0.2 rad about the last answer, "
        "and take the softmax (0.1) of their outputs." + less
    )
