"""Task B, vertical cube rotation, in numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.cube import CubeScene
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.scorer import (
    NOT_DONE,
    Standing,
    held_since,
    lasted,
    outside,
    rotation,
)

GOAL: Final = np.pi / 2
"""How far the cube is to be turned [rad]."""

TOLERANCE: Final = np.radians(15.0)
FLAT: Final = np.radians(10.0)
"""A cube stands flat when a face is this near the horizontal [rad]."""

_FLIPPED: Final = np.cos(np.radians(45.0))
_STILL: Final = 0.3  # [rad/s]
_LEANING_S: Final = 1.0  # a cube that has leant for so long won't fall flat by itself


@dataclass(frozen=True, eq=False)
class CubeScorer:
    """What has happened to the cube.

    Attributes:
        scene: where.
        turned: by how much about the vertical since the start [rad]; counter-clockwise from above
            is positive.
        flipped: another face has been up.
        settled: since when it has stood as it should [s].
        leaning: since when it has stood still and not flat [s].
        stuck: it has done so for long.
        gone: it has left the pedestal.
        done: it has stood as it should for long enough.
        last: (3, 3) its rotation at the last moment; None before the first.
    """

    scene: CubeScene
    turned: float = 0.0
    flipped: bool = False
    settled: float | None = None
    leaning: float | None = None
    stuck: bool = False
    gone: bool = False
    done: bool = False
    last: Float[np.ndarray, "3 3"] | None = None

    @property
    def standing(self) -> Standing:
        """See ``Scorer``."""
        if self.gone:
            return Standing(0.0, "dropped", "the cube fell", dropped=True)
        if self.done and self.flipped:
            return Standing(0.5, "flipped", "turned, but flipped onto another face", complete=True)
        if self.done:
            return Standing(1.0, "done", "turned by a right angle", complete=True)
        degrees = f"turned by {np.degrees(self.turned):.0f}°"
        if self.stuck:
            return Standing(0.0, NOT_DONE, f"{degrees}, leaning", stuck=True)
        return Standing(0.0, NOT_DONE, f"{degrees}, flipped" if self.flipped else degrees)

    def observe(self, state: SceneState) -> Self:
        """See ``Scorer``."""
        now = rotation(state.quaternion)
        start = rotation(self.scene.start[1])
        upright = float((now @ start.T)[2, 2])
        flipped = self.flipped or upright < _FLIPPED
        before = start if self.last is None else self.last
        turned = self.turned + _about_vertical(now @ before.T)
        if not flipped:  # then the heading is well defined, and nothing adds up
            turned += _wrapped(_heading(now @ start.T) - turned)
        lies = state.support > 0.0 and bool(np.abs(now[2]).max() > np.cos(FLAT))
        still = float(np.linalg.norm(state.spin)) < _STILL
        right = abs(abs(turned) - GOAL) <= TOLERANCE
        settled = held_since(self.settled, right and lies and still, state.time)
        leaning = held_since(self.leaning, still and not lies, state.time)
        return replace(
            self, turned=turned, flipped=flipped, settled=settled, leaning=leaning,
            stuck=lasted(leaning, state.time, _LEANING_S),
            gone=self.gone or outside(self.scene, state),
            done=self.done or lasted(settled, state.time), last=now,
        )  # fmt: skip


def _heading(turn: Float[np.ndarray, "3 3"]) -> float:
    """The part about the vertical of a rotation (its twist) [rad]."""
    return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))


def _about_vertical(turn: Float[np.ndarray, "3 3"]) -> float:
    """The vertical component of a small rotation's vector [rad]."""
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(skew)) / 2
    angle = float(np.arctan2(sine, (np.trace(turn) - 1) / 2))
    return 0.0 if sine < 1e-12 else angle * float(skew[2]) / (2 * sine)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
