"""Verdicts on the paper's claims, by fixed rules.

The rules look at intervals, not at figures alone, and are the same for what suits the paper and for
what does not. A wider interval about the same figure never gives a better verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from smooth_operator_research.paper.intervals import Estimate

Held: TypeAlias = Literal["held", "held in part", "mixed", "not shown", "did not hold"]

SHARE: Final = 0.8
"""The whole interval of an effect must lie beyond this share of the claimed size, logarithmic for
ratios: a non-inferiority margin of a fifth."""

RULES: Final = (
    "Intervals are Student's t over independent units: a file, or one operator of the built-in "
    "ones; parts of one recording count as one. A direction is shown where the 95 % interval "
    "leaves out no effect. A claim of a size held if the whole interval lies beyond four fifths of "
    "the claimed effect (logarithmic for ratios), and held in part if the direction alone is "
    "shown. A claim of equality held if the whole interval lies within the stated margin, and did "
    "not hold if all of it lies outside. A claim of several parts held if every part held, and "
    "held in part if every direction is shown. Otherwise each part is judged again with an "
    "interval that is widened for their number (Bonferroni): held in part if at least one part is "
    "shown and none the other way round; mixed if some are shown and some the other way round; did "
    "not hold if some are shown the other way round and none as claimed; not shown if none is "
    "shown."
)


@dataclass(frozen=True)
class Verdict:
    """One claim.

    Attributes:
        claim: in the paper's sense, one line.
        paper: its figure.
        ours: our figure with its interval.
        held: whether it held.
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
    """A figure lies on the claimed side of a value.

    Attributes:
        none: the value, of no effect or of the least that counts.
        upwards: is it claimed to be larger?
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
    """An effect exists and is about as large as claimed, or larger.

    Attributes:
        none: its value where there is no effect.
        claimed: its value in the paper.
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
    """A figure lies within a margin.

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
        judging: judges a part.
        missing: parts without a measurement: the claim can't hold as a whole then.
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
