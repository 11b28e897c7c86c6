"""Results of an analysis, and their JSON form.

``results.json`` is ``{mode: {outcome: {scope: ...}}}``, and ``learning``, ``spearman``,
``tlx_items``, ``operator_variance`` and ``study``. Numbers that do not exist are null; a refused
analysis has its reason in ``refused``, empty tables, and never a number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError

Mode: TypeAlias = Literal["small-sample", "paper"]
Outcome: TypeAlias = Literal["success", "time", "tlx"]
MODES: Final[tuple[Mode, ...]] = ("small-sample", "paper")
"""The default first."""
DRAWS: Final = 2000
"""Samples of a bootstrap over operators."""
OUTCOMES: Final[tuple[Outcome, ...]] = ("success", "time", "tlx")
POOLED: Final = "pooled"


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of the model: on the logit scale for success."""

    estimate: float
    se: float
    df: float
    p: float


@dataclass(frozen=True)
class Mean:
    """An estimated marginal mean with its 95 % interval."""

    estimate: float
    se: float
    df: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Against:
    """A retargeter minus the baseline; the interval is simultaneous over all of them, 95 %."""

    difference: float
    se: float
    df: float
    statistic: float
    p_raw: float
    p_dunnett: float
    lower: float
    upper: float
    effect: float
    effect_words: str


@dataclass(frozen=True)
class Pair:
    """``a`` minus ``b``."""

    a: str
    b: str
    difference: float
    se: float
    df: float
    statistic: float
    p_raw: float
    p_holm: float
    effect: float
    effect_words: str


@dataclass(frozen=True)
class ExactTest:
    """A retargeter that never or always succeeds against another, within operators.

    Attributes:
        difference: of success rates, the first minus the other, averaged over operators.
        operators: who did a task with both.
        differing: for how many of them the two differ.
        p_raw: exact, two-sided.
        p_holm: times the number of all pairs of retargeters, 1 at most.
        p_dunnett: times the number of comparisons with the baseline; None where neither is it.
    """

    difference: float
    operators: int
    differing: int
    p_raw: float
    p_holm: float = float("nan")
    p_dunnett: float | None = None


@dataclass(frozen=True)
class Separated:
    """A retargeter that no logistic model can hold, since it never or always succeeds.

    Attributes:
        rate: observed, 0 or 1.
        trials: how many.
        operators: of how many.
        bound: one-sided 95 % bound of the success rate (upper for a rate of 0, lower for 1), exact
            with operators as units.
        bound_if_independent: the same if all trials were independent (Clopper and Pearson).
        against: every other retargeter.
    """

    rate: float
    trials: int
    operators: int
    bound: float
    bound_if_independent: float
    against: Mapping[str, ExactTest]


@dataclass(frozen=True)
class Refused:
    """Reason why a part of the analysis has no figures."""

    refused: str


Figures = TypeVar("Figures")


def figures_or_refused(compute: Callable[[], Figures]) -> Figures | Refused:
    """Result of a call, or the reason why it has none."""
    try:
        return compute()
    except StudyError as error:
        return Refused(str(error))
    except np.linalg.LinAlgError:
        return Refused("the rows do not carry this model: its equations are singular")


@dataclass(frozen=True)
class ScopeResult:
    """One outcome, over all tasks or one of them, in one mode.

    Attributes:
        coefficients: by name.
        emm: by retargeter.
        dunnett: by retargeter, without the baseline.
        pairs: by ``a-b``.
        n: rows of the model.
        operators: clusters of the model.
        model: facts of the fit: formula, variances, working correlation.
        diagnostics: what was checked, and the results.
        separated: retargeters that never or always succeed; they are in no other table.
        observed: rows, mean and spread of each retargeter as they are, without a model.
        warnings: what to know before believing it.
        refused: why there are no figures; None if there are.
    """

    coefficients: Mapping[str, Coefficient] = field(default_factory=dict)
    emm: Mapping[str, Mean] = field(default_factory=dict)
    dunnett: Mapping[str, Against] = field(default_factory=dict)
    pairs: Mapping[str, Pair] = field(default_factory=dict)
    n: int = 0
    operators: int = 0
    model: Mapping[str, Any] = field(default_factory=dict)
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    separated: Mapping[str, Separated] = field(default_factory=dict)
    observed: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    refused: str | None = None


@dataclass(frozen=True)
class Drawn:
    """A number with its 95 % percentile interval of a bootstrap over operators."""

    estimate: float
    lower: float
    upper: float


def drawn(value: float, draws: np.ndarray) -> Drawn:
    """A number and the 2.5 and 97.5 % points of what the bootstrap has (draws,), NaN left out."""
    finite = draws[np.isfinite(draws)]
    low, high = np.percentile(finite, [2.5, 97.5]) if len(finite) else (np.nan, np.nan)
    return Drawn(float(value), float(low), float(high))


def operator_weights(operators: int, *, seed: int, draws: int = DRAWS) -> Float[np.ndarray, "k g"]:
    """Counts of each operator in each sample; the first sample has everybody once.

    Args:
        operators: how many there are.
        seed: of the draws.
        draws: samples after the first.
    """
    rng = np.random.default_rng(seed)
    chosen = rng.integers(operators, size=(draws, operators))
    counts = np.zeros((draws + 1, operators))
    counts[0] = 1
    np.add.at(counts, (np.arange(1, draws + 1)[:, None], chosen), 1)
    return counts


def operator_signs(operators: int, *, seed: int, draws: int) -> Float[np.ndarray, "k g"]:
    """1 or -1 for each operator of each sample, for tests that change operators' signs.

    Args:
        operators: how many there are.
        seed: of the draws.
        draws: samples.
    """
    return np.random.default_rng(seed).choice([-1.0, 1.0], (draws, operators))


def plain(value: Any) -> Any:
    """Dataclasses and mappings as JSON values; what is not a finite number becomes null."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return value
