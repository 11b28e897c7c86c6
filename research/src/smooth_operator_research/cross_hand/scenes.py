"""Scenes of the cross-hand matrix, cached, because all worlds of a task share one."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes import scene_for
from smooth_operator.simulation.scenes.scene import reachable
from smooth_operator.simulation.scenes.task_scenes import SCENES

SCALED: Final = ":scaled"
"""End of the name of a task whose lengths are scaled by the length of the robot hand."""

HAND_LENGTH: Final = 0.19
"""Length of the human hand, from the wrist to the tip of the middle finger [m]."""


@lru_cache
def scene_of(task: str, hand: Hand) -> Any:
    """Returns the scene of a task around a hand, an object of the task's own class.

    Args:
        task: name of the task; with ``SCALED``, lengths have the ratio of the robot hand to the
            human hand, and masses its third power.
    """
    if not task.endswith(SCALED):
        return scene_for(task, hand)
    make: Any = SCENES[task.removesuffix(SCALED)]
    return make(hand, scale=hand_length(hand) / HAND_LENGTH)


def hand_length(hand: Hand) -> float:
    """Largest distance between the wrist and a fingertip in random poses [m]."""
    return float(np.linalg.norm(reachable(hand)[:, 1:], axis=-1).max())
