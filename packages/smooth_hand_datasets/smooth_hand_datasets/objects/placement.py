"""Places human hands, robot palms and objects in one world frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    reference_landmarks,
)
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.types import HandRecording

SAME_M = 0.01
"""Distance between wrist landmark and wrist pose below which landmarks are in the world frame
[m]."""


def landmarks_in_world(recording: HandRecording) -> Float[np.ndarray, "T 21 3"]:
    """Converts the landmarks of a hand to the world frame of its wrist poses.

    A tracker may give landmarks in its own frame. They are then transformed so that the wrist
    frame that the palm's landmarks define coincides with the wrist's pose.

    Args:
        recording: a recording with ``T_world_wrist``.

    Returns:
        (T, 21, 3) [m], NaN where a landmark or the wrist is unknown.

    Raises:
        RecordingError: the recording has no poses of the wrist.
    """
    wrist = recording.T_world_wrist
    if wrist is None:
        raise RecordingError(
            f"{recording.name}: objects need the wrist's pose in the world, but this recording has "
            "only landmarks: use a layout with wrist poses"
        )
    assert recording.valid is not None  # filled in on construction
    points = np.where(recording.valid[..., None], recording.landmarks, np.nan)
    off = np.linalg.norm(points[:, 0] - wrist[:, :3], axis=-1)
    if np.isfinite(off).any() and np.nanmedian(off) < SAME_M:
        return np.where(np.isfinite(wrist[:, :1, None]), points, np.nan)
    own = poses.wrist_from_landmarks(points, recording.side)
    moved = poses.compose(wrist, poses.invert(own))
    return apply(moved, points)


def palm_in_world(
    recording: HandRecording, hand: Hand, alignment: AlignmentConfig
) -> Float[np.ndarray, "T 7"]:
    """Places the robot's palm at the human's.

    The rotation is that of the alignment that retargeting uses. Robot and human keep their sizes,
    and the centres of the landmarks that are aligned coincide.

    Args:
        recording: the human hand, with ``T_world_wrist``.
        hand: the robot hand.
        alignment: the alignment of the method.

    Returns:
        (T, 7) ``T_world_palm``; NaN where the palm is unknown.
    """
    points = landmarks_in_world(recording)
    chosen = list(hand.align_indices)
    usable = np.isfinite(points[:, chosen]).all(axis=(1, 2))
    safe = np.where(usable[:, None, None], points, reference_landmarks(hand))
    fit = palm_alignment(safe, hand, alignment)
    usable &= np.asarray(fit.condition) >= MIN_CONDITION
    turn = np.swapaxes(np.asarray(fit.rotation), -1, -2)  # palm to world
    centre = safe[:, chosen].mean(axis=1)
    place = centre - np.einsum("tij,j->ti", turn, hand.align_points.mean(axis=0))
    placed = np.concatenate([place, poses.quaternions(turn)], axis=-1)
    return np.where(usable[:, None], placed, np.nan)


def wrist_in_palm(hand: Hand) -> Float[np.ndarray, "7"]:
    """``T_palm_wrist`` of a robot hand, with the same wrist axes as for every tracker's wrist.

    The axes are computed from the robot's own landmarks in its neutral pose
    (docs/reference/conventions.md).
    """
    landmarks = human_landmarks(hand, hand.neutral[None])[0]
    return poses.wrist_from_landmarks(landmarks, hand.spec.side)


def apply(
    transform: Float[np.ndarray, "T 7"], points: Float[np.ndarray, "T n 3"]
) -> Float[np.ndarray, "T n 3"]:
    """Transforms the points of each frame by its pose."""
    moved: np.ndarray = poses.rotate(transform[:, None, 3:], points) + transform[:, None, :3]
    return moved
