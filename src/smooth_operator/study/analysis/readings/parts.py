"""What all readings are made of: an estimate with its interval, or a reason why there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.dunnett import quantile, two_sided


@dataclass(frozen=True)
class Refused:
    """Why a reading has no figures."""

    refused: str


@dataclass(frozen=True)
class Estimate:
    """A number with its standard error, 95 % interval and two-sided p, none of them adjusted.

    In the unit of the outcome (success: a share from 0 to 1).
    """

    estimate: float
    se: float
    df: float
    lower: float
    upper: float
    p: float


@dataclass(frozen=True)
class Drawn:
    """A number with its 95 % percentile interval of a bootstrap over operators."""

    estimate: float
    lower: float
    upper: float


def estimated(value: float, se: float, df: float) -> Estimate:
    """An estimate with its t interval and test."""
    reach = se * quantile(df)
    p = two_sided(value / se, df) if se > 0 else float("nan")
    return Estimate(float(value), float(se), float(df), value - reach, value + reach, p)


def drawn(value: float, draws: np.ndarray) -> Drawn:
    """A number and the 2.5 and 97.5 % points of what the bootstrap has (draws,), NaN left out."""
    known = draws[np.isfinite(draws)]
    low, high = np.percentile(known, [2.5, 97.5]) if len(known) else (np.nan, np.nan)
    return Drawn(float(value), float(low), float(high))


Found = TypeVar("Found")


def found_or_refused(find: Callable[[], Found]) -> Found | Refused:
    """What the call returns, or the reason why it could not."""
    try:
        return find()
    except StudyError as error:
        return Refused(str(error))
    except np.linalg.LinAlgError:
        return Refused("the rows do not carry this model: its equations are singular")
