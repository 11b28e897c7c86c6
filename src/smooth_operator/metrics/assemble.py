"""Builds the input of the metrics from a recording and its commands."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.hands.wrist_joints import has_joints
from smooth_operator.landmarks import LANDMARKS, NUM_LANDMARKS
from smooth_operator.metrics.pinches import pinched_frames
from smooth_operator.metrics.trace import Trace
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.types import CommandTrajectory, HandRecording

REACH_SAMPLES: Final = 100_000
"""Number of random poses that represent the reach of a fingertip, as in the paper's metrics."""


def assemble_trace(
    recording: HandRecording,
    commands: CommandTrajectory,
    hand: Hand,
    alignment: AlignmentConfig | None = None,
    *,
    reach_samples: int = REACH_SAMPLES,
) -> Trace:
    """Collects the data of a run, with both hands transformed to the robot's palm frame.

    Args:
        recording: the human hand, T frames.
        commands: the T commands for these frames; wrist joints are left out.
        hand: the robot hand of the commands.
        alignment: the alignment of the method, so that the human hand is measured as the method
            used it; None for the default, which estimates a scale in each frame.
        reach_samples: number of random poses for workspace utilisation; 0 skips this metric.

    Returns:
        The trace, with all inputs of ``evaluate``. ``penetration`` is None if the hand's model has
        no shapes that can touch.

    Raises:
        RecordingError: if commands and frames are not paired one to one by their stamps, or the
            commands are for other joints.
    """
    if not np.array_equal(recording.stamps, commands.stamps):
        raise RecordingError(
            f"{recording.name}: the {len(recording)} frames are not those of the "
            f"{len(commands)} commands; their timestamps differ"
        )
    if not has_joints(hand, commands.joint_names):
        raise RecordingError(
            f"{recording.name}: the commands are for the joints {commands.joint_names}, not those "
            f"of the hand {hand.name!r}, {hand.joint_names}"
        )
    q = np.asarray(commands.joint_positions, np.float64)[:, : len(hand.joint_names)]
    points = np.asarray(hand.tree.positions(q))
    landmarks = np.full((len(q), NUM_LANDMARKS, 3), np.nan)
    landmarks[:, [LANDMARKS.index(name) for name in hand.tree.names]] = points
    human = align_recording(recording, hand, alignment or AlignmentConfig())
    pinched = pinched_frames(human[:, [LANDMARKS.index(name) for name in hand.tip_names]])
    return Trace(
        human=human,
        robot_tips=points[:, [hand.tree.names.index(name) for name in hand.tip_names]],
        robot_wrist=hand.wrist,
        fingers=hand.fingers,
        joint_positions=q,
        joint_limits=hand.joint_limits,
        stamps=commands.stamps,
        status=commands.status,
        latency_ms=commands.latency_ms,
        reach=sample_reach(hand, reach_samples) if reach_samples else None,
        penetration=penetration_depths(hand, q),
        robot_landmarks=landmarks,
        palm_landmarks=hand.align_indices,
        straight_lengths=hand.straight_pose.reach,
        pinch_distances=tip_surface_distances(hand, q, pinched),
    )


def sample_reach(
    hand: Hand, samples: int = REACH_SAMPLES, seed: int = 0
) -> Float[np.ndarray, "S F 3"]:
    """(S, F, 3) fingertips of random poses in the palm frame [m], thumb first, uniform over the
    limits of the actuated joints."""
    low, high = hand.limits.T
    q = np.random.default_rng(seed).uniform(low, high, (samples, len(low)))
    columns = list(np.ascontiguousarray(hand.full_configuration(q).T))
    reach = np.empty((samples, len(hand.tip_names), 3))
    for finger, point in enumerate(hand.tree.forward_kinematics(columns, hand.tip_names)):
        for axis, values in enumerate(point):
            reach[:, finger, axis] = values  # a coordinate that no joint moves is one number
    return reach
