"""What a trial needs of the simulation that it runs in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes import Scene, SceneState
from smooth_operator.types import Side

Watcher = Callable[[SceneState, Float[np.ndarray, " n"]], None]
"""Called with the scene and the (n,) joint positions [rad], from the thread of the physics."""


class LiveSimulation(Protocol):
    """A running simulation of hands and what they work on, such as the sink ``mujoco``."""

    @property
    def task_now(self) -> str:
        """Name of the task; ``none`` for no task."""
        ...

    def change_task(self, task: str) -> None:
        """Put another scene around the hands."""
        ...

    def scene_of(self, side: Side) -> Scene:
        """The scene around a hand."""
        ...

    def hand_of(self, side: Side) -> Hand:
        """The robot hand of a side."""
        ...

    def watch(self, side: Side, watcher: Watcher | None) -> None:
        """Call ``watcher`` after each step of the physics; None ends it."""
        ...

    def reset_object(self, side: Side) -> int:
        """Put the object back; the number of the world from then on."""
        ...
