"""Computes commands for a robot hand's wrist joints from the operator's wrist.

A tracker measures the palm's orientation, not the angles of the wrist. Seen from the palm, the
direction of the forearm has two angles, flexion and deviation, and pronation, which turns forearm
and palm together, does not change it. The wrist joints are set so that the robot's palm sees its
forearm in the same direction. If the tracker does not measure the forearm, it is taken to point
along the palm at the reference, the moment at which the operator takes over, and to stay there.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.simulation.arms.arm import hand_directions
from smooth_operator.types import CommandTrajectory, HandRecording

_Vector: TypeAlias = tuple[float, float, float]
"""In the live loop, plain numbers are several times as fast as arrays of three."""

_FOREARM: Final = (1.0, 0.0, 0.0)
"""Forearm of a straight wrist, in the wrist frame of docs/reference/conventions.md."""
MOST_ALONG: Final = 0.9
"""Largest cosine between the forearm and the axis of a wrist joint; a joint above it pronates."""


class WristSolver:
    """Finds the wrist joint angles at which the forearm has a given direction relative to the palm.

    Args:
        hand: a robot hand with wrist joints.

    Attributes:
        neutral: (k,) neutral positions of the wrist joints [rad].
        limits: (k, 2) their limits [rad].

    Raises:
        HandModelError: the wrist joints can't be commanded, or one of them turns about the forearm.
    """

    def __init__(self, hand: Hand) -> None:
        whole, names = with_wrist_joints(hand), hand.spec.wrist_joints
        k = len(names)
        self.neutral, self.limits = whole.neutral[-k:], whole.limits[-k:]
        data = mujoco.MjData(hand.model)
        data.qpos[:] = whole.qpos(whole.full_configuration(whole.neutral))
        mujoco.mj_kinematics(hand.model, data)
        distal, _, palmar = hand_directions(hand)
        wrist = np.stack([distal, np.cross(-palmar, distal), -palmar])
        to_wrist = wrist @ data.body(hand.spec.palm).xmat.reshape(3, 3).T
        self._axes: list[_Vector] = [
            tuple((to_wrist @ data.joint(name).xaxis).tolist()) for name in names
        ]
        for name, axis in zip(names, self._axes, strict=True):
            if abs(axis[0]) > MOST_ALONG:
                raise HandModelError(
                    f"hand {hand.name!r}: the wrist joint {name!r} turns about the forearm, but "
                    "only joints that flex or deviate the wrist can follow the operator; remove "
                    "this joint from wrist_joints"
                )

    def angles(self, forearm: Float[np.ndarray, "3"]) -> Float[np.ndarray, " k"]:
        """Angles of the wrist joints relative to their neutral positions [rad].

        With one joint the direction is met as closely as that joint allows; with two exactly,
        by the second of the subproblems of Paden and Kahan (Murray, Li and Sastry, A Mathematical
        Introduction to Robotic Manipulation, section 3.3).

        Args:
            forearm: unit vector from elbow to wrist in the human's wrist frame; at 1 0 0 the
                angles are zero.
        """
        seen: _Vector = tuple(forearm.tolist())
        if len(self._axes) == 1:
            return np.array([_turn(self._axes[0], seen, _FOREARM)])
        first, second = self._axes
        between = _cross(first, second)
        s, size = _dot(first, second), _dot(between, between)
        along, across = first[0], _dot(seen, second)
        a, b = (along - s * across) / size, (across - s * along) / size
        left = (1.0 - a * a - b * b - 2.0 * a * b * s) / size
        c = math.copysign(math.sqrt(max(left, 0.0)), between[0])
        x, y, z = (a * u + b * v + c * w for u, v, w in zip(first, second, between, strict=True))
        met = (x, y, z)
        return np.array([_turn(first, met, _FOREARM), _turn(second, seen, met)])


def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _turn(axis: _Vector, a: _Vector, b: _Vector) -> float:
    """Angle about a unit axis that turns a closest to b [rad]."""
    sine = _dot(_cross(a, b), axis)
    return math.atan2(sine, _dot(a, b) - _dot(a, axis) * _dot(b, axis))


class WristFollower:
    """Computes targets of a hand's wrist joints from the operator's forearm or wrist poses.

    With poses only, the reference is taken at the first pose and again after ``release``: there,
    the target is where the joints are, so that nothing jumps.

    Args:
        hand: a robot hand with wrist joints.

    Attributes:
        solver: solver for the hand's wrist joints.
        target: (k,) last target [rad].
    """

    def __init__(self, hand: Hand) -> None:
        self.solver = WristSolver(hand)
        self.target: Float[np.ndarray, " k"] = self.solver.neutral
        self._forearm: Float[np.ndarray, "3"] | None = None  # in the tracker's world
        self._start = self.target
        self._world: object = None

    def release(self, positions: Float[np.ndarray, " k"]) -> None:
        """Forgets the reference, and holds the joints at their positions [rad]."""
        self.target, self._forearm = positions, None

    def follow(
        self,
        wrist: Float[np.ndarray, "7"] | None,
        forearm: Float[np.ndarray, "3"] | None = None,
        world: object = None,
    ) -> None:
        """Sets the target from a wrist pose; a pose that is not valid changes nothing.

        Args:
            wrist: pose of the human wrist; None if the tracker does not measure it.
            forearm: direction of the forearm, ``HandFrame.forearm``, which needs no reference; None
                if the tracker does not measure it.
            world: identity of the frame of the pose; another one takes a new reference.
        """
        if forearm is not None:
            length = math.hypot(*forearm.tolist())
            if math.isfinite(length) and length > 0.0:
                self._aim(self.solver.neutral, forearm / length)
            return
        if wrist is None or not poses.is_valid(wrist):
            return
        if self._forearm is None or world != self._world:
            self._forearm, self._start = poses.rotate(wrist[3:], np.array(_FOREARM)), self.target
            self._world = world
        self._aim(self._start, poses.rotate(poses.conjugate(wrist[3:]), self._forearm))

    def _aim(self, start: Float[np.ndarray, " k"], forearm: Float[np.ndarray, "3"]) -> None:
        self.target = np.clip(start + self.solver.angles(forearm), *self.solver.limits.T)


class PalmMotion:
    """Poses of a hand's palm, relative to the palm at rest, as its wrist joints move.

    Args:
        hand: the robot hand.
    """

    def __init__(self, hand: Hand) -> None:
        self._model, self._data = hand.model, mujoco.MjData(hand.model)
        self._joints = [int(hand.model.joint(name).qposadr[0]) for name in hand.spec.wrist_joints]
        self._palm = self._data.body(hand.spec.palm)
        self._rest = self._pose()

    def at(self, positions: Float[np.ndarray, " k"]) -> Float[np.ndarray, "7"]:
        """(7,) pose of the palm at (k,) wrist joint positions [rad]: x y z [m], quaternion w x y
        z."""
        self._data.qpos[self._joints] = positions
        return poses.relative(self._rest, self._pose())

    def _pose(self) -> Float[np.ndarray, "7"]:
        mujoco.mj_kinematics(self._model, self._data)
        return np.concatenate([self._palm.xpos, self._palm.xquat])


def add_wrist_commands(
    commands: CommandTrajectory, recording: HandRecording, hand: Hand
) -> CommandTrajectory:
    """Adds commands for a hand's wrist joints to the commands of its fingers.

    Without directions of the forearm, the first valid wrist of the recording is the reference, at
    the neutral positions. A frame without a valid wrist repeats the last position. The limits of
    velocity and acceleration are for a live run and do not apply here.

    Args:
        commands: commands of the fingers for the frames of the recording.
        recording: the human hand.
        hand: the robot hand.

    Returns:
        the commands with the wrist joints last; those of a hand without wrist joints are returned
        as they are.
    """
    if not hand.spec.wrist_joints:
        return commands
    follower = WristFollower(hand)
    positions = []
    for i in range(len(commands)):
        frame = recording[i]
        follower.follow(frame.T_world_wrist, frame.forearm)
        positions.append(follower.target)
    k = len(hand.spec.wrist_joints)
    return replace(
        commands,
        joint_names=(*commands.joint_names, *hand.spec.wrist_joints),
        joint_positions=np.concatenate(
            [commands.joint_positions, np.reshape(positions, (-1, k))], axis=1
        ),
    )
