"""From human joint angles to a robot's joints: a table, given by the hand or measured on it.

A row says how one joint follows: position = offset + sum of gain x angle. Rows that a hand's
description does not give are measured: the robot's own counterparts of the human landmarks are put
through the same angles as a human hand (``joint_angles``),
so that equal angles come from equal poses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from smooth_operator.baselines.joint_angles import JOINT_ANGLES, joint_angles
from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.spec import JointMap
from smooth_operator.human.anatomical_axes import PalmAxes
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, NUM_LANDMARKS

_POSES = 128  # over which the effect of a joint on the angles is taken, by its median
_STEP = 1e-5  # [share of a joint's range]
_UNSEEN = 0.05  # singular values below this share of the first are no motion that angles show
_SLIGHT = 0.1  # gains below this share of a row's greatest are left out


def joint_map(hand: Hand) -> tuple[JointMap, ...]:
    """A row for every actuated joint, in their order.

    Rows in the hand's description are taken as they are. The others are derived: the effect of each
    joint on each angle, as a median over poses all through the joints' ranges, makes a matrix, and
    its pseudo-inverse the gains. A joint that alone moves one angle takes that angle; joints that
    move the same ones, as at a thumb's base, share them; a joint that bends two phalanges takes the
    least squares of both (half of each, where it bends both alike), so that the finger's curl as
    a whole is the human's. Following the nearer phalanx alone measured a thumb cosine up to 0.03
    higher, but moved less like the human: on a glove's first 500 frames a velocity correlation of
    0.88 instead of 0.92 and a flatness of 1.24e-5 instead of 0.99e-5 m^2. The offset makes the
    neutral pose answer its own angles. A joint that moves no angle stays at neutral.

    Raises:
        HandModelError: if a joint without a row moves a finger without all four landmarks.
        UnknownNameError: if a row names a joint or an angle that is not there.
    """
    rows = {row.joint: row for row in hand.spec.joint_map}
    for name, row in rows.items():
        if name not in hand.actuated_names:
            raise UnknownNameError("actuated joint", name, hand.actuated_names)
        for angle in row.gains:
            if angle not in JOINT_ANGLES:
                raise UnknownNameError("joint angle", angle, JOINT_ANGLES)
    _check_landmarks(hand, set(rows))
    if len(rows) == len(hand.actuated_names):
        return tuple(rows[name] for name in hand.actuated_names)
    gains, offsets = _derived(hand)
    return tuple(
        rows.get(name)
        or JointMap(
            name,
            offset=round(float(offset), 4),
            gains={a: round(float(g), 4) for a, g in zip(JOINT_ANGLES, row, strict=True) if g},
        )
        for name, offset, row in zip(hand.actuated_names, offsets, gains, strict=True)
    )


def robot_joint_angles(
    hand: Hand, q: Float[np.ndarray, "*batch m"], axes: PalmAxes[np.ndarray]
) -> Float[np.ndarray, "*batch 20"]:
    """The angles of a robot hand, measured as a human's.

    Args:
        hand: the robot hand.
        q: (..., m) actuated joint positions [rad].
        axes: of the palm, from ``human_palm_axes``.

    Returns:
        (..., 20) [rad], NaN for fingers whose four landmarks are not all known.
    """
    landmarks = np.full((*q.shape[:-1], NUM_LANDMARKS, 3), np.nan)
    landmarks[..., [LANDMARKS.index(n) for n in hand.tree.names], :] = hand.landmark_positions(q)
    return joint_angles(landmarks, axes)


def map_matrix(
    rows: Sequence[JointMap],
) -> tuple[Float[np.ndarray, "m 20"], Float[np.ndarray, " m"]]:
    """The table as gains and offsets."""
    gains = [[row.gains.get(angle, 0.0) for angle in JOINT_ANGLES] for row in rows]
    return np.array(gains), np.array([row.offset for row in rows])


def format_map(rows: Sequence[JointMap]) -> str:
    """The table as text, a line a joint: ``index_pp2mp = 0.35 + 0.49 index_pip + 0.51 index_dip``,
    in radians."""
    width = max(len(row.joint) for row in rows)
    lines = []
    for row in rows:
        terms = "".join(f" {'-' if g < 0 else '+'} {abs(g):.2f} {a}" for a, g in row.gains.items())
        lines.append(f"{row.joint:<{width}} = {row.offset:+.3f}{terms}")
    return "\n".join(lines)


def _derived(hand: Hand) -> tuple[Float[np.ndarray, "m 20"], Float[np.ndarray, " m"]]:
    """Gains and offsets, measured."""
    axes, (low, high) = human_palm_axes(hand), hand.limits.T
    half = (high - low) / 2  # in half ranges a slide [m] and a hinge [rad] are alike
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    steps = _STEP * np.diag(half)[:, None]
    turns = robot_joint_angles(hand, poses + steps, axes) - robot_joint_angles(
        hand, poses - steps, axes
    )
    turns -= 2 * np.pi * np.round(turns / (2 * np.pi))
    effect = np.median(turns, axis=1) / (2 * _STEP)
    effect = np.nan_to_num(effect)  # of fingers without landmarks, whose joints have rows
    gains = half[:, None] * np.linalg.pinv(effect.T, rcond=_UNSEEN)
    greatest = np.abs(gains).max(axis=1, keepdims=True)
    gains = np.where(np.abs(gains) > _SLIGHT * greatest, gains, 0.0)
    at_neutral = np.nan_to_num(robot_joint_angles(hand, hand.neutral, axes))
    return gains, hand.neutral - gains @ at_neutral


def _check_landmarks(hand: Hand, joints_mapped: set[str]) -> None:
    lacking = {
        finger.name: [
            LANDMARKS[BASES[FINGERS.index(finger.name)] + i]
            for i, point in enumerate(finger.points)
            if point is None
        ]
        for finger in hand.spec.fingers
    }
    for finger, points in lacking.items():
        joints = [name for name in _joints_of(hand, finger) if name not in joints_mapped]
        if points and joints:
            raise HandModelError(
                f"hand {hand.name!r}: joint angles of the {finger} can't be measured without the "
                f"points {points}, so there is no map to its joints {joints}; give the finger all "
                "four points in its description, or a JointMap row for each of these joints in "
                "HandSpec.joint_map"
            )


def _joints_of(hand: Hand, finger: str) -> list[str]:
    """Actuated joints that move some landmark of a finger."""
    moving: set[int] = set()
    for i in range(4):
        keypoint = hand.tree.keypoints.get(LANDMARKS[BASES[FINGERS.index(finger)] + i])
        joint = -1 if keypoint is None else keypoint.joint
        while joint >= 0:
            moving.add(hand.tree.joints[joint].source)
            joint = hand.tree.joints[joint].parent
    drives = np.abs(hand.coupling_matrix[sorted(moving)]).sum(axis=0) > 0
    return [name for name, drive in zip(hand.actuated_names, drives, strict=True) if drive]
