"""Smooths commands across a gap: the robot holds, and then approaches the new target slowly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from smooth_operator import poses

_LEAST_S = 0.5
"""Shortest time of an approach to commands after a gap [s]."""

_JOINT_SPEED = 1.0
_WRIST_SPEED = 0.1
_WRIST_TURN = 1.0
"""Mean speeds of an approach: joints [rad/s], wrist [m/s] and [rad/s]."""


class Follower:
    """Values that follow a target without a jump after a gap.

    During a gap, the last values are held. Afterwards, their share fades out along a curve that
    starts and ends with speed zero, so the values stay between them and the target.
    """

    def __init__(self) -> None:
        self.values: np.ndarray | None = None
        """The last values; None before the first target."""
        self._from: tuple[np.ndarray, np.ndarray] | None = None
        """The held values and the first target of an approach."""
        self._held = False
        self._begin, self._duration = 0.0, _LEAST_S

    def hold(self) -> None:
        """Keeps the last values while there is no target."""
        self._held = self.values is not None

    def put(self, values: Sequence[float] | np.ndarray) -> None:
        """Sets the values that are held; the next target is approached from them."""
        self.values, self._held = np.asarray(values, np.float64), True

    def follow(self, target: Sequence[float], now: float) -> np.ndarray:
        """Computes the values for a target.

        Args:
            target: (n,) angles [rad].
            now: time [s].
        """
        wanted = np.asarray(target, np.float64)
        if self._held and self.values is not None:
            self._from = self.values, wanted
            self._begin, self._duration = now, self._time(self._difference(*self._from))
            self._held = False
        if self._from is not None:
            rest = _fading((now - self._begin) / self._duration)
            if rest == 0.0:
                self._from = None
            else:
                wanted = self._blended(wanted, *self._from, rest)
        self.values = wanted
        return wanted

    def _difference(self, held: np.ndarray, target: np.ndarray) -> np.ndarray:
        return np.asarray(held - target)

    def _blended(
        self, target: np.ndarray, held: np.ndarray, first: np.ndarray, share: float
    ) -> np.ndarray:
        return np.asarray(target + share * (held - target))

    def _time(self, offset: np.ndarray) -> float:
        return max(_LEAST_S, float(np.abs(offset).max(initial=0.0)) / _JOINT_SPEED)


class PoseFollower(Follower):
    """``Follower`` for poses: x y z [m], unit quaternion w x y z. Offsets are (6,): m and rad."""

    def _difference(self, held: np.ndarray, target: np.ndarray) -> np.ndarray:
        turn = poses.multiply(held[3:], poses.conjugate(target[3:]))
        return np.concatenate([held[:3] - target[:3], poses.rotation_vectors(turn)])

    def _blended(
        self, target: np.ndarray, held: np.ndarray, first: np.ndarray, share: float
    ) -> np.ndarray:
        # Half a turn from the held pose the shortest way flips, so the first difference fades out.
        offset = share * self._difference(held, first)
        turned = poses.multiply(poses.from_rotation_vectors(offset[3:]), target[3:])
        return np.concatenate([target[:3] + offset[:3], turned])

    def _time(self, offset: np.ndarray) -> float:
        distance, angle = np.linalg.norm(offset[:3]), np.linalg.norm(offset[3:])
        return max(_LEAST_S, float(distance) / _WRIST_SPEED, float(angle) / _WRIST_TURN)


def _fading(passed: float) -> float:
    """Smooth step from 1 (at 0 and below) to 0 (at 1 and above) with zero slope at both ends."""
    passed = min(max(passed, 0.0), 1.0)
    return 1.0 - passed * passed * (3.0 - 2.0 * passed)
