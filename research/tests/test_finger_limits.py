"""A finger that was straight follows the human's when that bends."""

import numpy as np
import pytest

from smooth_operator import HandRecording, Retargeter, load_hand
from smooth_operator.hands.finger_circles import bends_past_straight
from smooth_operator.landmarks import TIPS
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.smooth import frame_limits
from smooth_operator_research.demonstrations.demonstration import (
    DemonstrationLandmarks,
    load_demonstration,
)
from smooth_operator_research.demonstrations.perturbation import draw_perturbation


def test_fingers_are_found_where_a_joint_bends_them_past_straight():
    hand = load_hand("mimic_p050")
    fingers = bends_past_straight(hand)
    assert [hand.fingers[f] for f, *_ in fingers] == ["index", "middle", "ring", "pinky"]
    assert [hand.actuated_names[joint] for _, joint, *_ in fingers] == [
        f"{name}_pp2mp" for name in ("index", "middle", "ring", "pinky")
    ]
    for f, joint, longest, length, centre in fingers:
        for lengths, position in ((length, 0.0), (None, longest)):
            q = np.array(hand.neutral)
            q[joint] = position
            at = np.linalg.norm(hand.tips(hand.full_configuration(q))[f] - hand.wrist - centre)
            assert at == pytest.approx(length, abs=1e-6) if lengths else at > length + 1e-3
    for name in ("inspire_hand", "shadow_hand", "allegro_hand"):  # longest at the limit
        hand = load_hand(name)
        tips = hand.tips(hand.full_configuration(hand.neutral)) - hand.wrist
        assert frame_limits(hand, tips) is hand.limits


def test_only_a_fingertip_nearer_than_the_finger_at_its_limit_moves_the_limit():
    hand = load_hand("mimic_p050")
    fingers = bends_past_straight(hand)
    tips = hand.tips(hand.full_configuration(hand.neutral)) - hand.wrist
    f, joint, longest, length, centre = fingers[1]
    for away, low in ((length + 5e-4, 0.0), (length - 5e-4, 0.0), (length - 2e-3, longest)):
        tips[f] = centre + np.array([0.0, 0.0, away])
        found = np.asarray(frame_limits(hand, tips))
        assert found[joint, 0] == pytest.approx(low)
        others = np.arange(len(found)) != joint
        assert (found[others, 1] == hand.limits[others, 1].astype(np.float32)).all()


def test_both_joints_beyond_the_knuckle_count():
    hand = load_hand("leap_hand")
    fingers = bends_past_straight(hand)
    names = [(hand.fingers[f], hand.actuated_names[joint]) for f, joint, *_ in fingers]
    assert names == [
        (finger, str(joint))
        for finger, joint in (
            ("index", 2),
            ("index", 3),
            ("middle", 6),
            ("middle", 7),
            ("ring", 10),
            ("ring", 11),
        )
    ]
    tips = hand.tips(hand.full_configuration(hand.straight_pose.q)) - hand.wrist
    tips[1] = fingers[0].centre + np.array([0.0, 0.0, 0.1])  # a bent index finger
    low = np.asarray(frame_limits(hand, tips))[:, 0]
    joints = [joint for _, joint, *_ in fingers]
    assert (low[joints[:2]] > -0.03).all()
    assert (hand.limits[joints[:2], 0] < -0.3).all()
    assert (low[joints[2:]] == hand.limits[joints[2:], 0].astype(np.float32)).all()


@pytest.mark.weekly
def test_a_finger_stretched_too_far_is_not_left_straight():
    """An operator whose bones stretch the middle finger, which then bends."""
    demonstration = load_demonstration("screwdriver", "mimic_p050")
    hand, source = demonstration.robot, DemonstrationLandmarks(demonstration)
    operator = draw_perturbation(6).operator
    retargeter = Retargeter(hand, method="smooth", preset="precise")
    stamps = np.arange(0.0, 0.8, 0.02)
    shown = np.stack([operator(source.at(stamp)) for stamp in stamps])
    recording = HandRecording(shown, stamps, hand.spec.side)
    state, tips = retargeter.init(seed=0), []
    for frame in recording:
        state, result = retargeter.step(state, frame)
        tips.append(hand.tips(result.command.joint_positions) - hand.wrist)
    aligned = align_recording(recording, hand)
    asked = aligned[:, list(TIPS)] - aligned[:, :1]
    errors = np.linalg.norm(np.array(tips) - asked, axis=-1)
    assert errors[-10:].max() < 2e-3
