"""Metrics follow the fingers that a hand has: three, four, and others than the first."""

import numpy as np
import pytest
from metrics_cases import WRIST, human_motion, make_trace

from smooth_operator import Hand, HandRecording, assemble_trace, load_hand
from smooth_operator.landmarks import FINGERS, LANDMARKS, NUM_LANDMARKS, TIPS
from smooth_operator.metrics import Trace, evaluate
from smooth_operator.metrics.pinches import pinched_frames
from smooth_operator.types import CommandTrajectory

THREE = ("thumb", "index", "middle")
FOUR = ("thumb", "index", "middle", "ring")
CHOICES = [THREE, FOUR, ("thumb", "middle", "pinky")]
FRAMES = 50


@pytest.mark.parametrize("fingers", CHOICES)
@pytest.mark.parametrize("definition", ["sound", "paper"])
def test_fingers_that_the_robot_lacks_do_not_count(fingers, definition):
    human = human_motion(60)
    tips = human[:, [TIPS[FINGERS.index(f)] for f in fingers]] + 0.003
    wild = human.copy()
    for finger in set(FINGERS) - set(fingers):
        last = TIPS[FINGERS.index(finger)]
        wild[:, last - 3 : last + 1] = np.nan
    results = [evaluate(make_trace(h, tips, fingers), definition) for h in (human, wild)]
    assert results[0] == results[1]
    assert results[1]["cosine_similarity_all"] is not None


@pytest.mark.parametrize("fingers", CHOICES)
def test_means_are_over_the_vectors_that_there_are(fingers):
    human, count = human_motion(30), len(fingers)
    tips = human[:, [TIPS[FINGERS.index(f)] for f in fingers]]
    tips[:, -1] = 2 * tips[:, 0] - tips[:, -1]  # the last finger on the thumb's other side
    result = evaluate(make_trace(human, tips, fingers))
    # F - 1 vectors from the thumb, of which one is turned round, at its full length
    assert result["cosine_similarity"] == pytest.approx((count - 3) / (count - 1))
    assert result["scale_ratio"] == pytest.approx(1)


def test_a_missing_fingertip_costs_only_its_own_vectors():
    human = human_motion(60)
    tips = human[:, list(TIPS)].copy()
    human[:, TIPS[4]] = np.nan
    tips[:, 4] += 0.1  # wrong, but there is nothing to compare it with
    assert evaluate(make_trace(human, tips))["cosine_similarity_all"] == pytest.approx(1)


def test_a_pinch_of_a_finger_that_the_robot_lacks_is_none_of_its():
    human = human_motion(20)
    human[:, TIPS[0]] = WRIST + 0.06
    for k, tip in enumerate(TIPS[1:], 1):
        human[:, tip] = WRIST - 0.05 * k
    human[:10, TIPS[3]] = human[:10, TIPS[0]] + (0.005, 0, 0)  # thumb and ring
    human[10:, TIPS[1]] = human[10:, TIPS[0]] + (0.005, 0, 0)  # thumb and index
    three, four = (pinched_frames(make_trace(human, fingers=f).human_tips) for f in (THREE, FOUR))
    np.testing.assert_array_equal(three.sum(axis=0), (10, 0))
    np.testing.assert_array_equal(four.sum(axis=0), (10, 0, 10))


def played_back(hand: Hand, off: float = 0.0) -> Trace:
    """A human whose landmarks are the robot's own, without those that the robot lacks; the last
    actuated joint of the robot is ``off`` [rad] from where it should be."""
    low, high = hand.limits.T
    rng = np.random.default_rng(0)
    rate, phase = rng.uniform(0.02, 0.06, len(low)), rng.uniform(0, 2 * np.pi, len(low))
    wave = np.sin(phase + rate * np.arange(FRAMES)[:, None])
    q = (low + high) / 2 + 0.3 * (high - low) * wave
    landmarks = np.full((FRAMES, NUM_LANDMARKS, 3), np.nan)
    landmarks[:, [LANDMARKS.index(n) for n in hand.tree.names]] = hand.landmark_positions(q)
    landmarks = 1.3 * landmarks @ np.array([[0, 1.0, 0], [0, 0, 1], [1, 0, 0]]) + 0.2
    stamps = np.arange(FRAMES) / 50
    valid = np.isfinite(landmarks).all(axis=-1)
    recording = HandRecording(landmarks, stamps, hand.spec.side, valid)
    q = q + off * (np.arange(len(low)) == len(low) - 1)
    commands = CommandTrajectory(
        hand.full_configuration(q),
        hand.joint_names,
        stamps,
        np.ones(FRAMES),
        np.zeros(FRAMES, np.int8),
    )
    return assemble_trace(recording, commands, hand, reach_samples=500)


HANDS = [("shadow_dexee", None), ("allegro_hand", None), ("shadow_hand", CHOICES[-1])]


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("name", "fingers"), HANDS)
def test_a_hand_that_does_what_the_human_does_is_perfect(name, fingers, side):
    hand = load_hand(name, side, fingers=fingers)
    trace = played_back(hand)
    for definition in ("sound", "paper"):
        result = evaluate(trace, definition)
        for figure in ("cosine_similarity", "cosine_similarity_all", "scale_ratio"):
            assert result[figure] == pytest.approx(1, abs=1e-6), (definition, figure)
    result = evaluate(trace)
    assert result["motion_preservation"] == pytest.approx(1, abs=1e-6)
    assert result["frozen_share"] == 0
    assert result["limit_violation_share"] == 0
    assert tuple(result["pinch_touch_share_per_finger"]) == hand.fingers[1:]
    assert tuple(result["workspace_utilisation_per_finger"]) == hand.fingers
    assert None not in result["workspace_utilisation_per_finger"].values()
    assert None not in result["self_collision"].values()
    assert evaluate(trace, "paper")["human_fit"] == "robot pose"
