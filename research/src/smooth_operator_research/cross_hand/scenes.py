"""Scenes of the cross-hand matrix, cached, because all worlds of a task share one."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes import scene_for


@lru_cache
def scene_of(task: str, hand: Hand) -> Any:
    """Returns ``scene_for(task, hand)``, a scene of the task's own class."""
    return scene_for(task, hand)
