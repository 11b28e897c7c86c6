"""How far a demonstration asks for more self-penetration than a retargeter should send."""

from __future__ import annotations

from functools import cache
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.hands.collision import colliding_shapes, owners
from smooth_operator.hands.hand import Hand
from smooth_operator_research.demonstrations.demonstration import Demonstration

PINCH: Final = 0.004
"""So deep may thumb and finger be inside each other [m]: pads give way, and a grip needs force."""

ELSEWHERE: Final = 0.001
"""So deep may other parts be [m]."""


def excess(demonstration: Demonstration) -> float:
    """Self-penetration beyond what is allowed, added over key poses and halfway between [m]."""
    hand, times = demonstration.robot, demonstration.times
    counts, allowed = _pairs(hand)
    data, total = mujoco.MjData(hand.model), 0.0
    for time in np.sort(np.concatenate([times, (times[1:] + times[:-1]) / 2])):
        data.qpos[:] = hand.qpos(hand.full_configuration(demonstration.pose(float(time))))
        mujoco.mj_kinematics(hand.model, data)
        mujoco.mj_comPos(hand.model, data)
        mujoco.mj_collision(hand.model, data)
        one, two = np.array(data.contact.geom).reshape(-1, 2).T
        beyond = np.where(counts[one, two], -data.contact.dist - allowed[one, two], 0.0)
        total += max(0.0, float(beyond.max(initial=0.0)))
    return total


@cache
def _pairs(hand: Hand) -> tuple[Bool[np.ndarray, "g g"], Float[np.ndarray, "g g"]]:
    """Which pairs of shapes count, and how deep each may be [m]."""
    owner = owners(hand)[hand.model.geom_bodyid]
    thumb, finger = owner == 0, owner > 0
    pinch = (thumb[:, None] & finger) | (finger[:, None] & thumb)
    return colliding_shapes(hand), np.where(pinch, PINCH, ELSEWHERE)
