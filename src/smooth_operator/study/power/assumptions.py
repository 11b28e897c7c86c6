"""Assumptions of a power simulation: success of conditions, differences between operators.

The defaults for conditions are the means that the paper reports; how much operators, trials and
tasks differ is an assumption that makes its design look as it does there (operators differ by some
13 points of success, 4 s and 10 points of workload). Put in your own from a pilot study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from smooth_operator.errors import StudyError

PAPER_SUCCESS: Final = {"sbr": 0.541, "dexpilot": 0.440, "geort": 0.266, "hybrid": 0.521}
"""Probability of a score of 0.5 or 1."""
PAPER_TIME_S: Final = {"sbr": 29.7, "dexpilot": 23.3, "geort": 33.3, "hybrid": 21.6}
"""Mean time of successful trials [s]."""
PAPER_WORKLOAD: Final = {"sbr": 36.4, "dexpilot": 44.0, "geort": 56.4, "hybrid": 38.4}
"""Mean raw NASA-TLX."""


@dataclass(frozen=True)
class Spread:
    """One number for each outcome.

    Attributes:
        success: on the logit scale.
        time_s: [s].
        workload: points of NASA-TLX.
    """

    success: float
    time_s: float
    workload: float


@dataclass(frozen=True)
class Assumptions:
    """The truth of a simulated study.

    Attributes:
        success: condition -> probability of success, averaged over operators and tasks.
        time_s: condition -> mean time of successful trials [s].
        workload: condition -> mean raw NASA-TLX, 0 to 100.
        operators: standard deviation between operators.
        interaction: standard deviation of how an operator does with one condition in particular;
            people have preferences, so it is not zero.
        trials: standard deviation between trials of an operator; of success there is none but in
            its probability; of workload it is shared by the six scales.
        scales: standard deviation of each scale of NASA-TLX on top [points].
        practice: change per trial, or per questionnaire for workload, centred.
        tasks: task -> how it differs from the mean of the tasks.
    """

    success: Mapping[str, float]
    time_s: Mapping[str, float]
    workload: Mapping[str, float]
    operators: Spread = Spread(0.6, 4.0, 10.0)
    interaction: Spread = Spread(0.3, 2.0, 5.0)
    trials: Spread = Spread(0.0, 7.0, 6.0)
    scales: float = 8.0
    practice: Spread = Spread(0.012, -0.06, -0.4)
    tasks: Mapping[str, Spread] = field(
        default_factory=lambda: {
            "A": Spread(0.55, -5.0, -4.0),
            "B": Spread(-0.1, 0.5, 0.0),
            "C": Spread(-0.45, 4.5, 4.0),
        }
    )

    def __post_init__(self) -> None:
        for name, p in self.success.items():
            if not 0.005 <= p <= 0.995:
                raise StudyError(
                    f"success of {name}: expected a probability from 0.005 to 0.995, not {p}"
                )
        for name, seconds in self.time_s.items():
            if not (math.isfinite(seconds) and seconds > 0):
                raise StudyError(f"time of {name}: expected seconds above 0, not {seconds}")
        for name, points in self.workload.items():
            if not 0 <= points <= 100:
                raise StudyError(f"workload of {name}: expected 0 to 100 points, not {points}")
        for spread in (self.operators, self.interaction, self.trials):
            if not all(0 <= x < 1e4 for x in (spread.success, spread.time_s, spread.workload)):
                raise StudyError(f"a standard deviation can't be negative or endless: {spread}")

    def null(self, baseline: str) -> Assumptions:
        """The same, with every condition as good as the baseline."""
        return replace(
            self,
            success=dict.fromkeys(self.success, self.success[baseline]),
            time_s=dict.fromkeys(self.time_s, self.time_s[baseline]),
            workload=dict.fromkeys(self.workload, self.workload[baseline]),
        )


def assumptions_for(
    conditions: Sequence[str],
    *,
    success: Mapping[str, float] | None = None,
    time_s: Mapping[str, float] | None = None,
    workload: Mapping[str, float] | None = None,
    **more: object,
) -> Assumptions:
    """Assumptions for all conditions; the paper's where nothing else is given.

    Args:
        conditions: of the study.
        success: condition -> probability.
        time_s: condition -> [s].
        workload: condition -> points.
        more: other fields of ``Assumptions``.

    Raises:
        StudyError: a condition is given that the study hasn't, or one has no value.
    """
    found: dict[str, Mapping[str, float]] = {}
    for what, given, known in (
        ("success", success, PAPER_SUCCESS),
        ("time_s", time_s, PAPER_TIME_S),
        ("workload", workload, PAPER_WORKLOAD),
    ):
        values = {**known, **(given or {})}
        for name in given or {}:
            if name not in conditions:
                raise StudyError(
                    f"{what} is given for {name!r}; the study's conditions are "
                    f"{', '.join(conditions)}"
                )
        lacking = [name for name in conditions if name not in values]
        if lacking:
            raise StudyError(
                f"what {what} of {', '.join(lacking)} is to be expected? Give it, as "
                f"{lacking[0]}=VALUE; only the paper's four methods have their own values"
            )
        found[what] = {name: float(values[name]) for name in conditions}
    return Assumptions(**found, **more)  # type: ignore[arg-type]
