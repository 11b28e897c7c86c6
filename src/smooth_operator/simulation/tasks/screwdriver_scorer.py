"""Task C, screwdriver pivot, in numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from smooth_operator.simulation.scenes.screwdriver import ScrewdriverScene
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.scorer import (
    NOT_DONE,
    PRESSES_N,
    Standing,
    held_since,
    lasted,
    outside,
    rotation,
)

DOWN: Final = np.radians(10.0)
"""The blade points down when it is this near the vertical [rad]."""

CLOSE: Final = np.radians(30.0)
"""And close to it, which is worth half, when it is this near [rad]."""

_STILL: Final = 0.5  # [rad/s]


@dataclass(frozen=True, eq=False)
class ScrewdriverScorer:
    """What has happened to the screwdriver.

    Attributes:
        scene: where.
        angle: between its blade and straight down [rad].
        held: in the hand, by nothing else.
        pointing: since when it has been held, still, pointing down [s].
        gone: it fell.
        done: it has pointed down for long enough.
    """

    scene: ScrewdriverScene
    angle: float = np.pi / 2
    held: bool = False
    pointing: float | None = None
    gone: bool = False
    done: bool = False

    @property
    def standing(self) -> Standing:
        """See ``Scorer``."""
        if self.gone:
            return Standing(0.0, "dropped", "the screwdriver fell", dropped=True)
        if self.done:
            return Standing(1.0, "done", "points down", complete=True)
        degrees = f"{np.degrees(self.angle):.0f}° from down"
        if not self.held:
            return Standing(0.0, NOT_DONE, f"{degrees}, not held by the hand alone")
        if self.angle <= CLOSE:
            return Standing(0.5, "nearly", degrees)
        return Standing(0.0, NOT_DONE, degrees)

    def observe(self, state: SceneState) -> Self:
        """See ``Scorer``."""
        blade = rotation(state.quaternion)[:, 2]
        angle = float(np.arctan2(np.hypot(blade[0], blade[1]), -blade[2]))
        touched = bool(np.any(state.force > PRESSES_N))
        held = touched and not state.fixed and state.support == 0.0
        still = float(np.linalg.norm(state.spin)) < _STILL
        pointing = held_since(self.pointing, held and still and angle <= DOWN, state.time)
        return replace(
            self, angle=angle, held=held, pointing=pointing,
            gone=self.gone or state.support > 0.0 or outside(self.scene, state),
            done=self.done or lasted(pointing, state.time),
        )  # fmt: skip
