"""Directions of the human palm (distal, radial, palmar) in a robot's palm frame."""

from __future__ import annotations

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import palm_alignment
from smooth_operator.human.anatomy import NUM_JOINTS, draw_anatomy
from smooth_operator.human.joint_angles import PalmAxes, palm_axes
from smooth_operator.human.kinematics import mirror, pose_hand


def human_palm_axes(hand: Hand) -> PalmAxes[np.ndarray]:
    """Where a human palm comes to lie in the robot's palm frame when it is aligned to it.

    A robot's own wrist and knuckles seldom span a palm as a human's do (of the mimic hand the wrist
    lies 3 cm in front of the knuckles' plane), so the directions are those of the built-in
    operator's hand, aligned as every frame is.
    """
    poses = pose_hand(draw_anatomy(0.19, 0), np.zeros((1, NUM_JOINTS)))
    poses = poses if hand.spec.side == "right" else mirror(poses)
    landmarks = poses.landmarks[0]
    return palm_axes(palm_alignment(landmarks, hand).apply(landmarks), hand.spec.side)
