"""Measure 1 of ``bench --physics``: what is exact comes out exact, and a delay is a lag."""

from functools import cache

import numpy as np
import pytest

from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, TIPS, WRIST
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.synthetic.tracker import TRACKERS
from smooth_operator_research.physics.reachable_motion import (
    KNOT_S,
    PINCH_GAP,
    TOUCH,
    AskedMotion,
    joint_motion,
    lag_frames,
    motion_figures,
    reachable_motion,
)

pytestmark = pytest.mark.weekly


@cache
def asked_of_mimic() -> AskedMotion:
    return reachable_motion(load_hand("mimic_p050", "right"), 0, duration=4.0)


HANDS = ("mimic_p050", "leap_hand", "inspire_hand", "shadow_dexee")


@pytest.mark.parametrize("name", HANDS)
def test_a_motion_keeps_the_limits_and_does_not_collide(name):
    hand = load_hand(name, "right")
    motion = joint_motion(hand, 3, duration=2.0)
    low, high = hand.limits.T
    assert len(motion.joints) == 200
    assert (motion.joints >= low - 1e-9).all()
    assert (motion.joints <= high + 1e-9).all()
    np.testing.assert_allclose(motion.joints[0], hand.neutral, atol=1e-12)
    depths = penetration_depths(hand, hand.full_configuration(motion.joints))
    assert depths.max() <= TOUCH
    # Twice differentiable: the acceleration changes by a bounded jerk from frame to frame.
    span = float((high - low).max())
    assert motion.peak_speed < 1.01 * span / KNOT_S
    jumps = np.abs(np.diff(motion.joints, n=3, axis=0)).max()
    assert jumps < 16 * span * (0.01 / KNOT_S) ** 3


def test_a_motion_has_pinches_and_follows_from_its_seed():
    hand, asked = load_hand("mimic_p050", "right"), asked_of_mimic()
    gaps = np.linalg.norm(asked.tips[:, 1:] - asked.tips[:, :1], axis=-1)
    assert (gaps.min(axis=1) < PINCH_GAP).mean() > 0.05
    assert asked.motion.pinches >= 1
    again = reachable_motion(hand, 0, duration=4.0)
    np.testing.assert_array_equal(asked.recording.landmarks, again.recording.landmarks)
    other = reachable_motion(hand, 1, duration=1.0)
    assert np.abs(asked.joints[:100] - other.joints).max() > 0.1


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("side", ["right", "left"])
def test_alignment_leaves_the_landmarks_where_they_are(name, side):
    hand = load_hand(name, side)
    asked = reachable_motion(hand, 1, duration=0.8)
    aligned = align_recording(asked.recording, hand)
    np.testing.assert_allclose(aligned, asked.recording.landmarks, atol=1e-12)


def test_a_trackers_shake_moves_fingertips_and_leaves_the_palm():
    hand = load_hand("mimic_p050", "right")
    clean, noisy = (reachable_motion(hand, 1, duration=8.0, tracker=t) for t in (None, "camera"))
    np.testing.assert_array_equal(clean.joints, noisy.joints)
    moved = noisy.recording.landmarks - clean.recording.landmarks
    assert moved[:, TIPS].std() == pytest.approx(TRACKERS["camera"].shake, rel=0.1)
    assert np.abs(moved[:, [WRIST, *BASES]]).max() == 0.0
    aligned = align_recording(noisy.recording, hand) - clean.recording.landmarks
    np.testing.assert_allclose(aligned, moved, atol=1e-9)


def test_true_joints_are_exact():
    hand, asked = load_hand("mimic_p050", "right"), asked_of_mimic()
    row = motion_figures(hand, asked, asked.joints)
    assert row["tip_error_mm"] == row["tip_p95_mm"] == row["lag_ms"] == row["common_shift_mm"] == 0
    assert row["pinch_gap_error_mm"] in (0, None)
    assert row["exact"] == 1


def test_a_delay_of_three_frames_is_a_lag_of_30_ms():
    hand, asked = load_hand("mimic_p050", "right"), asked_of_mimic()
    late = np.concatenate([np.repeat(asked.joints[:1], 3, axis=0), asked.joints[:-3]])
    row = motion_figures(hand, asked, late)
    assert row["lag_ms"] == pytest.approx(30.0, abs=1e-9)
    assert 0.5 < row["tip_error_mm"] < row["tip_p95_mm"]
    assert 0 < row["common_shift_mm"] < row["tip_error_mm"]
    assert row["exact"] < 0.5


def test_the_fraction_of_a_frame_is_found():
    time = np.arange(400) / 100
    points = np.stack([np.sin(3 * time), np.cos(2 * time), 0 * time], axis=-1)[:, None]
    late = time - 0.0125
    given = np.stack([np.sin(3 * late), np.cos(2 * late), 0 * late], axis=-1)[:, None]
    assert lag_frames(points, given) == pytest.approx(1.25, abs=0.01)
