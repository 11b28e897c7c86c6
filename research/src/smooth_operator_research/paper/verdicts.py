"""Verdicts on the paper's claims, by fixed rules.

The rules use intervals, not means alone, and are the same whether or not a result agrees with the
paper. A wider interval around the same mean never gives a better verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from smooth_operator_research.paper.intervals import Estimate

Held: TypeAlias = Literal["held", "held in part", "mixed", "not shown", "did not hold"]

SHARE: Final = 0.8
"""The whole interval of an effect must lie beyond this fraction of the claimed size (logarithmic
for ratios): a non-inferiority margin of a fifth."""

RULES: Final = (
    "Intervals are Student's t over independent units: a file, or one operator of the built-in "
    "ones; parts of one recording count as one. A direction is shown if the 95 % interval "
    "excludes no effect. A claim of a size held if the whole interval lies beyond four fifths of "
    "the claimed effect (logarithmic for ratios), and held in part if only the direction is "
    "shown. A claim of equality held if the whole interval lies within the stated margin, and did "
    "not hold if all of it lies outside. A claim of several parts held if every part held, and "
    "held in part if every direction is shown. Otherwise each part is judged again with an "
    "interval that is widened for their number (Bonferroni): held in part if at least one part is "
    "shown and none in the opposite direction; mixed if parts are shown in both directions; did "
    "not hold if parts are shown in the opposite direction and none as claimed; not shown if none "
    "is shown."
)


@dataclass(frozen=True)
class Verdict:
    """The verdict on one claim of the paper.

    Attributes:
        claim: the claim in the paper's sense, in one line.
        paper: the paper's value.
        ours: our value with its interval.
        held: whether the claim held.
        note: what a reader must know to judge it, besides the tables.
    """

    claim: str
    paper: str
    ours: str
    held: Held
    note: str = ""


class Judge(Protocol):
    """Judges a part of a claim."""

    def __call__(self, estimate: Estimate, *, among: int = 1) -> Held:
        """Judges one of ``among`` parts."""


@dataclass(frozen=True)
class Direction:
    """Rule: a value lies on the claimed side of a limit.

    Attributes:
        none: the limit: the value without an effect, or the smallest that counts.
        upwards: True if the value is claimed to be larger.
    """

    none: float
    upwards: bool

    def __call__(self, estimate: Estimate, *, among: int = 1) -> Held:
        """See ``Judge``."""
        low, high = estimate.interval(among)
        if low is None or high is None or low <= self.none <= high:
            return "not shown"
        return "held" if (low > self.none) == self.upwards else "did not hold"


@dataclass(frozen=True)
class Effect:
    """Rule: an effect exists and is about as large as claimed, or larger.

    Attributes:
        none: value without an effect.
        claimed: value in the paper.
    """

    none: float
    claimed: float

    def __call__(self, estimate: Estimate, *, among: int = 1) -> Held:
        """See ``Judge``."""
        upwards = self.claimed > self.none
        shown = Direction(self.none, upwards)(estimate, among=among)
        if shown != "held":
            return shown
        least = estimate.part_of(self.claimed, self.none, SHARE)
        return (
            "held" if Direction(least, upwards)(estimate, among=among) == "held" else "held in part"
        )


@dataclass(frozen=True)
class Equality:
    """Rule: a value lies within a margin.

    Attributes:
        low, high: ends of the margin.
    """

    low: float
    high: float

    def __call__(self, estimate: Estimate, *, among: int = 1) -> Held:
        """See ``Judge``."""
        low, high = estimate.interval(among)
        if low is None or high is None:
            return "not shown"
        if self.low <= low and high <= self.high:
            return "held"
        return "did not hold" if high < self.low or low > self.high else "not shown"


def judge(judging: Judge, estimates: Sequence[Estimate], missing: int = 0) -> Held:
    """Judges a claim of one or several parts.

    Args:
        judging: the rule that judges a part.
        missing: parts without a measurement; with any, the claim can't hold as a whole.
    """
    parts = len(estimates) + missing
    plain = [judging(one) for one in estimates]
    if estimates and not missing and all(one == "held" for one in plain):
        return "held"
    if estimates and not missing and all(one.startswith("held") for one in plain):
        return "held in part"  # every direction is shown, which needs no correction
    strict = plain if parts < 2 else [judging(one, among=parts) for one in estimates]
    shown = any(one.startswith("held") for one in strict)
    opposite = any(one == "did not hold" for one in strict)
    if shown:
        return "mixed" if opposite else "held in part"
    return "did not hold" if opposite else "not shown"
