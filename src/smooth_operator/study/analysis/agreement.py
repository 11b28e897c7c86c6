"""Readings of agreement: of two raters (Cohen's weighted kappa), and of operators' rankings."""

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
    Refused,
    drawn,
    figures_or_refused,
    operator_weights,
)
from smooth_operator.study.data.rows import SCORES

_ROUNDS: Final = 2000
_CLOSE: Final = 1e-9
_ALONE: Final = 0.5
"""Wins that each retargeter has against each other before anything is counted, so that strengths
are finite where one always wins."""
_PERMUTATIONS: Final = 20_000


@dataclass(frozen=True)
class Agreement:
    """Two ratings of the same trials.

    Attributes:
        kappa: with linear weights: half a point apart is half a disagreement.
        kappa_unweighted: of equal scores.
        kappa_success: of success, a score of at least 0.5.
        agreed: share of equal scores.
        table: first score -> second score -> trials.
        n: trials with both.
        operators: that were drawn.
    """

    kappa: Drawn
    kappa_unweighted: Drawn
    kappa_success: Drawn
    agreed: float
    table: Mapping[str, Mapping[str, int]]
    n: int
    operators: int


def agreement(
    first: Float[np.ndarray, " n"],
    second: Float[np.ndarray, " n"],
    operator: np.ndarray,
    *,
    seed: int = 11,
) -> Agreement | Refused:
    """Compares two raters' scores of the same trials; NaN is left out.

    Args:
        first: scores of the first rater (n,).
        second: scores of the second rater (n,).
        operator: codes (n,).
        seed: of the bootstrap.
    """
    return figures_or_refused(lambda: _agreement(first, second, operator, seed))


def _agreement(first: np.ndarray, second: np.ndarray, operator: np.ndarray, seed: int) -> Agreement:
    both = np.isfinite(first) & np.isfinite(second)
    if not both.any():
        raise StudyError("no trial has a second rating")
    a = np.searchsorted(SCORES, first[both])
    b = np.searchsorted(SCORES, second[both])
    operators, group = np.unique(operator[both], return_inverse=True)
    size = len(SCORES)
    counts = np.zeros((len(operators), size, size))
    np.add.at(counts, (group, a, b), 1)
    weights = operator_weights(len(operators), seed=seed)
    tables = np.einsum("kg,gij->kij", weights, counts)
    apart = np.abs(np.subtract.outer(SCORES, SCORES))
    success = np.not_equal.outer(np.array(SCORES) >= 0.5, np.array(SCORES) >= 0.5)
    weighted, plain, of_success = (
        _kappa(tables, np.asarray(d, float)) for d in (apart, apart > 0, success)
    )
    if np.isnan(weighted[0]):
        raise StudyError("both raters gave the same score to every trial: kappa is not defined")
    named = [f"{score:g}" for score in SCORES]
    total = tables[0]
    return Agreement(
        kappa=drawn(weighted[0], weighted[1:]),
        kappa_unweighted=drawn(plain[0], plain[1:]),
        kappa_success=drawn(of_success[0], of_success[1:]),
        agreed=float(np.trace(total) / total.sum()),
        table={named[i]: {named[j]: int(total[i, j]) for j in range(size)} for i in range(size)},
        n=int(total.sum()),
        operators=len(operators),
    )


def _kappa(
    tables: Float[np.ndarray, "k s s"], disagreement: Float[np.ndarray, "s s"]
) -> Float[np.ndarray, " k"]:
    total = tables.sum(axis=(1, 2))
    observed = (tables * disagreement).sum(axis=(1, 2)) / total
    by_chance = np.einsum("ki,kj,ij->k", tables.sum(axis=2), tables.sum(axis=1), disagreement)
    by_chance = by_chance / total**2
    ratio = np.divide(observed, by_chance, out=np.full(len(observed), np.nan), where=by_chance > 0)
    return np.asarray(1 - ratio)


@dataclass(frozen=True)
class Preference:
    """Rankings of all retargeters, 1 the best.

    Attributes:
        mean_rank: by retargeter.
        strength: Bradley and Terry's (1952), a share: they add up to 1; that of i over j is how
            often i is preferred to j. Half a win is added to each pair.
        wins: retargeter -> other -> operators who prefer it.
        friedman: statistic of Friedman's test (1937).
        p: of a permutation of the ranks within operators, seeded.
        p_chi_squared: by its limiting distribution.
        kendall_w: agreement of operators, 0 to 1.
        operators: who ranked all retargeters.
        left_out: who did not.
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


def preference(
    rankings: Mapping[str, Sequence[str]], retargeters: tuple[str, ...], *, seed: int = 11
) -> Preference | Refused:
    """Reads the operators' rankings.

    Args:
        rankings: operator -> retargeters, the best first.
        retargeters: those of the study.
        seed: of bootstrap and permutations.
    """
    return figures_or_refused(lambda: _preference(rankings, retargeters, seed))


def _preference(
    rankings: Mapping[str, Sequence[str]], retargeters: tuple[str, ...], seed: int
) -> Preference:
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
    """Bradley and Terry's strengths of every sample, by minorisation (Hunter 2004)."""
    count = wins.shape[1]
    wins = wins + _ALONE * (1 - np.eye(count))
    games = wins + wins.transpose(0, 2, 1)
    won = wins.sum(axis=2)
    now = np.full(won.shape, 1 / count)
    for _ in range(_ROUNDS):
        following = won / np.sum(games / (now[:, :, None] + now[:, None, :]), axis=2)
        following /= following.sum(axis=1, keepdims=True)
        step = np.max(np.abs(following - now))
        now = following
        if step < _CLOSE:
            break
    return now
