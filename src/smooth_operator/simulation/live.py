"""Interface to a running simulation of hands, for trials and pages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import Matrix
from smooth_operator.simulation.scenes import Scene, ScenePart, SceneState
from smooth_operator.types import Side

Watcher = Callable[[SceneState, Float[np.ndarray, " n"]], None]
"""Function that the physics thread calls with the scene and the (n,) joint positions [rad]."""


class SimulatedHand(Protocol):
    """State of a simulated hand at one moment."""

    @property
    def positions(self) -> Float[np.ndarray, " n"]:
        """(n,) positions of all joints [rad], in the order of ``hand.joint_names``."""

    @property
    def time(self) -> float:
        """Time of the state on the loop's clock [s]."""


class LiveSimulation(Protocol):
    """A running simulation of hands and their objects, such as the sink ``mujoco``."""

    @property
    def task_now(self) -> str:
        """Name of the task; ``none`` for no task."""

    @property
    def world_number(self) -> int:
        """Number that changes whenever a new scene is loaded; 0 without a scene."""

    def state(self, side: Side) -> SimulatedHand | None:
        """Current state of a hand; None if there is no such hand. Safe from any thread."""

    def scene_state(self, side: Side) -> SceneState | None:
        """Current state of the object; None without a task or without that hand. Safe from any
        thread.
        """

    def arm_base(self, side: Side) -> Matrix | None:
        """Pose (4, 4) in the scene of the base of the arm that carries a hand; None without an arm
        or a task."""

    def change_task(self, task: str) -> None:
        """Replaces the scene around the hands."""

    def scene_of(self, side: Side) -> Scene:
        """The scene around a hand."""

    def parts_of(self, side: Side) -> list[ScenePart]:
        """Shapes of the platform and the object, for drawing."""

    def hand_of(self, side: Side) -> Hand:
        """The robot hand of a side."""

    def watch(self, side: Side, watcher: Watcher | None) -> None:
        """Calls ``watcher`` after each step of the physics; None stops the calls."""

    def reset_object(self, side: Side) -> int:
        """Puts the object back where it started. Returns the new world number."""

    def freeze(self, side: Side, frozen: bool) -> None:
        """Stops or resumes the physics and the clock of a hand and its scene."""

    def put_away(self, side: Side) -> None:
        """Removes the object until it is put back."""
