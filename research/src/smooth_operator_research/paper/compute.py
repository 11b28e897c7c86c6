"""Experiment ``compute``: mean tracking loss over samples N and cycles L."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from smooth_operator.baselines.slsqp_method import DEXPILOT, SlsqpConfig
from smooth_operator.errors import counted
from smooth_operator.retargeting.sbr.method import SBR_PAPER
from smooth_operator_research.paper.compared_solvers import Slsqp
from smooth_operator_research.paper.experiment import (
    Drawing,
    ExperimentContext,
    Outcome,
    Table,
)
from smooth_operator_research.paper.figures import compute_figure
from smooth_operator_research.paper.intervals import Estimate, Samples, contrast, typical
from smooth_operator_research.paper.runs import Problem, measure_run
from smooth_operator_research.paper.solver import percent
from smooth_operator_research.paper.solver_grid import Point, contours, grid_points, most_cycles
from smooth_operator_research.paper.verdicts import Direction, Verdict, judge

PAPER_REFERENCE: Final = 0.4414
"""DexPilot's tracking loss in the paper."""

PAPER_BUDGET: Final = 163_840
"""N x L of the contour in the paper: 8192 x 20, 4096 x 40, 16384 x 10."""

LEAST: Final = 0.001
"""Splits of N and L whose losses differ by less than this fraction count as equal."""


class Compute:
    """The grid, its contours of equal compute, and DexPilot's loss."""

    title = "Samples against cycles at equal compute"
    claim = "at equal N × L a balanced split has the lowest loss, below DexPilot's 0.4414"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        config = SBR_PAPER.objective
        problems = context.problems(config, context.size.grid_frames)
        points = grid_points(context.size)
        losses = _losses(context, problems, points)
        reference, own = _references(context, problems)
        means = {point: typical(losses[point]) for point in points}
        lines = contours(points)
        verdicts = [_reference_verdict(losses, means, reference)]
        if lines:
            verdicts.insert(0, _balance_verdict(losses, lines))
        frames = sum(len(problem) for problem in problems)
        return Outcome(
            f"SBR's objective as published (pose weight {config.pose_weight:g}, w_v "
            f"{config.velocity_weight:g}, M = 128, σ = 0.2, λ = 0.1, fresh normals) on "
            f"{problems[0].hand.name}: {len(points)} cells of the grid, {frames:,} frames of "
            f"{context.recordings}, {counted(context.size.seeds, 'seed')} each. Every cell solves "
            "all recordings completely, each frame from its own last solution. L includes the last "
            "cycle, which Algorithm 1 draws and does not use. The reference is DexPilot as "
            "published (with its own loss) on the same frames, measured by the loss of the grid.",
            verdicts,
            [_table(means), _contour_table(losses, lines)],
            [
                Drawing(
                    "compute",
                    "Left: mean tracking loss over samples N and cycles L, in % above the best "
                    "cell; dashed lines join cells of equal N × L; cells with a heavy frame, if "
                    "any, are below DexPilot's reference. Right: the loss along those contours.",
                    compute_figure(means, lines, typical(reference).value),
                )
            ],
            {
                "grid": [
                    {"samples": p.samples, "cycles": p.cycles, "loss": losses[p].values}
                    for p in points
                ],
                "units": losses[points[0]].units,
                "reference": reference.values,
                "dexpilot_own_loss": own.values,
            },
        )


Losses = dict[Point, Samples]
"""Mean tracking loss of a cell, by recording and seed."""


def _losses(context: ExperimentContext, problems: list[Problem], points: list[Point]) -> Losses:
    weight = problems[0].objective.config.velocity_weight
    # one N after the other: all its L share a program
    order = [
        (point, r, seed)
        for point in points
        for r in range(len(problems))
        for seed in range(context.size.seeds)
    ]
    jobs = [
        context.run_job(problems[r], point.solver(most_cycles(points, point.samples)), weight, seed)
        for point, r, seed in order
    ]
    runs = dict(zip(order, context.run_all("grid N × L", jobs), strict=True))
    units = [problem.unit for problem in problems]
    return {
        point: Samples(
            [
                [
                    measure_run(problem, runs[point, r, seed], weight)["loss"]
                    for seed in range(context.size.seeds)
                ]
                for r, problem in enumerate(problems)
            ],
            units,
        )
        for point in points
    }


def _references(context: ExperimentContext, problems: list[Problem]) -> tuple[Samples, Samples]:
    """DexPilot's solutions, measured by SBR's loss and by its own."""
    own = context.problems(DEXPILOT.objective, context.size.grid_frames)
    published = Slsqp(config=SlsqpConfig())
    runs = context.run_all(
        "DexPilot", [context.run_job(problem, published, 0.0) for problem in own]
    )
    same = [[float(p.tracking_loss(run.q).mean())] for p, run in zip(problems, runs, strict=True)]
    theirs = [[float(p.tracking_loss(run.q).mean())] for p, run in zip(own, runs, strict=True)]
    units = [problem.unit for problem in problems]
    return Samples(same, units), Samples(theirs, units)


def balance(losses: Losses, line: list[Point]) -> tuple[Point, Estimate, Estimate]:
    """Compares the best inner cell of a contour with both ends.

    For each independent unit, the inner cell is chosen by the losses of the other units, so that no
    judged loss takes part in the choice.

    Returns:
        the cell with the lowest loss over all units; and the relative change of loss from the
        widest and from the deepest cell to the cell chosen for each unit. With a single unit, there
        are no others to choose by, and the middle cell is compared.
    """
    units = losses[line[0]].units
    inner = line[1:-1]

    def best(without: str | None) -> Point:
        others = [r for r, unit in enumerate(units) if unit != without]
        if not others:
            return inner[len(inner) // 2]
        return min(inner, key=lambda point: float(np.log(losses[point].means[others]).mean()))

    chosen = {unit: best(unit) for unit in units}
    values = [losses[chosen[unit]].values[r] for r, unit in enumerate(units)]
    wide, deep = (
        contrast(Samples(values, units), losses[end], "change") for end in (line[0], line[-1])
    )
    return best(None), wide, deep


def _balance_verdict(losses: Losses, lines: list[list[Point]]) -> Verdict:
    line = next((one for one in lines if one[0].budget == PAPER_BUDGET), lines[-1])
    inner, wide, _ = balance(losses, line)
    winning = [one[0].budget for one in lines if _wins(balance(losses, one)[1:], 2 * len(lines))]
    ours, named = [Point(8192, 20), Point(4096, 40), Point(16384, 10)], ""
    if all(point in losses for point in ours):
        changes = [contrast(losses[p], losses[ours[2]], "change") for p in ours[:2]]
        named = (
            f" The paper's own three cells: {ours[0]} {percent(changes[0])} and {ours[1]} "
            f"{percent(changes[1])} compared with {ours[2]}."
        )
    return Verdict(
        f"at equal compute, N × L = {line[0].budget:,}, a balanced split beats many "
        "samples in few cycles",
        "N = 4,096, L = 40 or N = 8,192, L = 20 beat N = 16,384, L = 10",
        f"{inner} {percent(wide)} against {line[0]}",
        judge(Direction(0.0, upwards=False), [wide]),  # the end that the caption speaks of
        "The cell is chosen for each recording by the losses on the others; less than "
        f"{100 * LEAST:g} % makes no difference in practice.{named} With intervals widened for the "
        f"number of contours, a balanced split beats both ends on {len(winning)} of {len(lines)}"
        + (f", N × L = {', '.join(f'{n:,}' for n in winning)}." if winning else "."),
    )


def _wins(ends: Sequence[Estimate], among: int) -> bool:
    """True if the middle of a contour, one of several, beats both ends."""
    judging = Direction(-LEAST, upwards=False)
    return all(judging(end, among=among) == "held" for end in ends)


def _reference_verdict(losses: Losses, means: dict[Point, Estimate], reference: Samples) -> Verdict:
    best = min(means, key=lambda point: means[point].value)
    at, limit = contrast(losses[best], reference, "change"), typical(reference)
    passing = sum(mean.value < limit.value for mean in means.values())
    return Verdict(
        "SBR's tracking loss is below DexPilot's",
        f"below {PAPER_REFERENCE}",
        f"{best}: {means[best].shown(4)}, {percent(at)} against DexPilot's {limit.value:.4g}",
        judge(Direction(0.0, upwards=False), [at]),
        f"Both are measured by SBR's loss: DexPilot is at {limit.shown(4)}; {passing} of "
        f"{len(means)} cells are below it.",
    )


def _table(means: dict[Point, Estimate]) -> Table:
    samples = sorted({point.samples for point in means})
    cycles = sorted({point.cycles for point in means})
    rows = [
        [f"L = {depth}"]
        + [means[Point(n, depth)].shown(4) if Point(n, depth) in means else "–" for n in samples]
        for depth in cycles
    ]
    return Table(
        "Mean tracking loss",
        ["", *(f"N = {n:,}" for n in samples)],
        rows,
        "Geometric means over independent recordings with 95 % intervals, which are wide because "
        "recordings differ. The differences between cells below are paired by recording. –: not "
        "computed, because N × L exceeds the budget.",
    )


def _contour_table(losses: Losses, lines: list[list[Point]]) -> Table:
    rows = []
    for line in lines:
        inner, wide, deep = balance(losses, line)
        rows.append(
            (
                f"{line[0].budget:,}",
                str(inner),
                str(line[0]),
                percent(wide),
                str(line[-1]),
                percent(deep),
            )
        )
    return Table(
        "Along contours of equal compute",
        (
            "N × L",
            "best between the ends",
            "widest",
            "against the widest",
            "deepest",
            "against the deepest",
        ),
        rows,
        "Relative change of loss, paired by recording, with 95 % intervals over independent "
        "recordings; for each recording, the cell between the ends is chosen by the losses on "
        "the others.",
    )
