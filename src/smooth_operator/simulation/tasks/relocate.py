"""The task ``relocate``: pick up an object and hold it at a target in the air.

The rule for half a point is that of Adroit's ``relocate`` (Rajeswaran et al., "Learning Complex
Dexterous Manipulation with Deep Reinforcement Learning and Demonstrations", RSS 2018): within 10 cm
of the target at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from smooth_operator.simulation.scenes.relocate import RelocateScene
from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.simulation.tasks.task import (
    COMMON_ENDS,
    NOT_DONE,
    Assessment,
    RubricLine,
    Task,
    held_by_hand,
    held_since,
    lasted,
    outside,
)

AT_TARGET: Final = 0.03
"""Distance from the target up to which the object is there [m]."""

NEAR_TARGET: Final = 0.10
"""Distance from the target that scores 0.5 [m]."""

_SLOW: Final = 0.05  # highest speed of an object that is held still [m/s]

RELOCATE: Final = Task(
    "relocate",
    title="Relocate",
    instruction="Pick up the object and hold it at the mark in the air.",
    rubric=(
        RubricLine("done", 1.0, "held still within 3 cm of the mark for half a second"),
        RubricLine("near", 0.5, "carried to within 10 cm of the mark"),
        *COMMON_ENDS,
    ),
)


@dataclass(frozen=True, eq=False)
class RelocateScorer:
    """Scores the task ``relocate``.

    Attributes:
        scene: the scene of the trial.
        distance: distance of the object from the target [m].
        held: True while the hand alone holds it.
        near: True once it was carried to within ``NEAR_TARGET``.
        there: time since which it has been held still at the target [s].
        gone: True once it has left the workspace.
        done: True once it was at the target for ``HOLD_S``.
    """

    scene: RelocateScene
    distance: float = float("inf")
    held: bool = False
    near: bool = False
    there: float | None = None
    gone: bool = False
    done: bool = False

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""
        if self.done:
            return Assessment(1.0, "done", "held at the target", complete=True)
        place = f"{100 * self.distance:.0f} cm from the target"
        if self.near:
            reason = "was within 10 cm of the target, then fell" if self.gone else place
            return Assessment(0.5, "near", reason, dropped=self.gone)
        if self.gone:
            return Assessment(0.0, "dropped", "the object fell", dropped=True)
        return Assessment(0.0, NOT_DONE, place if self.held else "not held by the hand alone")

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""
        distance = float(np.linalg.norm(state.position - self.scene.target))
        held = held_by_hand(state)
        size = self.scene.scale
        still = float(np.linalg.norm(state.velocity)) < _SLOW
        there = held_since(self.there, held and still and distance <= AT_TARGET * size, state.time)
        return replace(
            self,
            distance=distance,
            held=held,
            near=self.near or (held and distance <= NEAR_TARGET * size),
            there=there,
            gone=self.gone or outside(self.scene, state),
            done=self.done or lasted(there, state.time),
        )
