"""Reading: completion time on the log scale, as ratios of geometric means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from smooth_operator.study.analysis.frame import Frame
from smooth_operator.study.analysis.linear_outcome import analyze_linear
from smooth_operator.study.analysis.readings.parts import Refused
from smooth_operator.study.analysis.results import MODES


@dataclass(frozen=True)
class TimeRatio:
    """Geometric mean time over the baseline's, with its simultaneous interval."""

    ratio: float
    lower: float
    upper: float
    df: float
    p_raw: float
    p_dunnett: float


@dataclass(frozen=True)
class LogTime:
    """The model of completion times, fitted to their logarithm.

    Attributes:
        geometric_mean: by retargeter [s].
        ratios: by retargeter, without the baseline.
        skewness: of the residuals.
        skewness_of_seconds: of those of the model of seconds, to compare with.
    """

    geometric_mean: Mapping[str, float]
    ratios: Mapping[str, TimeRatio]
    skewness: float | None
    skewness_of_seconds: float | None
    n: int
    operators: int


def log_time(frame: Frame, skewness: float | None) -> LogTime | Refused:
    """Fits the logarithm of times.

    Args:
        frame: rows of times [s].
        skewness: of the residuals of the model of seconds; None where that is refused.
    """
    logs = replace(frame, outcome=np.log(frame.outcome))
    found = analyze_linear(logs, modes=MODES[:1])[MODES[0]]
    if found.refused is not None:
        return Refused(found.refused)
    return LogTime(
        geometric_mean={name: float(np.exp(mean.estimate)) for name, mean in found.emm.items()},
        ratios={
            name: TimeRatio(
                float(np.exp(test.difference)),
                float(np.exp(test.lower)),
                float(np.exp(test.upper)),
                test.df,
                test.p_raw,
                test.p_dunnett,
            )
            for name, test in found.dunnett.items()
        },
        skewness=found.diagnostics.get("skewness"),
        skewness_of_seconds=skewness,
        n=found.n,
        operators=found.operators,
    )
