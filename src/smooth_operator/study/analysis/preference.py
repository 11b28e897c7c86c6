"""Reading: operators' rankings of the retargeters (Friedman's test, Kendall's W)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.results import refusable

_PERMUTATIONS: Final = 20_000


@dataclass(frozen=True)
class Preference:
    """Rankings of all retargeters, 1 the best.

    Attributes:
        mean_rank: mean rank of each retargeter.
        wins: retargeter -> other retargeter -> number of operators who prefer the first.
        friedman: statistic of Friedman's test (1937).
        p: p-value by seeded permutations of the ranks within operators.
        p_chi_squared: p-value by the limiting distribution.
        kendall_w: agreement of the operators, 0 to 1.
        operators: number of operators who ranked all retargeters.
        left_out: number of operators who did not.
    """

    mean_rank: Mapping[str, float]
    wins: Mapping[str, Mapping[str, int]]
    friedman: float
    p: float
    p_chi_squared: float
    kendall_w: float
    operators: int
    left_out: int


@refusable
def preference(
    rankings: Mapping[str, Sequence[str]], retargeters: tuple[str, ...], *, seed: int = 11
) -> Preference:
    """Analyses the operators' rankings.

    Args:
        rankings: operator -> retargeters, the best first.
        retargeters: retargeters of the study.
        seed: seed of the permutations.

    Raises:
        StudyError: fewer than two operators ranked all retargeters; returned as ``Refused``.
    """
    whole = [list(order) for order in rankings.values() if sorted(order) == sorted(retargeters)]
    if len(whole) < 2:
        raise StudyError(
            f"{len(whole)} operator(s) ranked all retargeters: at least two are needed"
        )
    ranks = np.array([[order.index(name) + 1.0 for name in retargeters] for order in whole])
    operators, count = ranks.shape
    statistic = _friedman(ranks.sum(axis=0), operators)
    rng = np.random.default_rng(seed)
    shuffled = rng.permuted(np.broadcast_to(ranks, (_PERMUTATIONS, *ranks.shape)), axis=2)
    as_far = int(np.sum(_friedman(shuffled.sum(axis=1), operators) >= statistic - 1e-9))
    wins = np.sum(ranks[:, :, None] < ranks[:, None, :], axis=0)
    return Preference(
        mean_rank=dict(zip(retargeters, map(float, ranks.mean(axis=0)), strict=True)),
        wins={
            name: {other: int(wins[i, j]) for j, other in enumerate(retargeters) if j != i}
            for i, name in enumerate(retargeters)
        },
        friedman=float(statistic),
        p=(1 + as_far) / (1 + _PERMUTATIONS),
        p_chi_squared=float(chi2.sf(statistic, count - 1)),
        kendall_w=float(statistic / (operators * (count - 1))),
        operators=operators,
        left_out=len(rankings) - operators,
    )


def _friedman(sums: Float[np.ndarray, "*k r"], operators: int) -> Float[np.ndarray, "*k"]:
    count = sums.shape[-1]
    apart = sums - operators * (count + 1) / 2
    return np.asarray(12 * np.sum(apart**2, axis=-1) / (operators * count * (count + 1)))
