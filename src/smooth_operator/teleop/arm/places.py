"""Where the arms of a run stand in the room: x forward, y left, z up, the table at the bases."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.carried import CarriedHand
from smooth_operator.simulation.arms.catalogue import arm_named
from smooth_operator.simulation.arms.hand_mount import HandMount
from smooth_operator.simulation.arms.rigid import rigid
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.types import Side


def place_arms(settings: ArmSettings, hands: Mapping[Side, Hand]) -> dict[Side, CarriedHand]:
    """Each hand on its arm, in the arm's nominal posture; two arms stand next to each other.

    Args:
        settings: of all arms.
        hands: side -> robot hand.
    """
    arm = arm_named(settings.name)
    roll = arm.roll if settings.roll is None else radians(settings.roll)
    apart = settings.spacing / 2 if len(hands) > 1 else 0.0
    return {
        side: CarriedHand(
            arm,
            HandMount(hand, settings.adapter, roll),
            np.array(arm.nominal),
            rigid(np.eye(3), (0.0, -apart if side == "right" else apart, 0.0)),
        )
        for side, hand in hands.items()
    }
