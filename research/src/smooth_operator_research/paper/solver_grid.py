"""The competing solvers, with step sizes tuned on frames that are not judged."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

from smooth_operator.baselines.slsqp_method import SlsqpConfig
from smooth_operator_research.paper.compared_solvers import (
    Newton,
    Rmsprop,
    RmspropConfig,
    Sampling,
    Slsqp,
    Solver,
    Starts,
)
from smooth_operator_research.paper.experiment import ExperimentContext, Size
from smooth_operator_research.paper.runs import measure_run


@dataclass(frozen=True, order=True)
class Point:
    """A cell of the grid.

    Attributes:
        samples: N.
        cycles: L.
    """

    samples: int
    cycles: int

    @property
    def budget(self) -> int:
        """N x L: number of candidates per frame, as in the paper."""
        return self.samples * self.cycles

    def __str__(self) -> str:
        return f"N = {self.samples:,}, L = {self.cycles}"

    def solver(self, most_cycles: int) -> Sampling:
        """Algorithm 1 of this size, in the program that all L of the same N share."""
        return Sampling(self.samples, self.cycles, most_cycles=most_cycles)


def grid_points(size: Size) -> list[Point]:
    """The cells within the budget."""
    every = [Point(n, cycles) for n in size.grid_samples for cycles in size.grid_cycles]
    return [point for point in every if point.budget <= size.grid_budget]


def most_cycles(points: Sequence[Point], samples: int) -> int:
    """The largest L of an N."""
    return max(point.cycles for point in points if point.samples == samples)


def contours(points: Sequence[Point]) -> list[list[Point]]:
    """Cells of equal N x L, from the widest (largest N) to the deepest (largest L).

    Returns:
        The contours, by budget; those of fewer than three cells have no middle and are left out.
    """
    by_budget: dict[int, list[Point]] = {}
    for point in points:
        by_budget.setdefault(point.budget, []).append(point)
    return [sorted(own, reverse=True) for _, own in sorted(by_budget.items()) if len(own) >= 3]


SAMPLING: Final = "sampling"
TUNED: Final = "sampling, tuned"
SLSQP: Final = "SLSQP"
NEWTON: Final = "Newton"


@dataclass(frozen=True)
class Tuned:
    """Result of tuning a setting.

    Attributes:
        solver: label of the solver.
        chosen: the values that reached the lowest mean cost.
        tried: each candidate with its mean cost.
    """

    solver: str
    chosen: dict[str, float]
    tried: tuple[tuple[dict[str, float], float], ...]


@dataclass(frozen=True)
class SolverGrid:
    """The solvers.

    Attributes:
        solvers: label -> solver, in the order of tables.
        tuning: results of the tuning of some solvers.
    """

    solvers: dict[str, Solver]
    tuning: tuple[Tuned, ...]

    def of(self, family: str) -> list[str]:
        """Labels of all forms of a solver."""
        return [label for label, one in self.solvers.items() if one.family == family]

    def batched(self, family: str) -> str:
        """Label of the batched form of a solver."""
        return next(
            label
            for label, one in self.solvers.items()
            if one.family == family
            and isinstance(one, (Slsqp, Rmsprop, Newton))
            and one.starts.count > 1
        )


def make_solver_grid(context: ExperimentContext, velocity_weight: float) -> SolverGrid:
    """Makes the solvers for a size, and tunes those with a step size for the objective.

    They are tuned for the lowest mean objective, never for jitter.
    """
    size = context.size
    tuned = [
        _tune(context, velocity_weight, _candidates(one, size))
        for one in (
            Sampling(size.samples, size.cycles, most_cycles=size.cycles, note=", tuned"),
            Rmsprop(),
            Rmsprop(starts=Starts(size.rmsprop_starts)),
        )
    ]
    (sampling, rmsprop, rmsprops), notes = zip(*tuned, strict=True)
    published = Sampling(size.samples, size.cycles, most_cycles=size.cycles)
    solvers: list[Solver] = [
        published,
        # where the published deviation is the best of those tried, there is no second one
        *([sampling] if sampling.sigma != published.sigma else []),
        Slsqp(),
        Slsqp(config=SlsqpConfig()),
        Slsqp(starts=Starts(size.slsqp_starts)),
        rmsprop,
        rmsprops,
        Newton(),
        Newton(starts=Starts(size.newton_starts)),
    ]
    return SolverGrid({one.label: one for one in solvers}, tuple(notes))


def _candidates(one: Sampling | Rmsprop, size: Size) -> list[tuple[dict[str, float], Solver]]:
    if isinstance(one, Sampling):
        return [({"sigma": s}, dataclasses.replace(one, sigma=s)) for s in size.sigmas]
    return [
        (
            {"step": step, "final": final},
            dataclasses.replace(one, config=RmspropConfig(step=step, final=final)),
        )
        for step, final in product(size.steps, size.finals)
    ]


def _tune(
    context: ExperimentContext,
    velocity_weight: float,
    candidates: Sequence[tuple[dict[str, float], Solver]],
) -> tuple[Any, Tuned]:
    problem = context.tuning
    jobs = [context.run_job(problem, one, velocity_weight) for _, one in candidates]
    label = candidates[0][1].label
    runs = context.run_all(f"tuning {label}", jobs)
    costs = [measure_run(problem, run, velocity_weight)["cost"] for run in runs]
    best = min(range(len(costs)), key=costs.__getitem__)
    values, winner = candidates[best]
    tried = tuple((v, cost) for (v, _), cost in zip(candidates, costs, strict=True))
    return winner, Tuned(label, values, tried)
