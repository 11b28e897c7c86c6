"""What trials and pages need of a running simulation of hands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.rigid import Matrix
from smooth_operator.simulation.scenes import Scene, ScenePart, SceneState
from smooth_operator.types import Side

Watcher = Callable[[SceneState, Float[np.ndarray, " n"]], None]
"""Called with the scene and the (n,) joint positions [rad], from the thread of the physics."""


class SimulatedHand(Protocol):
    """Where a simulated hand is."""

    @property
    def positions(self) -> Float[np.ndarray, " n"]:
        """(n,) positions of all joints [rad], in the order of ``hand.joint_names``."""
        ...

    @property
    def time(self) -> float:
        """For which moment, by the loop's clock [s]."""
        ...


class LiveSimulation(Protocol):
    """A running simulation of hands and what they work on, such as the sink ``mujoco``."""

    @property
    def task_now(self) -> str:
        """Name of the task; ``none`` for no task."""
        ...

    @property
    def world_number(self) -> int:
        """Changes with every scene that is built, and is 0 while there is none."""
        ...

    def state(self, side: Side) -> SimulatedHand | None:
        """Where a hand is now; safe from any thread. None while there is no such hand."""
        ...

    def scene_state(self, side: Side) -> SceneState | None:
        """Where the object is now; safe from any thread. None without a task or such a hand."""
        ...

    def arm_base(self, side: Side) -> Matrix | None:
        """Pose (4, 4) of the base of the arm that carries a hand, in the scene around it; None
        without an arm or a task."""
        ...

    def change_task(self, task: str) -> None:
        """Put another scene around the hands."""
        ...

    def scene_of(self, side: Side) -> Scene:
        """The scene around a hand."""
        ...

    def parts_of(self, side: Side) -> list[ScenePart]:
        """Shapes of platform and object, to draw."""
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

    def freeze(self, side: Side, frozen: bool) -> None:
        """Have a hand and its scene stand still, their clock included, or go on."""
        ...

    def put_away(self, side: Side) -> None:
        """Go on without the object, until it is put back."""
        ...
