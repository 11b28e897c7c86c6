"""Experiment ``hessian``: jitter of solvers along the eigenvectors of the loss's Hessian."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import jax
import numpy as np
from jaxtyping import Float

from smooth_operator.reporting.drawing import INK
from smooth_operator.result_cache import Job, content_digest
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator_research.paper.compared_solvers import Newton, Rmsprop, Slsqp
from smooth_operator_research.paper.experiment import (
    Compute,
    Drawing,
    ExperimentContext,
    Outcome,
    Table,
    cell_job,
)
from smooth_operator_research.paper.figures import FAMILY_COLORS, FAMILY_MARKERS, plain_log
from smooth_operator_research.paper.intervals import Estimate, Samples, contrast, pooled, typical
from smooth_operator_research.paper.runs import Problem
from smooth_operator_research.paper.solver import (
    VELOCITY_WEIGHT,
    Comparison,
    compare_solvers,
    setup_of,
)
from smooth_operator_research.paper.solver_grid import NEWTON, SAMPLING, SLSQP, TUNED
from smooth_operator_research.paper.verdicts import Direction, Equality, Verdict, judge

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOAT64_STEP: Final = 1e-6
"""Step of the finite differences [rad]."""

CHECKED_FRAMES: Final = 5
"""Frames of each recording whose Hessian is checked."""

MATCHED: Final = 1.25
"""Jitters that differ by less than this factor count as closely matched."""


class HessianDirections:
    """Jitter along the eigenvectors of the loss's Hessian, flattest first."""

    title = "Directions of jitter: eigenvectors of the loss's Hessian"
    claim = "jitter is equal in stiff directions and diverges in flat ones"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        without, held = compare_solvers(context, 0.0), compare_solvers(context, VELOCITY_WEIGHT)
        # Where all are looked at: along DexPilot's own answers, single-start SLSQP's.
        centres = [seeds[0].q for seeds in without.runs[SLSQP]]
        jobs = [_job(problem, q) for problem, q in zip(without.problems, centres, strict=True)]
        cells = context.finish("Hessians", jobs)
        spectra = [cell["values"] for cell in cells]
        vectors = [cell["vectors"] for cell in cells]
        error = max(float(cell["error"]) for cell in cells)
        ranked = [ranked_jitter(one, vectors) for one in (without, held)]
        return Outcome(
            setup_of(without, context.size)
            + " For all solvers, the Hessian of the loss is computed at the solutions of "
            "single-start SLSQP without velocity term. In every frame, its eigenvectors are ranked "
            "(rank 1 is the flattest). Jitter along a rank is the mean |second difference of q, "
            "projected on the rank's eigenvector|. The velocity term adds 2 w_v to each eigenvalue "
            "and does not change the eigenvectors.",
            [
                _stiff_verdict(without, ranked[0]),
                _flat_verdict(without, ranked[0]),
                _check_verdict(error, len(cells)),
            ],
            [_table(one, own) for one, own in zip((without, held), ranked, strict=True)],
            [
                Drawing(
                    "hessian",
                    "Left and middle: joint jitter along each eigenvector of the loss's Hessian "
                    "(rank 1 is the flattest), without and with the velocity term; means over "
                    "recordings and seeds. Right: the eigenvalues, median and central 80 % of all "
                    "frames.",
                    hessian_figure([without, held], ranked, spectra),
                )
            ],
            {
                "finite_difference_error": error,
                "eigenvalues": [np.percentile(s, [10, 50, 90], axis=0) for s in spectra],
                "jitter_by_rank": [
                    {"velocity_weight": f.velocity_weight, "solvers": by_rank}
                    for f, by_rank in zip((without, held), ranked, strict=True)
                ],
            },
        )


def hessian_figure(
    several: Sequence[Comparison],
    ranked: Sequence[dict[str, list[list[Float[np.ndarray, " m"]]]]],
    spectra: Sequence[Float[np.ndarray, "T m"]],
) -> Figure:
    """Draws the jitter by rank, without and with the velocity term, and the spectrum.

    Args:
        ranked: without and with the term: label -> recording -> seed -> (m,) jitter by rank [rad].
        spectra: (T, m) eigenvalues of each recording, ascending.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.2, 4.0))
    axes = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 0.9))
    figure.subplots_adjust(left=0.065, right=0.985, top=0.92, bottom=0.3, wspace=0.3)
    axes[1].sharey(axes[0])
    for ax, comparison, by_rank in zip(axes, several, ranked, strict=False):
        for label, recordings in by_rank.items():
            if label == TUNED:
                continue  # its settings are near the published ones; it is in the tables
            one = comparison.solver_grid.solvers[label]
            many = isinstance(one, (Slsqp, Rmsprop, Newton)) and one.starts.count > 1
            mean = np.mean([np.mean(seeds, axis=0) for seeds in recordings], axis=0)
            ranks = np.arange(1, len(mean) + 1)
            ax.plot(
                ranks,
                1e3 * mean,
                color=FAMILY_COLORS[one.family],
                label=label,
                linewidth=1.3,
                marker=FAMILY_MARKERS[one.family],
                markersize=4.2,
                linestyle="--" if many else "-",
                markerfacecolor="white" if many else FAMILY_COLORS[one.family],
            )
        ax.set_yscale("log")
        ax.set_xlabel("eigenvector rank, 1 = flattest")
        weight = comparison.velocity_weight
        ax.set_title(f"with w_v = {weight:g}" if weight else "without velocity term")
        ax.set_xticks(ranks[::3])
    axes[0].set_ylabel("jitter along the eigenvector [mrad]")
    plain_log(axes[0].yaxis)
    values = np.concatenate([np.asarray(own) for own in spectra])
    low, middle, high = np.percentile(values, [10, 50, 90], axis=0)
    ax = axes[2]
    ranks = np.arange(1, values.shape[1] + 1)
    floor = max(float(np.min(middle[middle > 0], initial=1.0)) / 30, 1e-12)
    ax.fill_between(
        ranks,
        np.maximum(low, floor),
        np.maximum(high, floor),
        color=INK,
        alpha=0.15,
        linewidth=0,
        label="central 80 %",
    )
    ax.plot(ranks, np.maximum(middle, floor), color=INK, linewidth=1.4, label="median")
    ax.set_yscale("log")
    plain_log(ax.yaxis)
    ax.set_xlabel("eigenvector rank, 1 = flattest")
    ax.set_ylabel("eigenvalue of the Hessian [1/rad²]")
    ax.set_title("how stiff the directions are")
    ax.set_xticks(ranks[::3])
    ax.legend(fontsize=8, loc="upper left")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower left", bbox_to_anchor=(0.05, 0.0), ncols=4, fontsize=8
    )
    return figure


Ranked = dict[str, list[list[Float[np.ndarray, " m"]]]]
"""Label -> recording -> seed -> jitter along each rank [rad]."""


def ranked_jitter(comparison: Comparison, vectors: list[Float[np.ndarray, "T m m"]]) -> Ranked:
    """Jitter of every run along the eigenvectors of its frames."""
    return {
        label: [
            [projected_jitter(run.q, along) for run in seeds]
            for seeds, along in zip(recordings, vectors, strict=True)
        ]
        for label, recordings in comparison.runs.items()
    }


def projected_jitter(
    q: Float[np.ndarray, "T m"], vectors: Float[np.ndarray, "T m m"]
) -> Float[np.ndarray, " m"]:
    """Mean absolute second difference along each eigenvector of the middle frame [rad].

    Args:
        q: (T, m) joint positions [rad].
        vectors: (T, m, m) orthonormal columns.
    """
    second = q[2:] + q[:-2] - 2 * q[1:-1]
    along = np.einsum("tij,ti->tj", vectors[1:-1], second)
    return np.asarray(np.abs(along).mean(axis=0))


def hessians(
    problem: Problem, q: Float[np.ndarray, "T m"]
) -> tuple[Float[np.ndarray, "T m m"], float]:
    """Exact Hessians of the loss without velocity term, and the error of finite differences.

    Args:
        q: (T, m) poses [rad].

    Returns:
        (T, m, m) Hessians in float64; and, over some frames, the largest difference to central
        differences of the gradient, relative to the largest entry of the Hessian.
    """

    def derivatives(q: Any, vectors: Any, weights: Any) -> Any:
        goal = FrameGoal(vectors, weights, q, 0.0)
        return problem.objective.value_grad_hess(q, goal)[1:]

    with _float64():
        run: Callable[..., Any] = jax.jit(jax.vmap(derivatives))
        _, exact = (np.asarray(x) for x in run(q, problem.vectors, problem.weights))
        some = np.unique(np.linspace(0, len(q) - 1, CHECKED_FRAMES).astype(int))
        worst = 0.0
        for t in some:
            moves = FLOAT64_STEP * np.eye(q.shape[1])
            points = np.concatenate([q[t] + moves, q[t] - moves])
            many = len(points)
            gradients, _ = run(
                points,
                np.repeat(problem.vectors[None, t], many, axis=0),
                np.repeat(problem.weights[None, t], many, axis=0),
            )
            ahead, behind = np.split(np.asarray(gradients), 2)
            differences = (ahead - behind) / (2 * FLOAT64_STEP)
            off = np.abs(differences - exact[t]).max() / np.abs(exact[t]).max()
            worst = max(worst, float(off))
    return exact, worst


def _float64() -> contextlib.AbstractContextManager[Any]:
    """Context in which JAX uses float64, for all versions of JAX."""
    switch: Any = getattr(jax, "enable_x64", None)
    if callable(switch):
        context: contextlib.AbstractContextManager[Any] = switch(True)
        return context
    from jax import experimental

    old: Any = experimental
    older: contextlib.AbstractContextManager[Any] = old.enable_x64()
    return older


def _job(problem: Problem, q: Float[np.ndarray, "T m"]) -> Job[Compute]:
    def compute(advance: Callable[[float], None]) -> dict[str, np.ndarray]:
        matrices, error = hessians(problem, q)
        values, vectors = np.linalg.eigh(matrices)  # ascending: the flattest first
        advance(1.0)
        return {"values": values, "vectors": vectors, "error": np.array(error)}

    where = np.ascontiguousarray(q, "<f8").tobytes()
    return cell_job(
        f"Hessians along {problem.name}",
        {
            "kind": "hessian",
            "problem": problem.digest,
            "at": content_digest(where),
            "step": FLOAT64_STEP,
        },
        2000.0,
        compute,
    )


def _share(comparison: Comparison, ranked: Ranked, label: str, ranks: slice) -> Samples:
    values = [[float(run[ranks].mean()) for run in seeds] for seeds in ranked[label]]
    return Samples(values, comparison.units)


def _thirds(ranked: Ranked) -> tuple[slice, slice]:
    """Returns the flattest and the stiffest third of the ranks."""
    count = len(next(iter(ranked.values()))[0][0])
    third = max(count // 3, 1)
    return slice(0, third), slice(count - third, count)


def _ratios(comparison: Comparison, ranked: Ranked, ranks: slice) -> dict[str, Estimate]:
    labels = comparison.solver_grid.of("slsqp")
    sampled = _share(comparison, ranked, SAMPLING, ranks)
    return {
        one: contrast(_share(comparison, ranked, one, ranks), sampled, "ratio") for one in labels
    }


def _listed(ratios: dict[str, Estimate]) -> str:
    return ", ".join(f"{label} × {ratio.shown(3)}" for label, ratio in ratios.items())


def _stiff_verdict(comparison: Comparison, ranked: Ranked) -> Verdict:
    ratios = _ratios(comparison, ranked, _thirds(ranked)[1])
    return Verdict(
        "in stiff directions all solvers have equal jitter",
        "“closely matched”, no figure",
        _listed(ratios),
        judge(Equality(1 / MATCHED, MATCHED), list(ratios.values())),
        "Jitter relative to that of sampling, over the stiffest third of the ranks, without "
        f"velocity term; matched means within a factor of {MATCHED:g}.",
    )


def _flat_verdict(comparison: Comparison, ranked: Ranked) -> Verdict:
    flat, stiff = _thirds(ranked)
    ratios = _ratios(comparison, ranked, flat)
    # "a stark divergence": more than in the stiff directions, too
    sampled = [_share(comparison, ranked, SAMPLING, ranks) for ranks in (flat, stiff)]
    excess = {
        label: pooled(
            [
                (_share(comparison, ranked, label, flat), sampled[0]),
                (sampled[1], _share(comparison, ranked, label, stiff)),
            ],
            "ratio",
        )
        for label in ratios
    }
    newton = contrast(_share(comparison, ranked, NEWTON, flat), sampled[0], "ratio")
    return Verdict(
        "in flat directions gradient solvers jitter more than sampling",
        "“a stark divergence”, no figure",
        _listed(ratios),
        judge(Direction(1.0, upwards=True), [*ratios.values(), *excess.values()]),
        "Over the flattest third of the ranks, without velocity term; the ratios must exceed 1 "
        "and those of the stiff third. Newton, which also uses gradients, has "
        f"{newton.shown(3)} times the jitter of sampling there.",
    )


def _check_verdict(error: float, recordings: int) -> Verdict:
    return Verdict(
        "the Hessian is right (our check)",
        "–",
        f"largest relative error {error:.1e}",
        "held" if error < 1e-4 else "did not hold",
        f"Central differences of the gradient in float64, step {FLOAT64_STEP:g} rad, "
        f"{CHECKED_FRAMES} frames of each of {recordings} recordings, over the largest entry of "
        "the Hessian; below 1e-4 passes.",
    )


def _table(comparison: Comparison, ranked: Ranked) -> Table:
    flat, stiff = _thirds(ranked)
    count = stiff.stop
    middle = slice(flat.stop, stiff.start)
    rows = []
    for label in ranked:
        shares = [_share(comparison, ranked, label, ranks) for ranks in (flat, middle, stiff)]
        rows.append([label, *(typical(share).shown(3, 1e3) for share in shares)])
    term = f"with w_v = {comparison.velocity_weight:g}" if comparison.velocity_weight else "without"
    return Table(
        f"Jitter by stiffness, {term} velocity term"
        if not comparison.velocity_weight
        else f"Jitter by stiffness, {term}",
        (
            "solver",
            f"ranks 1–{flat.stop}, flat [mrad]",
            f"ranks {middle.start + 1}–{middle.stop} [mrad]",
            f"ranks {stiff.start + 1}–{count}, stiff [mrad]",
        ),
        rows,
        "Geometric means over independent recordings with 95 % intervals.",
    )
