"""A demonstration as a human hand would show it: the robot's own landmarks."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator_research.demonstrations.demonstration import PERIOD_S, Demonstration

_STEP_S: Final = 0.001  # between two computed frames


class DemonstrationLandmarks:
    """A perfect operator with the robot's geometry, who performs a demonstration without looking.

    The frame of a time is that of the pose one period later, since a command is where the joints
    are to be at the end of its period. Before the start and after the end the hand is still. A
    ``LandmarkSource``.

    Args:
        demonstration: what is done.

    Attributes:
        seconds: when it is at its end [s].
    """

    def __init__(self, demonstration: Demonstration) -> None:
        hand = demonstration.robot
        self.seconds = float(demonstration.times[-1])
        count = int(np.ceil(self.seconds / _STEP_S)) + 1
        poses = np.stack([demonstration.pose(k * _STEP_S) for k in range(count)])
        self._frames = human_landmarks(hand, poses)

    def at(self, time: float) -> Float[np.ndarray, "21 3"]:
        """(21, 3) landmarks of a time since 'go' [m], in the robot's palm frame."""
        k = round((time + PERIOD_S) / _STEP_S)
        return np.asarray(self._frames[int(np.clip(k, 0, len(self._frames) - 1))])

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"]:
        """See ``LandmarkSource``; the scene is not looked at."""
        return self.at(time)
