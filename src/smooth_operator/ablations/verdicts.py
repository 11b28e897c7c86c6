"""What the paper claims, what came out here, and whether the claim held: by rules set beforehand.

The rules look at intervals, not at figures alone, and are the same for what suits the paper and for
what does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from smooth_operator.ablations.bootstrap import Estimate

Held: TypeAlias = Literal["held", "held in part", "not shown", "did not hold"]

RULES: Final = (
    "held: the effect has the claimed direction, its interval leaves out none, and it is as large "
    "as claimed or the claimed figure lies in the interval; held in part: the direction is shown, "
    "the effect is smaller than claimed; not shown: the interval spans none, or there is no "
    "interval; did not hold: the interval lies on the other side. Claims of equality hold where "
    "the whole interval lies within the stated margin, and do not where all of it lies outside."
)


@dataclass(frozen=True)
class Verdict:
    """One claim.

    Attributes:
        claim: in the paper's sense, one line.
        paper: its figure.
        ours: our figure with its interval.
        held: whether it held.
        paragraph: all of that in words, with what a reader must know to judge it.
    """

    claim: str
    paper: str
    ours: str
    held: Held
    paragraph: str


def judge_effect(found: Estimate, none: float, claimed: float) -> Held:
    """Whether an effect is there, and as large as claimed.

    Args:
        found: what was measured.
        none: its value where there is no effect.
        claimed: its value in the paper, on one side of ``none``.
    """
    if found.low is None or found.high is None:
        return "not shown"
    if found.low <= none <= found.high:
        return "not shown"
    if (found.value > none) != (claimed > none):
        return "did not hold"
    as_large = abs(found.value - none) >= abs(claimed - none)
    return "held" if as_large or found.low <= claimed <= found.high else "held in part"


def judge_direction(found: Estimate, none: float, upwards: bool) -> Held:
    """Whether a figure lies on the claimed side of a value."""
    if found.low is None or found.high is None or found.low <= none <= found.high:
        return "not shown"
    return "held" if (found.value > none) == upwards else "did not hold"


def judge_equality(found: Estimate, low: float, high: float) -> Held:
    """Whether a figure lies within a margin."""
    if found.low is None or found.high is None:
        return "not shown"
    if low <= found.low and found.high <= high:
        return "held"
    return "did not hold" if found.high < low or found.low > high else "not shown"


def both(*held: Held) -> Held:
    """The verdict on a claim that says several things."""
    if all(one == "held" for one in held):
        return "held"
    if any(one == "did not hold" for one in held):
        return "held in part" if any(one == "held" for one in held) else "did not hold"
    return "held in part" if any(one.startswith("held") for one in held) else "not shown"
