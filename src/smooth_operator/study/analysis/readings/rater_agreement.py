"""Reading: do two raters agree? Cohen's weighted kappa (Cohen 1968), operators drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.readings.parts import (
    Drawn,
    Refused,
    drawn,
    found_or_refused,
)
from smooth_operator.study.analysis.readings.resampling import operator_weights
from smooth_operator.study.data.rows import SCORES


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
    return found_or_refused(lambda: _agreement(first, second, operator, seed))


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
    seen = (tables * disagreement).sum(axis=(1, 2)) / total
    by_chance = np.einsum("ki,kj,ij->k", tables.sum(axis=2), tables.sum(axis=1), disagreement)
    by_chance = by_chance / total**2
    ratio = np.divide(seen, by_chance, out=np.full(len(seen), np.nan), where=by_chance > 0)
    return np.asarray(1 - ratio)
