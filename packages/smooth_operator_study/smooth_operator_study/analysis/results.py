"""Results of an analysis, and their JSON form.

``results.json`` is ``{mode: {outcome: {scope: ...}}}``, and ``learning``, ``spearman``,
``tlx_items``, ``operator_variance`` and ``study``. Missing numbers are null. A refused analysis has
its reason in ``refused``, and empty tables.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, ParamSpec, TypeAlias, TypeVar

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator_study.design.protocol import OUTCOMES as OUTCOMES
from smooth_operator_study.design.protocol import POOLED as POOLED
from smooth_operator_study.design.protocol import Outcome as Outcome

Mode: TypeAlias = Literal["small-sample", "paper"]
MODES: Final[tuple[Mode, ...]] = ("small-sample", "paper")
"""Modes of the analysis, the default first."""


@dataclass(frozen=True)
class Coefficient:
    """Coefficient of a model, on the logit scale for success."""

    estimate: float
    se: float
    df: float
    p: float


@dataclass(frozen=True)
class Mean:
    """Estimated marginal mean with its 95 % interval."""

    estimate: float
    se: float
    df: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Against:
    """Difference of a retargeter from the baseline, with a simultaneous 95 % interval."""

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
    """Difference of two retargeters, ``a`` minus ``b``."""

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
class Separated:
    """Retargeter that never or always succeeds, for which success has Firth's model.

    Attributes:
        rate: observed success rate, 0 or 1.
        trials: number of trials.
        operators: number of operators.
        bound: exact one-sided 95 % bound of the success rate with operators as units (upper for a
            rate of 0, lower for 1).
        bound_if_independent: bound for independent trials (Clopper and Pearson).
    """

    rate: float
    trials: int
    operators: int
    bound: float
    bound_if_independent: float


@dataclass(frozen=True)
class Refused:
    """Reason why a part of the analysis has no figures."""

    refused: str


P = ParamSpec("P")
Figures = TypeVar("Figures")


def refusable(compute: Callable[P, Figures]) -> Callable[P, Figures | Refused]:
    """Makes a function return ``Refused`` with the reason where it can't compute its figures."""

    @functools.wraps(compute)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Figures | Refused:
        try:
            return compute(*args, **kwargs)
        except StudyError as error:
            return Refused(str(error))
        except np.linalg.LinAlgError:
            return Refused("the data is not sufficient for this model: its equations are singular")

    return wrapped


@dataclass(frozen=True)
class ScopeResult:
    """Result of one outcome, over all tasks or one of them, in one mode.

    Attributes:
        coefficients: coefficients by name.
        emm: estimated marginal means by retargeter.
        dunnett: differences from the baseline by retargeter.
        pairs: differences of pairs by ``a-b``.
        n: number of rows of the model.
        operators: number of operators of the model.
        model: facts of the fit: formula, variances, working correlation.
        diagnostics: results of the checks of assumptions.
        separated: retargeters that never or always succeed.
        observed: rows, mean and spread of each retargeter without a model.
        warnings: limitations of the result.
        refused: reason why there are no figures; None if there are.
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


def plain(value: Any) -> Any:
    """Converts dataclasses and mappings to JSON values; numbers that are not finite become null."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    return value
