"""Figure of the experiment ``hessian``: jitter along each eigen-direction, and the eigenvalues."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from smooth_operator.reporting.drawing import INK
from smooth_operator_research.paper.compared_solvers import Newton, Rmsprop, Slsqp
from smooth_operator_research.paper.comparison import Comparison
from smooth_operator_research.paper.figures import FAMILY_COLORS, FAMILY_MARKERS, plain_log
from smooth_operator_research.paper.solver_grid import TUNED

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def hessian_figure(
    several: Sequence[Comparison],
    ranked: Sequence[dict[str, list[list[Float[np.ndarray, " m"]]]]],
    spectra: Sequence[Float[np.ndarray, "T m"]],
) -> Figure:
    """Jitter by rank, without and with the velocity term, and the spectrum.

    Args:
        several: the solvers without and with the term.
        ranked: for each, label -> recording -> seed -> (m,) jitter along each rank [rad].
        spectra: (T, m) eigenvalues of each recording, ascending.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.2, 4.0))
    axes = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 0.9))
    figure.subplots_adjust(left=0.065, right=0.985, top=0.92, bottom=0.3, wspace=0.3)
    axes[1].sharey(axes[0])
    for ax, found, by_rank in zip(axes, several, ranked, strict=False):
        for label, recordings in by_rank.items():
            if label == TUNED:
                continue  # its settings are near the published ones; it is in the tables
            one = found.solver_grid.solvers[label]
            many = isinstance(one, (Slsqp, Rmsprop, Newton)) and one.starts.count > 1
            mean = np.mean([np.mean(seeds, axis=0) for seeds in recordings], axis=0)
            ranks = np.arange(1, len(mean) + 1)
            ax.plot(
                ranks, 1e3 * mean, color=FAMILY_COLORS[one.family], label=label, linewidth=1.3,
                marker=FAMILY_MARKERS[one.family], markersize=4.2, linestyle="--" if many else "-",
                markerfacecolor="white" if many else FAMILY_COLORS[one.family],
            )  # fmt: skip
        ax.set_yscale("log")
        ax.set_xlabel("eigenvector rank, 1 = flattest")
        weight = found.velocity_weight
        ax.set_title(f"with w_v = {weight:g}" if weight else "without velocity term")
        ax.set_xticks(ranks[::3])
    axes[0].set_ylabel("jitter along the eigenvector [mrad]")
    plain_log(axes[0].yaxis)
    values = np.concatenate([np.asarray(own) for own in spectra])
    low, middle, high = np.percentile(values, [10, 50, 90], axis=0)
    ax = axes[2]
    ranks = np.arange(1, values.shape[1] + 1)
    floor = max(float(np.min(middle[middle > 0], initial=1.0)) / 30, 1e-12)
    ax.fill_between(ranks, np.maximum(low, floor), np.maximum(high, floor), color=INK, alpha=0.15,
                    linewidth=0, label="central 80 %")  # fmt: skip
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
