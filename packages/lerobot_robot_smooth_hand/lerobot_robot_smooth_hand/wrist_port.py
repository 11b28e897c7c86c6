"""The wrist of one hand of the robot: its keys, and its limits on the way to the sinks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from smooth_operator import poses
from smooth_operator.teleop.runtime.pose_limiter import PoseLimiter
from smooth_operator.teleop.runtime.settings import WristConfig
from smooth_operator.teleop.sinks.tick import WristCommand

KINDS = {
    "none": (),
    "rotation_6d": ("x", "y", "z", "r1", "r2", "r3", "r4", "r5", "r6"),
    "quaternion": ("x", "y", "z", "qw", "qx", "qy", "qz"),
}
"""How the pose is written -> its keys after ``tcp.``."""


class WristPort:
    """Targets of a wrist, as actions, to commands within the limits of speed and acceleration.

    Args:
        kind: one of ``KINDS``.
        prefix: of the keys.
    """

    def __init__(self, kind: str, prefix: str) -> None:
        self.kind = kind
        self.keys = tuple(f"{prefix}tcp.{name}" for name in KINDS[kind])
        # The workspace is the arm's, which this does not know.
        self._limiter = PoseLimiter(WristConfig(low=(-10.0,) * 3, high=(10.0,) * 3))
        self._begun = False

    def step(self, action: Mapping[str, float], dt: float) -> WristCommand | None:
        """The next command; None without a wrist. The first one is the action itself.

        Raises:
            ValueError: the action's rotation is none.
        """
        if not self.keys:
            return None
        target = self._pose(np.array([float(action[key]) for key in self.keys]))
        if not self._begun:
            self._limiter.put(target)
            self._begun = True
        return WristCommand(self._limiter.step(target, dt), engaged=True, valid=True)

    def values(self, command: WristCommand | None) -> dict[str, float]:
        """A command by its keys."""
        if command is None:
            return {}
        turn = command.pose[3:]
        if self.kind == "rotation_6d":
            turn = poses.rotation_matrices(turn)[:, :2].T.reshape(-1)
        numbers = np.concatenate([command.pose[:3], turn]).tolist()
        return dict(zip(self.keys, numbers, strict=True))

    def _pose(self, values: np.ndarray) -> np.ndarray:
        """x y z [m] and unit quaternion w x y z, from what a policy gives: nearly a rotation."""
        if self.kind == "quaternion":
            length = np.linalg.norm(values[3:])
            if not 0.1 < length < 10.0:
                raise ValueError(f"the action's quaternion is none: {values[3:].tolist()}")
            turn = values[3:] / length
        else:
            x, second = values[3:6], values[6:]
            length = np.linalg.norm(x)
            x = x / length if length > 0.1 else np.zeros(3)
            y = second - (x @ second) * x
            across = np.linalg.norm(y)
            if length <= 0.1 or across <= 0.1:
                raise ValueError(f"the action's rotation is none: {values[3:].tolist()}")
            y = y / across
            turn = poses.quaternions(np.stack([x, y, np.cross(x, y)], axis=-1))
        return np.concatenate([values[:3], turn])
