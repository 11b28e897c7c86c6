"""Reading: operators' rankings of the retargeters (Friedman, Kendall, Bradley and Terry)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.results import (
    Drawn,
    drawn,
    operator_weights,
    refusable,
)

_ROUNDS: Final = 2000
_TOLERANCE: Final = 1e-9
_PRIOR_WINS: Final = 0.5
"""Wins that are added to each pair of retargeters, so that strengths are finite where one always
wins."""
_PERMUTATIONS: Final = 20_000


@dataclass(frozen=True)
class Preference:
    """Rankings of all retargeters, 1 the best.

    Attributes:
        mean_rank: mean rank of each retargeter.
        strength: Bradley and Terry's (1952) strength of each retargeter; they add up to 1, and
            i is preferred to j with probability s_i / (s_i + s_j). Half a win is added to each
            pair.
        wins: retargeter -> other retargeter -> number of operators who prefer the first.
        friedman: statistic of Friedman's test (1937).
        p: p-value by seeded permutations of the ranks within operators.
        p_chi_squared: p-value by the limiting distribution.
        kendall_w: agreement of the operators, 0 to 1.
        operators: number of operators who ranked all retargeters.
        left_out: number of operators who did not.
    """

    mean_rank: Mapping[str, Drawn]
    strength: Mapping[str, Drawn]
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
        seed: seed of bootstrap and permutations.

    Raises:
        StudyError: fewer than two operators ranked all retargeters; returned as ``Refused``.
    """
    whole = [order for order in rankings.values() if sorted(order) == sorted(retargeters)]
    if len(whole) < 2:
        raise StudyError(
            f"{len(whole)} operator(s) ranked all retargeters: at least two are needed"
        )
    ranks = np.array([[list(order).index(name) + 1 for name in retargeters] for order in whole])
    ranks = ranks.astype(float)
    operators, count = ranks.shape
    beats = (ranks[:, :, None] < ranks[:, None, :]).astype(float)
    weights = operator_weights(operators, seed=seed)
    means = weights @ ranks / operators
    strengths = _strengths(np.einsum("kg,gij->kij", weights, beats))
    statistic = _friedman(ranks.sum(axis=0), operators)
    rng = np.random.default_rng(seed)
    shuffled = rng.permuted(np.broadcast_to(ranks, (_PERMUTATIONS, *ranks.shape)), axis=2)
    by_chance = _friedman(shuffled.sum(axis=1), operators)
    as_far = int(np.sum(by_chance >= statistic - 1e-9))
    wins = beats.sum(axis=0)
    return Preference(
        mean_rank={n: drawn(means[0, j], means[1:, j]) for j, n in enumerate(retargeters)},
        strength={n: drawn(strengths[0, j], strengths[1:, j]) for j, n in enumerate(retargeters)},
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


def _strengths(wins: Float[np.ndarray, "k r r"]) -> Float[np.ndarray, "k r"]:
    """Bradley and Terry's strengths in each sample, by minorisation (Hunter 2004)."""
    count = wins.shape[1]
    wins = wins + _PRIOR_WINS * (1 - np.eye(count))
    games = wins + wins.transpose(0, 2, 1)
    won = wins.sum(axis=2)
    now = np.full(won.shape, 1 / count)
    for _ in range(_ROUNDS):
        following = won / np.sum(games / (now[:, :, None] + now[:, None, :]), axis=2)
        following /= following.sum(axis=1, keepdims=True)
        step = np.max(np.abs(following - now))
        now = following
        if step < _TOLERANCE:
            break
    return now
