"""Registry of the scenes, by the task's name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.card import card_scene
from smooth_operator.simulation.scenes.cube import cube_scene
from smooth_operator.simulation.scenes.scene import Scene
from smooth_operator.simulation.scenes.screwdriver import screwdriver_scene

SCENES: Final[dict[str, Callable[[Hand], Scene]]] = {
    "card": card_scene,
    "cube": cube_scene,
    "screwdriver": screwdriver_scene,
}
"""Name of the task -> function that builds the scene for a hand."""


def scene_for(task: str, hand: Hand) -> Scene:
    """The scene of a task around a hand.

    Raises:
        UnknownNameError: there is no such task.
        HandModelError: the hand's size does not allow it.
    """
    if task not in SCENES:
        raise UnknownNameError("task", task, SCENES)
    return SCENES[task](hand)
