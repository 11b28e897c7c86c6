"""Makes the rows of a table of a hand's joints: limits, neutral position, and coupling as text."""

from __future__ import annotations

from dataclasses import dataclass

from smooth_operator.hands.hand import Hand


@dataclass(frozen=True)
class JointRow:
    """One joint of a hand, for a table or a slider.

    Attributes:
        name: name in the model.
        low: lower limit [rad, or m for a slide].
        high: upper limit, reduced for an actuated joint so that coupled joints stay in range.
        neutral: position in the neutral pose.
        actuated: True if the joint is commanded.
        follows: coupling of a joint that follows another: ``1.06 index_1 - 0.05``.
    """

    name: str
    low: float
    high: float
    neutral: float
    actuated: bool
    follows: str = ""


def joint_rows(hand: Hand) -> list[JointRow]:
    """Rows for all joints of a hand, in the model's own order."""
    limits = hand.joint_limits.copy()
    limits[list(hand.actuated)] = hand.limits
    neutral = hand.full_configuration(hand.neutral)
    words = {c.joint: c.formula for c in hand.couplings}
    return [
        JointRow(
            name,
            float(limits[i, 0]),
            float(limits[i, 1]),
            float(neutral[i]),
            i in hand.actuated,
            words.get(name, ""),
        )
        for i, name in enumerate(hand.joint_names)
    ]
