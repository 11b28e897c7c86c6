"""What a person should know before a method runs on a hand."""

from __future__ import annotations

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.stand_ins import stand_in_note
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.smooth import SmoothConfig
from smooth_operator.methods.whole import WholeConfig


def method_notes(config: MethodConfig, hand: Hand) -> tuple[str, ...]:
    """Sentences about what a method lacks on a hand; none where nothing is lacking.

    Args:
        config: of the method.
        hand: the robot hand.
    """
    causal = config.causal if isinstance(config, WholeConfig) else config
    if not isinstance(causal, SmoothConfig) or not causal.clearance.weight:
        return ()
    note = stand_in_note(hand)
    return (note,) if note else ()
