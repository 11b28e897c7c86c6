"""The wrist of one hand of the robot: its keys, its limits, and the arm that carries it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from lerobot.utils.errors import DeviceNotConnectedError

from smooth_operator import poses
from smooth_operator.episode_files.lerobot.schema import (
    WRIST_NAMES,
    joint_keys,
    pose_keys,
    wrist_pose,
)
from smooth_operator.teleop.runtime.limiter import PoseLimiter
from smooth_operator.teleop.runtime.settings import WristConfig
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import ArmCommand, WristCommand
from smooth_operator.types import Side

if TYPE_CHECKING:  # which needs the extra arm
    from smooth_operator.teleop.arm.controller import ArmController

_APPROACH = 0.05
_FASTER = 0.3
"""Share of the velocity limits at which an approach begins, and its increase per second."""

_NEAR_M = 0.005
_NEAR_RAD = 0.02
"""Distance from the action at which an approach ends [m, rad]."""


class WristPort:
    """Converts actions for a wrist to commands within limits of speed and acceleration.

    Args:
        kind: one of ``WRIST_NAMES``.
        prefix: prefix of the keys.
        side: side of the hand.
        arm: controller of the arm that carries the hand; None if the sinks take the wrist's pose.
        factor: number of units of the keys per radian.

    Attributes:
        keys: keys of the wrist.
        arm_keys: keys of the arm's joints, which are observed.
    """

    def __init__(
        self, kind: str, prefix: str, side: Side, arm: ArmController | None, factor: float
    ) -> None:
        self.kind, self.side, self._arm, self._factor = kind, side, arm, factor
        self.keys = tuple(f"{prefix}{key}" for key in pose_keys(WRIST_NAMES[kind]))
        names = () if arm is None else arm.arm.joint_names
        self.arm_keys = joint_keys([f"{prefix}arm_{name}" for name in names])
        # The workspace is the arm's: its controller keeps it, or who is behind the sinks.
        self._limiter = PoseLimiter(WristConfig(low=(-10.0,) * 3, high=(10.0,) * 3))
        self._begun = False
        self._slow_since = -math.inf

    @property
    def observed(self) -> tuple[str, ...]:
        """Keys of the measured values: the arm's joints and the wrist; empty without an arm."""
        return () if self._arm is None else (*self.arm_keys, *self.keys)

    def attach(self, sinks: Sequence[Sink]) -> None:
        """Start from the measured pose of the arm.

        Raises:
            DeviceNotConnectedError: no sink moves the arm.
        """
        if self._arm is None:
            return
        joints, pose = self._measured(sinks)
        self._arm.restart(joints)
        self._limiter.put(pose)
        self._begun = True

    def approach(self, now: float) -> None:
        """Approach the actions slowly from a time on [s], from rest, until one is reached."""
        self._slow_since = now
        self._limiter.put(self._limiter.pose)
        if self._arm is not None:
            self._arm.restart(self._arm.limiter.q)

    def step(
        self, action: Mapping[str, float], now: float, dt: float, hand: np.ndarray
    ) -> tuple[WristCommand | None, ArmCommand | None]:
        """Compute the next wrist and arm commands; each is None if there is no wrist or no arm.

        Without a measured arm, the first wrist command is the action itself.

        Args:
            action: action that contains the keys of the wrist.
            now: time [s].
            dt: time since the last step [s].
            hand: (n,) positions of all joints of the hand [rad].

        Raises:
            ValueError: the action's rotation is not a rotation.
        """
        if not self.keys:
            return None, None
        target = wrist_pose([action[key] for key in self.keys])
        if not self._begun:
            self._limiter.put(target)
            self._begun = True
        share = min(1.0, _APPROACH + _FASTER * (now - self._slow_since))
        pose = self._limiter.step(target, dt, share=share)
        distance, angle = poses.separation(pose, target)
        if distance < _NEAR_M and angle < _NEAR_RAD:
            self._slow_since = -math.inf
        wrist = WristCommand(pose, engaged=True, valid=True)
        return wrist, None if self._arm is None else self._arm.step(wrist.pose, dt, hand)

    def values(self, command: WristCommand | None) -> dict[str, float]:
        """Values of a command by their keys."""
        return {} if command is None else self._values(command.pose)

    def observation(self, sinks: Sequence[Sink]) -> dict[str, float]:
        """Measured arm joints and wrist pose; empty without an arm.

        Raises:
            DeviceNotConnectedError: no sink measures them.
        """
        if self._arm is None:
            return {}
        joints, pose = self._measured(sinks)
        values = dict(zip(self.arm_keys, (self._factor * joints).tolist(), strict=True))
        return values | self._values(pose)

    def _measured(self, sinks: Sequence[Sink]) -> tuple[np.ndarray, np.ndarray]:
        for sink in sinks:
            joints, pose = sink.measured_arm(self.side), sink.measured_wrist(self.side)
            if joints is not None and pose is not None:
                return joints, pose
        raise DeviceNotConnectedError(
            f"none of the sinks {', '.join(sink.label for sink in sinks)} moves the arm of the "
            f"{self.side} hand; name mujoco in --robot.sinks"
        )

    def _values(self, pose: np.ndarray) -> dict[str, float]:
        turn = pose[3:]
        if self.kind == "rotation_6d":
            turn = poses.rotation_matrices(turn)[:, :2].T.reshape(-1)
        return dict(zip(self.keys, np.concatenate([pose[:3], turn]).tolist(), strict=True))
