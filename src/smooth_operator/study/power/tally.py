"""Counts of verdicts over many studies, with their Monte-Carlo error."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from smooth_operator.study.power.assumptions import Assumptions
from smooth_operator.study.power.verdicts import Verdict

_Z: Final = 1.959963984540054

Counts = dict[str, int]
"""What was counted -> how often; see ``count``."""


@dataclass(frozen=True)
class Rate:
    """How often something happened.

    Attributes:
        rate: share of the studies.
        se: its Monte-Carlo standard error.
        lower: of the 95 % interval (Wilson 1927).
        upper: of it.
    """

    rate: float
    se: float
    lower: float
    upper: float


@dataclass
class Tally:
    """Counts of one number of operators and one truth, which can be added up.

    Attributes:
        studies: how many.
        counts: ``outcome/scope/mode`` -> counts.
    """

    studies: int = 0
    counts: dict[str, Counter[str]] = field(default_factory=dict)

    def add(
        self,
        verdicts: Iterable[Verdict],
        truth: Assumptions,
        baseline: str,
        margins: Mapping[str, float],
    ) -> None:
        """One study more."""
        self.studies += 1
        for verdict in verdicts:
            key = f"{verdict.outcome}/{verdict.scope}/{verdict.mode}"
            self.counts.setdefault(key, Counter()).update(count(verdict, truth, baseline, margins))

    def merge(self, studies: int, counts: Mapping[str, Mapping[str, int]]) -> None:
        """The counts of other studies."""
        self.studies += studies
        for key, more in counts.items():
            self.counts.setdefault(key, Counter()).update(more)


def count(
    verdict: Verdict, truth: Assumptions, baseline: str, margins: Mapping[str, float] | None = None
) -> Counts:
    """What one verdict got right and wrong.

    Args:
        verdict: of one outcome.
        truth: what was assumed.
        baseline: condition that others are compared with.
        margins: outcome -> largest difference of equivalent conditions, in its unit.

    Returns:
        ``dunnett:NAME`` and ``holm:A-B``: a true difference was found, with its right sign;
        ``dunnett:all`` and ``holm:all``: all of them; ``family:dunnett`` and ``family:holm``: a
        difference was found that is none, or with the wrong sign; ``equivalent:NAME``: its
        difference from the baseline was shown to be below the margin; ``refused``.
    """
    if verdict.refused is not None:
        return {"refused": 1}
    values = {"success": truth.success, "time": truth.time_s, "tlx": truth.workload}
    value = values[verdict.outcome]
    found: Counts = {}
    margin = (margins or {}).get(verdict.outcome)
    if margin is not None:
        for name, smallest in verdict.smallest_margin.items():
            if smallest < margin:
                found[f"equivalent:{name}"] = 1
    families = {
        "dunnett": {name: (name, baseline, sign) for name, sign in verdict.against.items()},
        "holm": {f"{a}-{b}": (a, b, sign) for (a, b), sign in verdict.pairs.items()},
    }
    for family, tests in families.items():
        wrong, true, right = False, 0, 0
        for name, (a, b, sign) in tests.items():
            really = _sign(value[a] - value[b])
            true += really != 0
            if sign and sign == really:
                found[f"{family}:{name}"] = 1
                right += 1
            wrong = wrong or (sign != 0 and sign != really)
        if wrong:
            found[f"family:{family}"] = 1
        if true and right == true:
            found[f"{family}:all"] = 1
    return found


def rate(hits: int, studies: int) -> Rate:
    """A share with its error."""
    p = hits / studies
    spread = _Z * math.sqrt(p * (1 - p) / studies + _Z**2 / (4 * studies**2))
    centre, scale = p + _Z**2 / (2 * studies), 1 + _Z**2 / studies
    return Rate(
        p,
        math.sqrt(p * (1 - p) / studies),
        (centre - spread) / scale if hits else 0.0,
        (centre + spread) / scale if hits < studies else 1.0,
    )


def rates(tally: Tally) -> dict[str, dict[str, Any]]:
    """``outcome/scope/mode`` -> what was counted -> ``Rate``."""
    return {
        key: {
            what: rate(counts[what], tally.studies)
            for what in sorted({*counts, "family:dunnett", "family:holm", "refused"})
        }
        for key, counts in tally.counts.items()
    }


def _sign(x: float) -> int:
    return (x > 0) - (x < 0)
