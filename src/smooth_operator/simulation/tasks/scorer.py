"""What scorers have in common: they read a scene, moment by moment, and remember what counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol, Self

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.scene import Scene
from smooth_operator.simulation.scenes.state import SceneState

HOLD_S: Final = 0.5
"""How long a goal must be met [s]."""

NOT_DONE: Final = "not-done"
"""Line of every rubric for a trial that ended with nothing."""

PRESSES_N: Final = 0.02
"""A finger that presses this hard touches [N]."""


@dataclass(frozen=True)
class Standing:
    """How a trial stands.

    Attributes:
        score: what it would be worth if it ended now, reset or not: 0, 0.5 or 1.
        line: of the task's rubric, by which.
        reason: why, in a few words.
        complete: the goal is met; the trial ends.
        dropped: the object is lost; the trial ends.
        stuck: only a reset helps now.
    """

    score: float
    line: str
    reason: str
    complete: bool = False
    dropped: bool = False
    stuck: bool = False


class Scorer(Protocol):
    """A rubric in numbers; a value that is replaced, never changed."""

    @property
    def standing(self) -> Standing:
        """How the trial stands."""

    def observe(self, state: SceneState) -> Self:
        """The scorer after one more moment, later than the last."""


def held_since(since: float | None, meets: bool, time: float) -> float | None:
    """When a condition began to hold without a break; None if it does not."""
    if not meets:
        return None
    return time if since is None else since


def lasted(since: float | None, time: float, seconds: float = HOLD_S) -> bool:
    """Whether a condition that began at ``since`` has held for so long."""
    return since is not None and time - since >= seconds - 1e-9


def outside(scene: Scene, state: SceneState) -> bool:
    """Whether the object has left the workspace."""
    return bool(np.any(state.position < scene.lower) or np.any(state.position > scene.upper))


def rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """(3, 3) of a unit quaternion w x y z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
