"""What the robot is sent when commands stop and come back: it holds, then goes over slowly."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

_LEAST_S = 0.5
"""Shortest time to go over to commands that came back [s]."""

_JOINT_SPEED = 1.0
_WRIST_SPEED = 0.1
_WRIST_TURN = 1.0
"""Mean speeds of going over: joints [rad/s], wrist [m/s] and [rad/s]."""


class Follower:
    """Values that follow a target without a jump after a gap.

    A gap is held. Then the difference between what was held and the target at that moment fades
    out, along a curve that starts and ends with speed zero.
    """

    def __init__(self) -> None:
        self.values: np.ndarray | None = None
        """What was returned last; None before the first target."""
        self._offset: np.ndarray | None = None
        self._held = False
        self._begin, self._duration = 0.0, _LEAST_S

    def hold(self) -> None:
        """No target: what was returned last stays."""
        self._held = self.values is not None

    def follow(self, target: Sequence[float], now: float) -> np.ndarray:
        """The values for a target.

        Args:
            target: (n,) angles [rad].
            now: time [s].
        """
        wanted = np.asarray(target, np.float64)
        if self._held and self.values is not None:
            self._offset = self._difference(self.values, wanted)
            self._begin, self._duration = now, self._time(self._offset)
            self._held = False
        if self._offset is not None:
            rest = _fading((now - self._begin) / self._duration)
            if rest == 0.0:
                self._offset = None
            else:
                wanted = self._shifted(wanted, self._offset, rest)
        self.values = wanted
        return wanted

    def _difference(self, held: np.ndarray, target: np.ndarray) -> np.ndarray:
        return np.asarray(held - target)

    def _shifted(self, target: np.ndarray, offset: np.ndarray, share: float) -> np.ndarray:
        return np.asarray(target + share * offset)

    def _time(self, offset: np.ndarray) -> float:
        return max(_LEAST_S, float(np.abs(offset).max(initial=0.0)) / _JOINT_SPEED)


class PoseFollower(Follower):
    """The same for a pose: x y z [m], unit quaternion w x y z."""

    def _difference(self, held: np.ndarray, target: np.ndarray) -> np.ndarray:
        conjugate = target[3:] * (1.0, -1.0, -1.0, -1.0)
        turn = product(held[3:], conjugate)
        return np.concatenate([held[:3] - target[:3], turn if turn[0] >= 0 else -turn])

    def _shifted(self, target: np.ndarray, offset: np.ndarray, share: float) -> np.ndarray:
        turned = product(_part(offset[3:], share), target[3:])
        return np.concatenate([target[:3] + share * offset[:3], turned])

    def _time(self, offset: np.ndarray) -> float:
        distance = float(np.linalg.norm(offset[:3]))
        angle = 2.0 * math.acos(min(1.0, abs(offset[3])))
        return max(_LEAST_S, distance / _WRIST_SPEED, angle / _WRIST_TURN)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product ``a b`` (w x y z)."""
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[scalar], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


def rotation_6d(quaternion: np.ndarray) -> np.ndarray:
    """First and second column of the rotation matrix of a unit quaternion (w x y z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y + w * z),
            2 * (x * z - w * y),
            2 * (x * y - w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z + w * x),
        ]
    )


def _part(turn: np.ndarray, share: float) -> np.ndarray:
    """A share of a rotation about the same axis."""
    sine = float(np.linalg.norm(turn[1:]))
    if sine < 1e-9:
        return np.array([1.0, 0.0, 0.0, 0.0])
    half = math.atan2(sine, turn[0]) * share
    return np.concatenate([[math.cos(half)], math.sin(half) / sine * turn[1:]])


def _fading(passed: float) -> float:
    """1 at 0 and before, 0 at 1 and after, with speed zero at both."""
    passed = min(max(passed, 0.0), 1.0)
    return 1.0 - passed * passed * (3.0 - 2.0 * passed)
